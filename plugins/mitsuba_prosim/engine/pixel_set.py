"""Pixels that are sampled together."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from .accumulators import Accumulators
from .estimator import Estimator
from .plan import Plan, Rectangle


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
    accumulators: Accumulators

    @property
    def count(self) -> np.ndarray:
        """Number of samples of each pixel of this set."""
        return np.array(self.accumulators.count)[self.own]

    def statistics(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns :meth:`.Accumulators.statistics` of the pixels of this set."""
        total, squares, count = (values[self.own] for values in self.accumulators.statistics())
        return total, squares, count

    def error(self) -> np.ndarray:
        """Returns :meth:`.Accumulators.error` of the pixels of this set."""
        return self.accumulators.error(self.plan.n)[self.own]
