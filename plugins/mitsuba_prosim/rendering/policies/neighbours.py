"""All passes where the pixels around are noisy; the pixel itself has no say."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..error import in_display_units
from ..plan import Plan

#: Reach of the neighbourhood: 5 x 5 pixels. Sees an outlier that 3 x 3 miss; and what is noisy is found in time, also
#: where the first samples of the very next pixels happen to agree.
REACH = 2


class Neighbours:
    """A first wave everywhere, then all other passes where the 24 pixels around suggest a standard error above the
    threshold, in display units."""

    quiet = None

    def __init__(self, plan: Plan, threshold: float):
        self.first, self.last, self.n = plan.least_passes, plan.most_passes, plan.n
        self.reach = REACH if self.first < self.last else 0
        self.threshold = dr.opaque(mi.Float, threshold)

    def waves(self, estimate, x, y, size, band):
        """One further wave, for the noisy pixels of ``band``."""
        if self.first == self.last:
            return
        error = error_of_neighbours(estimate.total, estimate.squares, mi.Float(self.first * self.n), *size)
        left, top, right, bottom = (dr.opaque(mi.Int32, v) for v in band)
        inside = (x >= left) & (x < right) & (y >= top) & (y < bottom)
        noisy = dr.compress(inside & (error > self.threshold))
        if dr.width(noisy) > 0:
            yield noisy, self.first, self.last


def error_of_neighbours(total, squares, count, width, height):
    """Standard error in display units that the 24 pixels around each pixel suggest for it.

    The pixel itself has no say: a decision by the very samples that are averaged would bias the image (Kirk and Arvo
    1991). ``total``, ``squares``: sums of the luminance and of its square over ``count`` samples, one entry a pixel,
    row by row; ``width``, ``height``: opaque integers. Beyond the border lies the mirror image.
    """
    width, height = mi.Int32(width), mi.Int32(height)
    i = dr.arange(mi.Int32, dr.width(total))
    y = i // width
    x = i - y * width
    steps = [k for k in range(-REACH, REACH + 1) if k]
    # First along the rows, then along the columns of their sums; the middle row is taken without the pixel.
    beside = [sum(dr.gather(mi.Float, values, y * width + mirror(x + k, width)) for k in steps)
              for values in (total, squares)]
    rows = [sums + values for sums, values in zip(beside, (total, squares))]
    dr.eval(beside, rows)
    first, second = (sums + sum(dr.gather(mi.Float, row, mirror(y + k, height) * width + x) for k in steps)
                     for sums, row in zip(beside, rows))
    taken = count * ((2 * REACH + 1) ** 2 - 1)
    first, second = first / taken, second / taken
    return in_display_units(dr.sqrt(dr.maximum(second - dr.square(first), 0) / count), first)


def mirror(x, size):
    """Index ``x`` brought into 0 .. ``size`` - 1 by reflection at the first and the last one."""
    return dr.clip(size - 1 - dr.abs(size - 1 - dr.abs(x)), 0, size - 1)
