"""The numbers that photons are drawn from: pure functions of a key and the photon's index."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..sampling.hash import combine
from ..sampling.nrook import to_unit

#: Where a photon starts takes four numbers. Theirs is the sequence of multiples of 1 / g, 1 / g² ... modulo 1, with
#: g⁵ = g + 1 (Roberts 2018; the golden ratio in one dimension), in 32 bits: any stretch of it fills the space evenly.
G = 1.1673039782614187
STEPS = [round(2.0**32 * G**-k) for k in range(1, 5)]


def starts(key: mi.UInt32, i: mi.UInt32) -> tuple[mi.Point2f, mi.Point2f]:
    """The ``i``-th point of the sequence, displaced by ``key``: a point in [0, 1)⁴, as two in [0, 1)²."""
    u = [to_unit(i * step + combine(key, k)) for k, step in enumerate(STEPS)]
    return mi.Point2f(u[0], u[1]), mi.Point2f(u[2], u[3])


def number(key: mi.UInt32, k: mi.UInt32) -> mi.Float:
    """The ``k``-th number in [0, 1) under a photon's ``key``."""
    return to_unit(combine(key, k))


def point(key: mi.UInt32, k: mi.UInt32) -> mi.Point2f:
    """Two of them: the ``k``-th and the next."""
    return mi.Point2f(number(key, k), number(key, k + 1))
