"""The sums over the samples of each pixel, and the state of adaptive sampling of an image (thesis, section 5.3.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compat import double
from .error import standard_error
from .plan import UNLIMITED, Plan, Rectangle, area, pixels, widened
from .policies import policy_of
from .tiles import Part, part_numbers

if TYPE_CHECKING:
    from .estimator import Estimator

#: Maximum brightness of a sample in the estimated error, so that the squares of N² samples are finite.
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
    #: by channel.
    sums: list[mi.Float64]
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
        """Returns accumulators of ``pixels`` pixels without samples.

        ``sums_per_pixel`` is the length of the list ``sums`` (:attr:`.Estimator.sums_per_pixel`).
        """
        total, squares, pass_squares, in_pass, *sums = (dr.zeros(double(), pixels) for _ in range(sums_per_pixel + 4))
        result = cls(sums, total, squares, pass_squares, in_pass, dr.zeros(mi.UInt32, pixels))
        dr.make_opaque(result)
        return result

    def statistics(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns the sum of the luminances, the sum of their squares, and the number of the samples of each pixel.

        The three results are NumPy arrays of 64-bit floats, because the difference of two large sums is the variance.
        """
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


class FilmState:
    """The state of an image in progress: the accumulators of all pixels, and the state of adaptive sampling.

    The n-th sample of a pixel does not depend on the order in which samples are taken, so the image depends only on the
    number of samples of each pixel. A :class:`.Checkpoint` stores a film state in a file. ``part`` is the part of the
    image that is rendered; None for the whole image.
    """

    def __init__(self, plan: Plan, estimator: Estimator, part: Part | None = None) -> None:
        # ``part`` is the part of the image that is rendered; None for the whole image.
        self.plan, self.estimator, self.policy, self.part = plan, estimator, policy_of(plan), part
        #: Width in pixels of the margin around the image whose samples the policy uses.
        self.margin = self.policy.rounds * self.policy.reach
        #: The rectangle of the pixels in the arrays, row by row.
        self.outer = widened(plan.region, self.margin, plan.domain)
        self.x, self.y = pixels(self.outer)
        self.accumulators = Accumulators.empty(estimator.sums_per_pixel, area(self.outer))
        #: The last measurement by :class:`.SecondImage`, see :data:`.error_target.Noise`.
        self.noise: tuple[float, float, float, float] = (float("nan"),) * 4
        #: Estimates of the error of the denoised image: samples per pixel, the denoiser's networks, and the ratio of
        #: the error of the denoised image to the error of the raw image.
        self.estimates = list[Sequence[Any]]()
        #: Number of decisions of the policy so far; 0 before the end of the first pass.
        self.rounds = 0
        #: The counts of the current pass; None during the first pass and between two passes.
        self.wanted: np.ndarray | None = None
        #: Accumulators of the :class:`.SecondImage`.
        self.second: Accumulators | None = None
        #: Indices of the pixels of the :class:`.SecondImage` in the arrays of this state.
        self.second_index: np.ndarray | None = None

    def crop(self, values: mi.Float | mi.UInt32 | np.ndarray, rectangle: Rectangle) -> np.ndarray:
        """Returns the entries of ``values`` for the pixels of ``rectangle``, shape (height, width).

        ``values`` has one entry for each pixel of the rectangle :attr:`outer`, row by row; ``rectangle`` must lie in
        :attr:`outer`. If ``values`` is a NumPy array, the result is a view of ``values``, not a copy.
        """
        left, top, right, bottom = self.outer
        plane = values if isinstance(values, np.ndarray) else np.array(values)
        plane = plane.reshape(bottom - top, right - left)
        return plane[rectangle[1] - top : rectangle[3] - top, rectangle[0] - left : rectangle[2] - left]

    @property
    def counts(self) -> np.ndarray:
        """Number of samples of each pixel of ``plan.region``, shape (height, width).

        ``plan.region`` has the pixels whose samples contribute to the crop window through the reconstruction filter.
        """
        return self.crop(self.accumulators.count, self.plan.region)

    def counts_of_part(self, counts: np.ndarray, reach: int) -> np.ndarray:
        """Returns ``counts``, but 0 for pixels that are farther than ``reach`` pixels from the image part :attr:`part`.

        ``counts`` has one entry for each pixel of :attr:`outer`. A distance is the larger one of the distances in rows
        and in columns. ``reach``, in pixels, must not exceed the side of a tile (:mod:`.tiles`). A place outside
        ``plan.region`` counts as the nearest pixel of ``plan.region``. If :attr:`part` is None, ``counts`` is returned
        unchanged.
        """
        if self.part is None:
            return counts
        x, y, needed = np.array(self.x), np.array(self.y), np.zeros(counts.shape, bool)
        left, top, right, bottom = self.plan.region
        # These nine places meet all tiles within ``reach`` pixels, because no tile is narrower than ``reach``.
        for px in (np.clip(x + step, left, right - 1) for step in (-reach, 0, reach)):
            for py in (np.clip(y + step, top, bottom - 1) for step in (-reach, 0, reach)):
                needed |= part_numbers(self.plan.region, self.part.of, self.margin, px, py) == self.part.number
        return np.where(needed, counts, np.uint32(0))

    def request(self, margin: int = 0) -> np.ndarray:
        """Returns the number of samples that the policy of adaptive sampling requests for each pixel of :attr:`outer`.

        The result is a flat array of total numbers, which include the samples that a pixel already has. The numbers are
        32-bit floats, neither rounded nor limited; the policy ``graded`` also requests infinity. The requested number
        is 0 for a pixel that is more than ``margin`` pixels outside ``plan.region``.
        """
        statistics = self.accumulators.statistics()
        # The statistics of both images are added, because either image may have met a rare bright light.
        if self.second is not None and self.second_index is not None:
            for first, second in zip(statistics, self.second.statistics()):
                np.add.at(first, self.second_index, second)
        with np.errstate(all="ignore"):  # the error is NaN without samples
            values = np.float32(self.policy.request(*(self.crop(sums, self.outer) for sums in statistics)))
        there, result = widened(self.plan.region, margin, self.plan.domain), np.zeros(area(self.outer), np.float32)
        self.crop(result, there)[:] = self.crop(values, there)
        return result

    def counts_for(self, request: np.ndarray) -> np.ndarray:
        """Converts the requested numbers of samples to the numbers of samples that the pixels will have.

        The numbers include the samples that a pixel already has. A request below the plan's minimum number of samples
        per pixel becomes this minimum. A request above the minimum is rounded up to a power of two, for which Sobol'
        points are best, and limited to the plan's maximum number of samples per pixel. A request of NaN becomes 1.
        """
        plan, clipped = self.plan, np.clip(np.nan_to_num(request, nan=1), 1, UNLIMITED)
        # The exponent of frexp(m - 1) is the smallest e with 2^e >= m, for whole numbers m >= 1.
        power_of_two = np.left_shift(1, np.frexp(np.ceil(clipped) - 1)[1])
        counts = np.where(request <= plan.min_samples, plan.min_samples, power_of_two)
        return np.minimum(counts, plan.max_samples).astype(np.uint32)
