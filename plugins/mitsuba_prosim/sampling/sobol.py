"""The numbers that photons are drawn from: pure functions of a key and the photon's index."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..sampling.hash import combine
from ..sampling.nrook import to_unit


def starts(key: mi.UInt32, i: mi.UInt32) -> tuple[mi.Point2f, mi.Point2f]:
    """Two points in [0, 1)² for the ``i``-th photon under ``key``: any 2^k photons in turn have one in each of 2^k
    rectangles of any shape, for the one as for the other.

    Both are Sobol's sequence in two dimensions, scrambled as Owen does, in an order of their own (Burley 2020).
    """
    return evenly(combine(key, 0), i), evenly(combine(key, 1), i)


def evenly(key: mi.UInt32, i: mi.UInt32) -> mi.Point2f:
    """The ``i``-th of the scrambled and shuffled points of Sobol's sequence."""
    i = scrambled(i, combine(key, 0))
    y, step = mi.UInt32(0), 1 << 31
    for k in range(32):
        y ^= dr.select((i >> k) & 1 != 0, mi.UInt32(step), 0)
        step ^= step >> 1
    return mi.Point2f(to_unit(scrambled(dr.brev(i), combine(key, 1))), to_unit(scrambled(y, combine(key, 2))))


def scrambled(x: mi.UInt32, key: mi.UInt32) -> mi.UInt32:
    """Owen's scrambling: each bit of ``x`` is turned or not by a hash of those above it (Laine and Karras 2011)."""
    x = dr.brev(x)
    x ^= x * 0x3D20ADEA
    x += key
    x *= (key >> 16) | 1
    x ^= x * 0x05526C56
    x ^= x * 0x53A22864
    return dr.brev(x)
