"""Policies of adaptive sampling: how many samples each pixel gets (thesis, sections 4.2.1.1 and 5.3.2)."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from .error import in_display_units, standard_error, variance
from .plan import Plan


class Policy:
    """The policy ``none``, by which every pixel gets all samples; base class of the other policies.

    A subclass overrides the attributes and methods that differ from those of this class.
    """

    #: Distance in pixels up to which the policy looks at neighbours.
    reach = 0
    #: Number of decisions of the policy, each after a pass over the image. With an error target, a policy with several
    #: decisions decides after every pass.
    rounds = 1

    def __init__(self, plan: Plan) -> None:
        #: Number of samples of every pixel in the first pass; total number of samples of a noisy pixel.
        self.first_samples, self.noisy_samples = plan.min_samples, plan.noisy_samples
        # The policy ``none`` without an error target decides nothing: the first pass takes all samples.
        if type(self) is Policy and plan.noisy_samples == plan.max_samples:
            self.first_samples = plan.max_samples
        # After the first pass nothing is decided, so no neighbours are needed.
        if self.first_samples >= plan.max_samples:
            self.reach = 0
        #: The integrator's parameter ``threshold``; the number N of samples of a pass.
        self.threshold, self.n = plan.sampling.threshold, plan.n

    def request(self, total: np.ndarray, squares: np.ndarray, count: np.ndarray) -> np.ndarray:
        """Returns the total number of samples that each pixel should get, shape (height, width).

        ``total`` and ``squares`` are the sums of the luminance and of its square over ``count`` samples, 32-bit floats
        of this shape. :meth:`.FilmState.counts_for` rounds the result up, and limits it.
        """
        return np.full(count.shape, self.noisy_samples)

    def converged(self, total: mi.Float, squares: mi.Float, t: mi.UInt32) -> mi.Bool:
        """Tells which pixels need no samples beyond the first ``t``, a whole number of passes.

        ``total`` and ``squares`` are the sums of the luminance and of its square over these ``t`` samples. No pixel has
        converged if the policy does not decide by the pixel's own samples.
        """
        return mi.Bool(False)


class Thesis(Policy):
    """Ends a pixel as soon as the standard error of its own samples is at most the threshold, in units of radiance.

    The policy is exactly the criterion of the thesis (section 5.3.2). The samples that decide are the samples of the
    estimate, so the estimate is biased (Kirk and Arvo 1991).
    """

    def converged(self, total: mi.Float, squares: mi.Float, t: mi.UInt32) -> mi.Bool:
        """Tells which pixels have a standard error of at most the threshold."""
        threshold = dr.opaque(mi.Float, self.threshold)  # one kernel serves all values
        return (t >= self.first_samples) & (standard_error(total, squares, mi.Float(t)) <= threshold)


class Neighbours(Policy):
    """Requests all samples for a pixel if the 24 pixels around it suggest a standard error above the threshold.

    The error is that of the displayed value (:func:`.in_display_units`). A window of 5 x 5 pixels shows an outlier that
    3 x 3 pixels miss. A window of 5 x 5 pixels also shows noise where the first samples of the nearest pixels agree by
    chance.
    """

    reach = 2

    def request(self, total: np.ndarray, squares: np.ndarray, count: np.ndarray) -> np.ndarray:
        """Requests all samples for noisy pixels, and the first samples for the others."""
        # A pixel may have more samples than the first ones. The sums are scaled to ``first_samples`` samples.
        share = self.first_samples / count
        error = error_of_neighbours(total * share, squares * share, self.first_samples)
        return np.where(error <= self.threshold, self.first_samples, self.noisy_samples)  # NaN counts as noisy


class Graded(Policy):
    """Requests samples in proportion to the standard deviation of a sample, by the 24 pixels around a pixel.

    The deviation is that of the displayed value (:func:`.in_display_units`). Samples in proportion to the standard
    deviation minimise the total variance (Neyman 1934). A pixel gets N² samples if N² samples reduce the standard error
    to the threshold. The policy decides after the first and after the second pass, because the first pass misses rare
    events; with an error target, it decides after every pass.

    The variance is the mean of two means: of the variances of the 8 and of the 24 pixels around the pixel. So near
    pixels count more. A geometric mean would be 0 where 8 pixels have missed all rare bright samples.
    """

    reach = 2
    rounds = 2

    def request(self, total: np.ndarray, squares: np.ndarray, count: np.ndarray) -> np.ndarray:
        """Requests samples in proportion to the standard deviation."""
        # The variances within pixels. Differences between pixels may be an edge or a texture, which is no noise.
        within = variance(total, squares, count)
        deviation = np.sqrt((mean_around(within, 1) + mean_around(within, Graded.reach)) / 2)
        # With the factor N / threshold, a deviation of N * threshold requests N² samples.
        error = in_display_units(deviation, mean_around(total / count, Graded.reach))
        factor = np.float32(self.n / max(self.threshold, 1e-9))
        return factor * np.where(np.isfinite(deviation), error, np.float32(np.inf))


def error_of_neighbours(total: np.ndarray, squares: np.ndarray, count: int) -> np.ndarray:
    """Returns the standard error of each pixel in display units, estimated from the 24 pixels around it.

    All samples of these pixels are pooled. Their variance also contains the differences between the pixel means. Near
    the border of the arrays, fewer than 24 pixels count; the error is infinite if there are none. ``total`` and
    ``squares``, shape (height, width), are the sums of the luminance and of its square over the ``count`` samples of
    each pixel.
    """
    inverse = np.float32(1 / count)
    first, second = (mean_around(sums * inverse, Neighbours.reach) for sums in (total, squares))  # first two moments
    error = in_display_units(np.sqrt(np.maximum(second - np.square(first), 0) * inverse), first)
    return np.where(np.isfinite(first), error, np.inf)


def mean_around(plane: np.ndarray, reach: int) -> np.ndarray:
    """Returns, for each pixel, the mean of ``plane`` over the pixels around it, shape (height, width).

    The pixels around a pixel are those within ``reach`` rows and columns, without the pixel itself: a decision by a
    pixel's own samples would bias the image (Kirk and Arvo 1991). The mean is infinite if there are none.
    """

    def along_columns(plane: np.ndarray) -> np.ndarray:
        """Returns the sums of the entries up to ``reach`` rows above and below."""
        padded, height = np.pad(plane, ((reach, reach), (0, 0))), len(plane)
        steps = (k for k in range(-reach, reach + 1) if k)
        return sum((padded[reach + k : reach + k + height] for k in steps), np.zeros_like(plane))

    def sum_around(plane: np.ndarray) -> np.ndarray:
        """Returns, for each pixel, the sum over the pixels within ``reach`` rows and columns, without the pixel."""
        # Adds along the rows, and then along the columns of these sums. The middle row is added without the pixel
        # itself.
        in_row = along_columns(plane.T).T
        return in_row + along_columns(in_row + plane)

    number = sum_around(np.ones_like(plane))
    return np.where(number > 0, sum_around(plane) / number, np.float32(np.inf))


#: Allowed values of the integrator's parameter ``adaptive`` -> policy; the default is first.
POLICIES: dict[str, type[Policy]] = {"neighbours": Neighbours, "thesis": Thesis, "none": Policy, "graded": Graded}


def policy_of(plan: Plan) -> Policy:
    """Returns the policy of ``plan``."""
    return POLICIES[plan.sampling.adaptive](plan)
