"""Pixels that are sampled together."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from .accumulators import Accumulators
from .estimator import Estimator
from .plan import Plan, Rectangle
from .standard_error import standard_error


class PixelSet:
    """Pixels that are sampled together: an image, or an independent second image of some of its pixels.

    The arrays of an image also have the pixels of its second image, so that a work item can have pixels of both.
    """

    plan: Plan
    estimator: Estimator
    #: The rectangle of the pixels, row by row, if the set is a whole image.
    outer: Rectangle
    #: Which entries of the arrays are the pixels of this set.
    own: slice
    #: Coordinates and seed of each pixel of both images, and the sums over its samples.
    x: mi.Int32
    y: mi.Int32
    seed: mi.UInt32
    #: The numbers of the pixels of both images in their order along the Z curve.
    along_z: np.ndarray
    accumulators: Accumulators

    @property
    def count(self) -> np.ndarray:
        """Number of samples of each pixel of this set."""
        return np.array(self.accumulators.count)[self.own]

    def statistics(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns each pixel's sum, sum of squares and number of samples, in 64 bits: a variance is a difference."""
        sums = self.accumulators
        arrays = (np.array(v, dtype=np.float64) for v in (sums.total, sums.squares, sums.count))
        total, squares, count = (values[self.own] for values in arrays)
        return total, squares, count

    def error(self) -> np.ndarray:
        """Returns the standard error of the mean luminance of each pixel, as 32-bit floats with one entry per pixel.

        If a pixel has at least two complete passes of ``plan.n`` samples, and no incomplete pass, the error is
        estimated from the means of the passes. If a pixel has only one pass, or an incomplete pass, the error is
        estimated from the single samples. It is NaN for a pixel without samples, and 0 for a pixel with one sample.
        """
        (total, squares, count), n = self.statistics(), self.plan.n
        with np.errstate(all="ignore"):  # the error is NaN without samples
            between = standard_error(total / n, np.array(self.accumulators.pass_squares)[self.own], count / n)
            single = standard_error(total, squares, count)
            return np.float32(np.where((count > n) & (count % n == 0), between, single))
