"""Policies: how many samples each pixel gets (sections 4.2.1.1 and 5.3.2)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

from .error import in_display_units, standard_error, variance
from .plan import Plan

if TYPE_CHECKING:
    from .accumulators import Accumulators


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
        self.plan = plan

    @property
    def threshold(self) -> mi.Float:
        """The integrator's parameter; opaque, so that one kernel serves all values."""
        return dr.opaque(mi.Float, self.plan.sampling.threshold)

    def request(self, accumulators: Accumulators, width: mi.UInt32, height: mi.UInt32) -> mi.Float:
        """The requested total samples of each pixel of a rectangle, row by row. ``accumulators``: those of the
        rectangle after a pass; ``width``, ``height``: opaque integers. The plan rounds the result up to a power of two
        and limits it.
        """
        return dr.full(mi.Float, self.noisy_samples, dr.width(accumulators.count))

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
        return (t >= self.first_samples) & (standard_error(total, squares, mi.Float(t)) <= self.threshold)


class Neighbours(Policy):
    """All samples where the 24 pixels around suggest a standard error above the threshold, in display units.

    5 x 5 pixels show an outlier that 3 x 3 miss, and noise where the first samples of the nearest pixels agree.
    """

    reach = 2

    def request(self, accumulators: Accumulators, width: mi.UInt32, height: mi.UInt32) -> mi.Float:
        """All samples for the noisy pixels."""
        sums = accumulators.total, accumulators.squares
        error = error_of_neighbours(*sums, mi.Float(self.first_samples), width, height)
        # NaN counts as noisy.
        return dr.select(error <= self.threshold, mi.Float(self.first_samples), self.noisy_samples)


class Graded(Policy):
    """Samples in proportion to the standard deviation that the 48 pixels around suggest, in display units, which makes
    the most of a number of samples (Neyman 1934): N² where these would bring the standard error down to the threshold.

    It decides after each pass: the first one misses rare events. It looks at 7 x 7 pixels, as few samples show little
    of a variance.
    """

    reach = 3
    rounds = 2

    def request(self, accumulators: Accumulators, width: mi.UInt32, height: mi.UInt32) -> mi.Float:
        """In proportion to the standard deviation."""
        # The mean variance within the pixels: differences between them may be an edge or a texture, which is no noise.
        count = mi.Float(accumulators.count)
        own = [variance(accumulators.total, accumulators.squares, count), accumulators.total / count]
        within, mean = around(own, width, height, Graded.reach)
        scale = dr.opaque(mi.Float, self.plan.n / max(self.plan.sampling.threshold, 1e-9))
        return scale * dr.select(dr.isfinite(within), in_display_units(dr.sqrt(within), mean), dr.inf)


def error_of_neighbours(
    total: mi.Float, squares: mi.Float, count: mi.Float, width: mi.UInt32, height: mi.UInt32
) -> mi.Float:
    """Standard error in display units that the 24 pixels around each pixel suggest, or fewer at the border of the
    sampled pixels; infinite without any.

    ``total``, ``squares``: sums of the luminance and of its square over ``count`` samples, one entry a pixel, row by
    row.
    """
    first, second = around([total / count, squares / count], width, height, Neighbours.reach)
    error = in_display_units(dr.sqrt(dr.maximum(second - dr.square(first), 0) / count), first)
    return dr.select(dr.isfinite(first), error, dr.inf)


def around(arrays: list[mi.Float], width: mi.UInt32, height: mi.UInt32, reach: int) -> list[mi.Float]:
    """Means over the other pixels within ``reach`` of each pixel, in rows and columns, as far as they are sampled;
    infinite without any. One entry a pixel, row by row; ``width``, ``height``: opaque integers.

    The pixel itself is left out: a decision by the samples that are averaged would bias the image (Kirk and Arvo
    1991).
    """
    width, height = mi.Int32(width), mi.Int32(height)
    i = dr.arange(mi.Int32, dr.width(arrays))
    y = i // width
    x = i - y * width
    steps = [k for k in range(-reach, reach + 1) if k]

    def along(values: mi.Float, place: mi.Int32, size: mi.Int32, stride: int | mi.Int32) -> mi.Float:
        """Sums of the entries up to ``reach`` before and after, without those beyond the border."""
        return sum(dr.gather(mi.Float, values, i + k * stride, (place + k >= 0) & (place + k < size)) for k in steps)

    # First along the rows, then along the columns of their sums; the middle row is taken without the pixel.
    dr.eval(arrays)
    in_row = [along(values, x, width, 1) for values in arrays]
    rows = [sums + values for sums, values in zip(in_row, arrays)]
    dr.eval(in_row, rows)
    sums = [sums + along(row, y, height, width) for sums, row in zip(in_row, rows)]

    def within(place: mi.Int32, size: mi.Int32) -> mi.Int32:
        return dr.minimum(place + reach, size - 1) - dr.maximum(place - reach, 0) + 1

    others = mi.Float(within(x, width) * within(y, height) - 1)
    return [dr.select(others > 0, values / others, dr.inf) for values in sums]


#: The values of the integrator's parameter ``adaptive``, the default first.
POLICIES: dict[str, type[Policy]] = {"neighbours": Neighbours, "thesis": Thesis, "none": Policy, "graded": Graded}


def policy_of(plan: Plan) -> Policy:
    """The policy of ``plan``."""
    return POLICIES[plan.sampling.adaptive](plan)
