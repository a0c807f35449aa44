"""Owen-scrambled Sobol' points without end (Sobol' 1967; Owen 1995; Burley 2020, Practical hash-based Owen scrambling).

Every space has the first two dimensions of Sobol's sequence, shuffled and scrambled by its own key: any 2^k samples in
turn, aligned, have one in each of 2^k rectangles of any shape, and different spaces are unrelated. A sample is a pure
function of (seed, pixel, space, index).
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from .hash import combine
from .nrook import NRook, SamplerPoints, UInt, to_unit


class Sobol:
    """The ``t``-th samples in every space. ``key``: :func:`.pixel_key`; ``t``: an integer or a Dr.Jit array; ``n``:
    how many samples divide the spectrum, see :mod:`.wavelengths`.
    """

    def __init__(self, key: UInt, t: UInt, n: int = 1) -> None:
        self.key, self.t, self.division = key, t, (t, n)
        self.reversed = reverse(t)

    def __call__(self, space: UInt, active: mi.Bool = True) -> mi.Point2f:
        """The ``mi.Point2f`` in [0, 1)² for ``space`` (an integer: 0 is the pixel; see ``transport_context.py``)."""
        return point(combine(self.key, space), self.reversed)

    def choice(self, space: UInt) -> mi.Float:
        """A number in [0, 1), without strata, to choose among alternatives."""
        return to_unit(combine(combine(combine(self.key, space), 3), self.t))


def point(key: UInt, reversed_index: UInt) -> mi.Point2f:
    """The point of a sequence under ``key`` whose index has these bits in reverse order."""
    i = reverse(scrambled(reversed_index, combine(key, 0)))  # the order of the points
    x, y = scrambled(i, combine(key, 1)), scrambled(pascal(i), combine(key, 2))
    return mi.Point2f(to_unit(reverse(x)), to_unit(reverse(y)))


def pascal(i: Any) -> Any:
    """The second dimension of the ``i``-th point with its bits in reverse order, where the first one is ``i`` itself:
    Pascal's matrix modulo 2, by powers of two.
    """
    for shift, mask in ((1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF), (16, 0x0000FFFF)):
        i = i ^ ((i >> shift) & mask)
    return i


def scrambled(x: Any, key: Any) -> Any:
    """Owen's scrambling of a number whose bits are in reverse order: a hash of the bits below decides whether each is
    flipped (Laine and Karras 2011; constants by Vegdahl 2021). The masks are for Python's integers: Dr.Jit drops them.
    """
    x = x ^ (x * 0x3D20ADEA & 0xFFFFFFFF)
    x = (x + key) & 0xFFFFFFFF
    x = x * ((key >> 16) | 1) & 0xFFFFFFFF
    x = x ^ (x * 0x05526C56 & 0xFFFFFFFF)
    return x ^ (x * 0x53A22864 & 0xFFFFFFFF)


def reverse(x: Any) -> Any:
    """The 32 bits of ``x`` in reverse order."""
    return int(f"{x:032b}"[::-1], 2) if isinstance(x, int) else dr.brev(x)


#: The samples of all spaces: of either sequence, or of a sampler of Mitsuba's.
Points = NRook | Sobol | SamplerPoints
