"""The numbers that photons are drawn from: pure functions of a key and the photon's index."""

from __future__ import annotations

import mitsuba as mi

from ..sampling import sobol
from ..sampling.hash import combine
from ..sampling.nrook import to_unit


def starts(key: mi.UInt32, i: mi.UInt32) -> tuple[mi.Point2f, mi.Point2f]:
    """Two points in [0, 1)² for the ``i``-th photon under ``key``: any 2^k photons in turn have one in each of 2^k
    rectangles of any shape, for the one as for the other.

    Both are Sobol's sequence in two dimensions, scrambled as Owen does, in an order of their own (Burley 2020).
    """
    i = sobol.reverse(i)
    return sobol.point(combine(key, 0), i), sobol.point(combine(key, 1), i)


def number(key: mi.UInt32, k: mi.UInt32) -> mi.Float:
    """The ``k``-th number in [0, 1) under a photon's ``key``."""
    return to_unit(combine(key, k))


def point(key: mi.UInt32, k: mi.UInt32) -> mi.Point2f:
    """Two of them: the ``k``-th and the next."""
    return mi.Point2f(number(key, k), number(key, k + 1))
