"""Owen-scrambled Sobol' points: an unlimited sequence for each space (pair of random numbers of a sample).

The method is by Sobol' (1967), Owen (1995) and Burley (2020, Practical hash-based Owen scrambling). Every space uses
the first two dimensions of Sobol's sequence, shuffled and scrambled by its own hash key, so that the points of
different spaces are unrelated. If the unit square is divided into 2^k equal dyadic rectangles of any proportions, every
block of 2^k samples that begins at a multiple of 2^k has one sample in each rectangle; blocks of less than 8 samples
only at the beginning. Each space has its own order of the samples of a block of 8: if two samples far apart in one
space were far apart in all, light that depends on two spaces would be noisier than with independent samples. A sample
is a pure function of seed, pixel, space and index.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from .hash import combine
from .nrook import NRook, SamplerPoints, UInt, to_unit


class Sobol:
    """The Sobol' sample number ``t`` of a pixel; each call returns one pair of random numbers of this sample.

    ``key`` is the :func:`.pixel_key`; ``t`` is an integer or a Dr.Jit array; ``n`` is the number of samples among which
    the spectrum is divided (:mod:`.wavelengths`); ``first`` is the index of the pixel's first sample in the sequence.
    """

    def __init__(self, key: UInt, t: UInt, n: int = 1, first: UInt = 0) -> None:
        self.key, self.t, self.division = key, first + t, (first + t, n)
        few = dr.minimum(t, 15)
        #: The bits of the index that number the samples of a block: those below the highest bit of ``t``, at most 3.
        self.block = few >> 1 | few >> 2 | few >> 3

    def __call__(self, space: UInt, active: mi.Bool = True) -> mi.Point2f:
        """Returns the point of this sample, in [0, 1)², in the space number ``space``; ``active`` is ignored."""
        key = combine(self.key, space)
        # Here lower bits change higher bits, and in :func:`point` higher bits change lower bits.
        return point(key, reverse(self.t ^ ((self.t ^ scrambled(self.t, combine(key, 4))) & self.block)))

    def choice(self, space: UInt) -> mi.Float:
        """Returns a random number in [0, 1), which is not stratified, for a choice such as that of a lobe."""
        return to_unit(combine(combine(combine(self.key, space), 3), self.t))


def point(key: UInt, reversed_index: UInt) -> mi.Point2f:
    """Returns a Sobol' point in [0, 1)², shuffled and scrambled by the hash ``key``; ``reversed_index`` is its index
    with the bits in reverse order.
    """
    i = reverse(scrambled(reversed_index, combine(key, 0)))  # the order of the points
    x, y = scrambled(i, combine(key, 1)), scrambled(pascal(i), combine(key, 2))
    return mi.Point2f(to_unit(reverse(x)), to_unit(reverse(y)))


def pascal(i: Any) -> Any:
    """Returns the second coordinate of a Sobol' point from the first one, both with their bits in reverse order:
    multiplies by Pascal's matrix modulo 2.
    """
    for shift, mask in ((1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF), (16, 0x0000FFFF)):
        i = i ^ ((i >> shift) & mask)
    return i


def z_curve(x: mi.Int32, y: mi.Int32) -> mi.UInt32:
    """Returns the Morton code of the pixel (x, y): the lowest 14 bits of x and y alternate."""
    return mi.math.morton_encode2(mi.Point2u(mi.UInt32(x) & 0x3FFF, mi.UInt32(y) & 0x3FFF))


def scrambled(x: Any, key: Any) -> Any:
    """Returns the Owen-scrambled form of ``x``, a 32-bit number whose bits are in reverse order.

    Whether a bit is flipped depends on ``key`` and on all lower bits of ``x`` (Laine and Karras 2011; constants by
    Vegdahl 2021). The masks are needed for Python's unbounded integers; Dr.Jit removes them.
    """
    x = x ^ (x * 0x3D20ADEA & 0xFFFFFFFF)
    x = (x + key) & 0xFFFFFFFF
    x = x * ((key >> 16) | 1) & 0xFFFFFFFF
    x = x ^ (x * 0x05526C56 & 0xFFFFFFFF)
    return x ^ (x * 0x53A22864 & 0xFFFFFFFF)


def reverse(x: Any) -> Any:
    """Returns the 32 bits of ``x`` in reverse order."""
    return int(f"{x:032b}"[::-1], 2) if isinstance(x, int) else dr.brev(x)


#: The samples of all spaces: N-rook samples, Sobol' samples, or those of a Mitsuba sampler.
Points = NRook | Sobol | SamplerPoints
