"""N-rook samples with rotations (thesis, sections 4.2.1.2 and 5.3.2).

A "space" is one of the pairs of random numbers that a sample needs, such as the position in the pixel. Each axis of
this unit square is divided into N strata. Pass number r, from 0 to N - 1, takes N samples of a pixel: one in each row
and in each column of strata. From pass to pass, the columns of the samples are rotated by one column, so that N passes
sample each of the N² cells exactly once. A sample is a pure function of seed, pixel, space, pass and index, so it does
not depend on tiling, on the order of evaluation or on the number of workers.
"""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

import drjit as dr
import mitsuba as mi

from .hash import GOLDEN, combine, hash32

if TYPE_CHECKING:
    import numpy as np

JITTERS = ("multi", "uniform")

#: A 32-bit unsigned integer of Python's, or a Dr.Jit array of them.
UInt: TypeAlias = "int | mi.UInt32"


def pixel_key(seed: UInt, pixel: UInt) -> UInt:
    """Returns the hash key of a pixel; both arguments are hashed, so that seeds don't just shift pixels."""
    return combine(hash32(pixel), hash32(seed))


@dataclass(init=False, eq=False)  # so that dr.freeze finds the table
class Permutations:
    """Random permutations of the numbers from 0 to n - 1, n >= 1, stored in a table.

    For n <= 6 the table holds all n! permutations. For greater n it holds 1024 permutations, each of which is rotated
    by a random number of positions, so that every element is equally likely at every position. Mitsuba's
    ``mi.permute_kensler`` is five times slower, and for few elements it does not choose all permutations equally often.
    """

    ALL_UP_TO: ClassVar[int] = 6
    n: int
    count: int
    rotated: bool
    table: Any

    def __init__(self, n: int) -> None:
        table = self._rows(n)
        self.n, self.count, self.rotated = n, len(table), n > self.ALL_UP_TO
        self.table = table.ravel()  # one permutation after another
        if dr.is_jit_v(mi.UInt32):
            self.table = mi.UInt32(self.table)
            dr.make_opaque(self.table)

    @classmethod
    @functools.cache
    def _rows(cls, n: int) -> np.ndarray:
        import numpy as np  # slow to import, and only a render needs NumPy

        if n <= cls.ALL_UP_TO:
            return np.array(list(itertools.permutations(range(n))), dtype=np.uint32)
        keys = hash32(np.arange(1024 * n, dtype=np.uint64)).reshape(1024, n)
        return np.argsort(keys, axis=1, kind="stable").astype(np.uint32)

    def __call__(self, h: UInt, i: UInt) -> UInt:
        """Returns element number ``i`` of the permutation, and of its rotation, that the 32-bit hash ``h`` selects."""
        row = scale(h, self.count) * self.n
        if self.rotated:
            # The row depends on the upper bits of the hash. The upper bits of this product depend on all its bits.
            i = i + scale(h * GOLDEN & 0xFFFFFFFF, self.n)
            i = dr.select(i >= self.n, i - self.n, i)
        return dr.gather(mi.UInt32, self.table, row + i) if dr.is_jit_v(mi.UInt32) else int(self.table[row + i])


def scale(h: UInt, n: int) -> UInt:
    """Maps a 32-bit hash ``h`` to an integer from 0 to n - 1."""
    return dr.mul_hi(h, mi.UInt32(n)) if dr.is_jit_v(h) else h * n >> 32


def to_unit(h: UInt) -> mi.Float:
    """Maps a 32-bit hash to a number in [0, 1)."""
    return mi.Float(h >> 8) * (1 / (1 << 24))


class NRook:
    """The N-rook sample number ``t`` of a pixel; each call returns one pair of random numbers of this sample.

    ``permutations`` are the :class:`Permutations` of N elements; ``key`` is the :func:`pixel_key`; ``t`` is an integer
    or a Dr.Jit array from 0 to N² - 1. With the ``jitter`` ``"uniform"``, the sample lies anywhere in its cell, as in
    the thesis. With ``"multi"``, the N² samples of all passes also fill all N² strata of each axis (multi-jittered
    sampling by Chiu, Shirley and Wang 1994; Kensler 2013).
    """

    def __init__(self, permutations: Permutations, key: UInt, t: UInt, jitter: str = "multi") -> None:
        self.permutations, self.key, self.t, self.jitter = permutations, key, t, jitter
        #: Number of the pass, and the index in the pass.
        self.r = t // permutations.n
        self.i = t - self.r * permutations.n
        #: The arguments ``t`` and ``n`` of :func:`.wavelength_number` and :func:`.wavelength_choice`: which sample
        #: takes which part of the spectrum.
        self.division = t, permutations.n

    def __call__(self, space: UInt, active: mi.Bool = True) -> mi.Point2f:
        """Returns the point of this sample, in [0, 1)², in the space number ``space``; ``active`` is ignored."""
        permute, n = self.permutations, self.permutations.n
        h_space = combine(self.key, space)
        h_pass = combine(h_space, self.r + 1)
        # Each pass has its own permutation of the rows (thesis, figure 5.10). All passes share a permutation from rows
        # to columns, rotated by one column in each pass (figure 5.11).
        row = permute(h_pass, self.i)
        col = permute(h_space, row) + self.r
        col = dr.select(col >= n, col - n, col)
        h = combine(h_pass, self.i + n)
        u, v = to_unit(h), to_unit(hash32(h))
        if self.jitter == "multi":
            # All rows share one permutation, and all columns share one: this is correlated multi-jitter, which keeps a
            # distance between points (Kensler 2013).
            u = (permute(combine(h_space, n + 1), col) + u) / n
            v = (permute(combine(h_space, n + 2), row) + v) / n
        below_one = 1 - 2.0**-24
        return mi.Point2f(dr.minimum((row + u) / n, below_one), dr.minimum((col + v) / n, below_one))

    def choice(self, space: UInt) -> mi.Float:
        """Returns a random number in [0, 1), which is not stratified, for a choice such as that of a lobe."""
        return to_unit(combine(combine(combine(self.key, space), self.r + 1), self.i))


class SamplerPoints:
    """The samples of a Mitsuba sampler as an :class:`NRook`; they depend on the order of the calls."""

    def __init__(self, sampler: mi.Sampler) -> None:
        self.sampler = sampler

    def __call__(self, space: UInt, active: mi.Bool = True) -> mi.Point2f:
        """Returns the next point in [0, 1)² of the Mitsuba sampler; the number ``space`` is ignored."""
        return self.sampler.next_2d(active)

    def choice(self, space: UInt) -> mi.Float:
        """Returns the next number in [0, 1) of the Mitsuba sampler, and ignores ``space``."""
        return self.sampler.next_1d()


def grid_size(sample_count: int) -> int:
    """Returns the smallest N >= 1 with N² >= ``sample_count``."""
    return max(1, math.isqrt(max(sample_count, 1) - 1) + 1)
