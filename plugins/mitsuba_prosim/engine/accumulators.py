"""The sums over the samples of every pixel, and the adaptive state of an image (section 5.3.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .error import standard_error
from .plan import UNLIMITED, Plan, Rectangle, area, pixels, widened
from .policies import policy_of
from .tiles import Part, within_reach

if TYPE_CHECKING:
    from .estimator import Estimator

#: A sample counts as no brighter than this in the estimated error: the squares of N² samples stay finite.
BRIGHTEST = 1e16

#: A darker sample counts as black, there and in the image: its square, or its sum, would be a denormal number, which
#: Dr.Jit's threads round to zero and the main thread does not.
DARKEST, DARKEST_SUM = 1e-16, 1e-30


@dataclass
class Accumulators:
    """Sums over the first ``count`` samples of each pixel: Dr.Jit arrays with one entry per pixel.

    They are added in the order of the samples, wherever a render stops: the bits depend on ``count`` alone.
    """

    #: The film's values, weighted by its filter, for every pixel within the filter's reach, row by row, channel by
    #: channel.
    sums: list[mi.Float]
    #: Sums of the luminance, of its square, and of the square of its mean over each complete pass.
    total: mi.Float
    squares: mi.Float
    pass_squares: mi.Float
    #: Sum of the luminance over the current pass.
    in_pass: mi.Float
    #: Number of samples.
    count: mi.UInt32

    @classmethod
    def empty(cls, sums_per_pixel: int, pixels: int) -> Accumulators:
        """Accumulators without samples, of ``pixels`` pixels."""
        a, b, c, d, *sums = (dr.zeros(mi.Float, pixels) for _ in range(sums_per_pixel + 4))
        result = cls(sums, a, b, c, d, dr.zeros(mi.UInt32, pixels))
        dr.make_opaque(result)
        return result

    def statistics(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The sums of the luminance and of its square, and the number of samples, as 32-bit floats of NumPy's."""
        return np.array(self.total), np.array(self.squares), np.array(self.count).astype(np.float32)

    def error(self, n: int) -> np.ndarray:
        """Standard error of the mean luminance: from the means of the passes of ``n`` samples if there are two or more
        and none is incomplete, else from single samples.
        """
        (total, squares, count), share = self.statistics(), np.float32(1 / n)
        with np.errstate(all="ignore"):  # without samples it is NaN
            between = standard_error(total * share, np.array(self.pass_squares), count * share)
            return np.where((count > n) & (count % n == 0), between, standard_error(total, squares, count))


class FilmState:
    """The accumulators of all pixels of an image, and the adaptive state: a checkpoint when saved.

    The first samples of a pixel are the same in any order of work, so that the image depends on the counts alone.
    ``part``: the part whose samples are taken, None for all.
    """

    def __init__(self, plan: Plan, estimator: Estimator, part: Part | None = None) -> None:
        self.plan, self.estimator, self.policy, self.part = plan, estimator, policy_of(plan), part
        #: The decisions look at these pixels around the image.
        self.margin = self.policy.rounds * self.policy.reach
        #: The pixels of the arrays, row by row.
        self.outer = widened(plan.region, self.margin, plan.domain)
        self.x, self.y = pixels(self.outer)
        self.accumulators = Accumulators.empty(estimator.sums_per_pixel, area(self.outer))
        #: RMS error of the displayed image (white = 1), and the bounds of 99 and of 99.9 % of its pixels, as measured
        #: last by :class:`.SecondImage`.
        self.noise: tuple[float, float, float] = (float("nan"),) * 3
        #: Each estimate of the denoised image's error: samples of a pixel, the denoiser's networks, the error as above.
        self.estimates = list[Sequence[Any]]()
        #: How often the policy has decided; 0 before the end of the first pass.
        self.rounds = 0
        #: The counts of the current pass; None in the first pass and between two.
        self.wanted: np.ndarray | None = None
        #: With an error target: the samples per requested sample; and the requested samples, if decided once.
        self.effort = 0.0
        self.requested: np.ndarray | None = None
        #: Accumulators of the :class:`.SecondImage`.
        self.second: Accumulators | None = None

    def crop(self, values: mi.Float | mi.UInt32 | np.ndarray, rectangle: Rectangle) -> np.ndarray:
        """The entries of the pixels of ``rectangle``, shape (height, width); a view of a NumPy array."""
        left, top, right, bottom = self.outer
        plane = values if isinstance(values, np.ndarray) else np.array(values)
        plane = plane.reshape(bottom - top, right - left)
        return plane[rectangle[1] - top : rectangle[3] - top, rectangle[0] - left : rectangle[2] - left]

    @property
    def counts(self) -> np.ndarray:
        """Number of samples of each pixel whose samples reach the window, shape (height, width)."""
        return self.crop(self.accumulators.count, self.plan.region)

    def counts_of_part(self, counts: np.ndarray, reach: int) -> np.ndarray:
        """``counts`` of the pixels within ``reach`` of this part, 0 for the others."""
        if self.part is None:
            return counts
        x, y = np.array(self.x), np.array(self.y)
        return np.where(within_reach(self.part, self.plan.region, self.margin, x, y, reach), counts, np.uint32(0))

    def request(self, margin: int = 0) -> np.ndarray:
        """The samples that the policy requests for each pixel within ``margin`` of the region, 0 for the others."""
        with np.errstate(all="ignore"):  # without samples it is NaN
            values = self.policy.request(*(self.crop(sums, self.outer) for sums in self.accumulators.statistics()))
        there, result = widened(self.plan.region, margin, self.plan.domain), np.zeros(area(self.outer), np.float32)
        self.crop(result, there)[:] = self.crop(values, there)
        return result

    def counts_for(self, request: np.ndarray) -> np.ndarray:
        """Counts for the requested samples: those of the first pass, or a power of two, for which Sobol' points are
        best, within what the plan allows.
        """
        plan, clipped = self.plan, np.clip(np.nan_to_num(request, nan=1), 1, UNLIMITED)
        power_of_two = np.left_shift(1, np.frexp(np.ceil(clipped) - 1)[1])
        counts = np.where(request <= plan.min_samples, plan.min_samples, power_of_two)
        return np.minimum(counts, plan.max_samples).astype(np.uint32)
