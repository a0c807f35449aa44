"""The sums over the samples of each pixel (thesis, section 5.3.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compat import double
from .standard_error import standard_error

#: Maximum brightness of a sample in the estimated error, so that the squares of N² samples are finite. Sums of 64 bits
#: allow its square.
BRIGHTEST = 1e16

#: Minimum absolute value of a sample in the image. A darker value counts as black, so that no value of the image is a
#: denormal number: some processors and threads round these to zero.
DARKEST = 1e-30


@dataclass
class Accumulators:
    """Sums over the first ``count`` samples of each pixel, as Dr.Jit arrays with one entry per pixel.

    The samples of a pixel are always added in the order of their sample numbers, even if the render is interrupted and
    continued. Because samples are added in a fixed order, the bits of a pixel's sums depend only on the number of its
    samples, not on interruptions.

    The sums have 64 bits (:func:`.compat.double`). In a sum of 32 bits, the rounding errors of a million equal samples
    add up to one percent.
    """

    #: Sums of the film's values, weighted by the filter, for every pixel within the filter's reach, row by row, channel
    #: by channel: a list of arrays. In an image, one array with the sums of a pixel side by side, because a processor
    #: reads and writes adjacent numbers together.
    sums: Any
    #: Sum of the luminance; sum of its square; sum of the squared mean luminance of each complete pass.
    total: mi.Float64
    squares: mi.Float64
    pass_squares: mi.Float64
    #: Sum of the luminance over the current pass.
    in_pass: mi.Float64
    #: Number of samples.
    count: mi.UInt32

    @classmethod
    def empty(cls, sums_per_pixel: int, pixels: int) -> Accumulators:
        """Returns accumulators without samples, with ``sums_per_pixel`` sums for each pixel of an image."""
        sums = dr.zeros(double(), pixels * sums_per_pixel)
        total, squares, pass_squares, in_pass = (dr.zeros(double(), pixels) for _ in range(4))
        result = cls(sums, total, squares, pass_squares, in_pass, dr.zeros(mi.UInt32, pixels))
        dr.make_opaque(result)
        return result

    @property
    def others(self) -> tuple[mi.Float64, mi.Float64, mi.Float64, mi.Float64, mi.UInt32]:
        """All attributes but ``sums``."""
        return self.total, self.squares, self.pass_squares, self.in_pass, self.count

    def film_sums(self, index: mi.UInt32, active: mi.Bool, first: int, number: int) -> list[mi.Float64]:
        """Returns ``number`` of the sums of the pixels ``index``, from the sum with the number ``first``, of an image.

        ``first`` must be a multiple of ``number``; the sums are 0 for pixels that are not ``active``.
        """
        rows = len(self.sums) // len(self.count) // number
        packets = dr.replace_type_t(mi.ArrayXf, dr.type_v(double()))
        return list(dr.gather(packets, self.sums, index * rows + first // number, active, shape=(number, len(index))))

    def of(self, index: mi.UInt32, active: mi.Bool) -> Accumulators:
        """Returns the accumulators of the pixels ``index`` of an image, 0 for pixels that are not ``active``."""
        number = len(self.sums) // len(self.count)
        others = dr.gather(tuple, self.others, index, active)
        return Accumulators(self.film_sums(index, active, 0, number), *others)

    def store(self, values: Accumulators, index: mi.UInt32, active: mi.Bool) -> None:
        """Replaces those of the pixels ``index`` of an image that are ``active``."""
        packets = dr.replace_type_t(mi.ArrayXf, dr.type_v(double()))
        for mine, new in ((self.sums, packets(values.sums)), *zip(self.others, values.others)):
            dr.scatter(mine, new, index, active, mode=dr.ReduceMode.NoConflicts)
        dr.eval(self)

    def statistics(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns each pixel's sum, sum of squares and number of samples, in 64 bits: a variance is a difference."""
        total, squares, count = (np.array(v, dtype=np.float64) for v in (self.total, self.squares, self.count))
        return total, squares, count

    def error(self, n: int) -> np.ndarray:
        """Returns the standard error of the mean luminance of each pixel, as 32-bit floats with one entry per pixel.

        If a pixel has at least two complete passes of ``n`` samples, and no incomplete pass, the error is estimated
        from the means of the passes. If a pixel has only one pass, or an incomplete pass, the error is estimated from
        the single samples. The error is NaN for a pixel without samples, and 0 for a pixel with one sample.
        """
        total, squares, count = self.statistics()
        with np.errstate(all="ignore"):  # the error is NaN without samples
            between = standard_error(total / n, np.array(self.pass_squares), count / n)
            single = standard_error(total, squares, count)
            return np.float32(np.where((count > n) & (count % n == 0), between, single))
