"""Wavelengths that divide the spectrum evenly among samples, and which of its four a ray keeps where it must.

Mitsuba draws four wavelengths a quarter of the spectrum apart, so that one number is their position within a quarter.
Behind glass that disperses a ray has only one of them; together its samples see the whole spectrum if they keep each of
the four as often, and this for each part of a quarter.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from .hash import GOLDEN, combine
from .nrook import to_unit


def shared(key: mi.UInt32, t: mi.UInt32, n: int | mi.UInt32) -> mi.Float:
    """The number in [0, 1) that the wavelengths of the ``t``-th samples are drawn by under ``key``: that of a pixel,
    or that of an image where all pixels have the same, and photons with them.

    The ``n`` numbers of a pass divide a quarter into equal parts, pass after pass at another place (which turns by the
    golden ratio): a shifted lattice, which is next to exact where spectra are smooth (Cranley and Patterson 1976).
    """
    r = t // n
    return to_unit(key + (t - r * n) * (dr.opaque(mi.UInt32, 1 << 30) // n) + r * GOLDEN // (4 * n))


def chosen(key: mi.UInt32, t: mi.UInt32, n: int | mi.UInt32, rest: mi.Float) -> mi.Float:
    """The number in [0, 1) by which the ``t``-th sample chooses one of its four wavelengths, drawn by :func:`shared`
    with this ``n``: in 4 n samples each of the n parts meets each of the four once, and in four samples they all occur.
    ``rest``: in [0, 1), the place in the quarter; ``key``: that of the choice.
    """
    n = mi.UInt32(n)
    # After the least common multiple of n and 4 samples, the same parts would meet the same quarters.
    around = n * (4 // dr.minimum(n & (~n + 1), 4))
    turns = t // around + combine(key, t // (4 * n))
    return (mi.Float((t + turns) & 3) + rest) * 0.25
