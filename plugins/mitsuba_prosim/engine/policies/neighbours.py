"""All samples where the pixels around are noisy; the pixel itself has no say."""

from __future__ import annotations

from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

from ..error import in_display_units
from ..plan import Plan

if TYPE_CHECKING:
    from ..estimate import Estimate

#: Reach of the neighbourhood: 5 x 5 pixels. Sees an outlier that 3 x 3 miss; and what is noisy is found in time, also
#: where the first samples of the very next pixels happen to agree.
REACH = 2


class Neighbours:
    """A first wave everywhere, then all other samples where the 24 pixels around suggest a standard error above the
    threshold, in display units.
    """

    quiet = None
    judgements = 1

    def __init__(self, plan: Plan, threshold: float) -> None:
        self.first, self.full = plan.least, plan.full
        self.reach = REACH if self.first < self.full else 0
        self.threshold = dr.opaque(mi.Float, threshold)

    def need(self, estimate: Estimate, width: mi.UInt32, height: mi.UInt32) -> mi.Float:
        """All samples for the noisy pixels."""
        error = error_of_neighbours(estimate.total, estimate.squares, mi.Float(self.first), width, height)
        return dr.select(error <= self.threshold, mi.Float(self.first), self.full)  # what is no number is noisy too


def error_of_neighbours(
    total: mi.Float, squares: mi.Float, count: mi.Float, width: mi.UInt32, height: mi.UInt32
) -> mi.Float:
    """Standard error in display units that the 24 pixels around each pixel suggest for it, or fewer at the border of
    what is sampled; infinite where there is none.

    ``total``, ``squares``: sums of the luminance and of its square over ``count`` samples, one entry a pixel, row by
    row; ``width``, ``height``: opaque integers.
    """
    first, second = around([total / count, squares / count], width, height, REACH)
    error = in_display_units(dr.sqrt(dr.maximum(second - dr.square(first), 0) / count), first)
    return dr.select(dr.isfinite(first), error, dr.inf)


def around(arrays: list[mi.Float], width: mi.UInt32, height: mi.UInt32, reach: int) -> list[mi.Float]:
    """Means over the other pixels within ``reach`` of each pixel, in rows and columns, as far as they are in what is
    sampled; infinite where there is none. One entry a pixel, row by row; ``width``, ``height``: opaque integers.

    The pixel itself has no say: a decision by the very samples that are averaged would bias the image (Kirk and Arvo
    1991).
    """
    width, height = mi.Int32(width), mi.Int32(height)
    i = dr.arange(mi.Int32, dr.width(arrays))
    y = i // width
    x = i - y * width
    steps = [k for k in range(-reach, reach + 1) if k]

    def along(values: mi.Float, place: mi.Int32, size: mi.Int32, stride: int | mi.Int32) -> mi.Float:
        """Sums of the entries up to ``reach`` before and after, those beyond the border left out."""
        return sum(dr.gather(mi.Float, values, i + k * stride, (place + k >= 0) & (place + k < size)) for k in steps)

    # First along the rows, then along the columns of their sums; the middle row is taken without the pixel.
    dr.eval(arrays)
    beside = [along(values, x, width, 1) for values in arrays]
    rows = [sums + values for sums, values in zip(beside, arrays)]
    dr.eval(beside, rows)
    sums = [sums + along(row, y, height, width) for sums, row in zip(beside, rows)]

    def within(place: mi.Int32, size: mi.Int32) -> mi.Int32:
        return dr.minimum(place + reach, size - 1) - dr.maximum(place - reach, 0) + 1

    others = mi.Float(within(x, width) * within(y, height) - 1)
    return [dr.select(others > 0, values / others, dr.inf) for values in sums]
