"""Policies: how many samples each pixel gets (sections 4.2.1.1 and 5.3.2)."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from .error import in_display_units, standard_error, variance
from .plan import Plan


class Policy:
    """Every pixel gets all samples: the policy ``none``, and the base class of the others.

    A subclass overrides the differences.
    """

    #: How many pixels around a pixel the policy looks at.
    reach = 0
    #: How often the policy decides, each time after a pass over the image. If more than once, it decides after every
    #: pass with an error target.
    rounds = 1

    def __init__(self, plan: Plan) -> None:
        #: Samples of every pixel in the first pass; and those of a noisy pixel.
        self.first_samples, self.noisy_samples = plan.min_samples, plan.noisy_samples
        if type(self) is Policy and plan.noisy_samples == plan.max_samples:
            self.first_samples = plan.max_samples
        if self.first_samples >= plan.max_samples:
            self.reach = 0
        #: The integrator's parameter; and N.
        self.threshold, self.n = plan.sampling.threshold, plan.n

    def request(self, total: np.ndarray, squares: np.ndarray, count: np.ndarray) -> np.ndarray:
        """The requested total samples of each pixel of a rectangle, shape (height, width), by the sums of the luminance
        and of its square over ``count`` samples, 32-bit floats of that shape. The plan rounds the result up to a power
        of two and limits it.
        """
        return np.full(count.shape, self.noisy_samples)

    def converged(self, total: mi.Float, squares: mi.Float, t: mi.UInt32) -> mi.Bool:
        """Which pixels need no sample beyond the first ``t``, a whole number of passes, by the sums of the luminance
        and of its square; none if the policy does not decide by the pixel itself.
        """
        return mi.Bool(False)


class Thesis(Policy):
    """Ends a pixel as soon as the standard error of its own samples is at most the threshold, in units of radiance.

    The thesis's criterion to the letter (section 5.3.2). Deciding by the samples that make the estimate biases it (Kirk
    and Arvo 1991).
    """

    def converged(self, total: mi.Float, squares: mi.Float, t: mi.UInt32) -> mi.Bool:
        """Whether the standard error is at most the threshold."""
        threshold = dr.opaque(mi.Float, self.threshold)  # one kernel serves all values
        return (t >= self.first_samples) & (standard_error(total, squares, mi.Float(t)) <= threshold)


class Neighbours(Policy):
    """All samples where the 24 pixels around suggest a standard error above the threshold, in display units.

    5 x 5 pixels show an outlier that 3 x 3 miss, and noise where the first samples of the nearest pixels agree.
    """

    reach = 2

    def request(self, total: np.ndarray, squares: np.ndarray, count: np.ndarray) -> np.ndarray:
        """All samples for the noisy pixels."""
        error = error_of_neighbours(total, squares, self.first_samples)
        return np.where(error <= self.threshold, self.first_samples, self.noisy_samples)  # NaN counts as noisy


class Graded(Policy):
    """Samples in proportion to the standard deviation that the 48 pixels around suggest, in display units, which makes
    the most of a number of samples (Neyman 1934): N² where these would bring the standard error down to the threshold.

    It decides after each pass: the first one misses rare events. It looks at 7 x 7 pixels, as few samples show little
    of a variance.
    """

    reach = 3
    rounds = 2

    def request(self, total: np.ndarray, squares: np.ndarray, count: np.ndarray) -> np.ndarray:
        """In proportion to the standard deviation."""
        # The mean variance within the pixels: differences between them may be an edge or a texture, which is no noise.
        within = mean_around(variance(total, squares, count), Graded.reach)
        error = in_display_units(np.sqrt(within), mean_around(total / count, Graded.reach))
        return np.float32(self.n / max(self.threshold, 1e-9)) * np.where(np.isfinite(within), error, np.float32(np.inf))


def error_of_neighbours(total: np.ndarray, squares: np.ndarray, count: int) -> np.ndarray:
    """Standard error in display units that the 24 pixels around each pixel suggest, or fewer at the border of the
    sampled pixels; infinite without any.

    ``total``, ``squares``: sums of the luminance and of its square over ``count`` samples, shape (height, width).
    """
    share = np.float32(1 / count)
    first, second = (mean_around(sums * share, Neighbours.reach) for sums in (total, squares))
    error = in_display_units(np.sqrt(np.maximum(second - np.square(first), 0) * share), first)
    return np.where(np.isfinite(first), error, np.inf)


def mean_around(plane: np.ndarray, reach: int) -> np.ndarray:
    """Means of ``plane``, shape (height, width), over the other pixels within ``reach`` of each pixel, in rows and
    columns, as far as they are sampled; infinite without any.

    The pixel itself is left out: a decision by the samples that are averaged would bias the image (Kirk and Arvo
    1991).
    """

    def along_columns(plane: np.ndarray) -> np.ndarray:
        """Sums of the entries up to ``reach`` above and below."""
        padded, height = np.pad(plane, ((reach, reach), (0, 0))), len(plane)
        steps = (k for k in range(-reach, reach + 1) if k)
        return sum((padded[reach + k : reach + k + height] for k in steps), np.zeros_like(plane))

    def others(plane: np.ndarray) -> np.ndarray:
        # First along the rows, then along the columns of their sums; the middle row is taken without the pixel.
        in_row = along_columns(plane.T).T
        return in_row + along_columns(in_row + plane)

    number = others(np.ones_like(plane))
    return np.where(number > 0, others(plane) / number, np.float32(np.inf))


#: The values of the integrator's parameter ``adaptive``, the default first.
POLICIES: dict[str, type[Policy]] = {"neighbours": Neighbours, "thesis": Thesis, "none": Policy, "graded": Graded}


def policy_of(plan: Plan) -> Policy:
    """The policy of ``plan``."""
    return POLICIES[plan.sampling.adaptive](plan)
