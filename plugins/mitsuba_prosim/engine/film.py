"""Computes the values of the film's pixels from the sums of the samples."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi

from ..alone import alone
from ..compat import denormals_rounded, double, dr_array
from .pixel_set import PixelSet
from .plan import indexer, pixels


def put(film: mi.Film, values: mi.TensorXf, aov_names: Sequence[str]) -> None:
    """Replaces the content of ``film`` by ``values``; the earlier content may belong to another image."""
    film.prepare(aov_names)
    film.put_block(mi.ImageBlock(values, mi.ScalarPoint2i(film.crop_offset()), border=False))


@alone()
@denormals_rounded()
def film_values(image: PixelSet) -> mi.TensorXf:
    """Returns the values that the film stores for the crop window of the image so far, shape (height, width, channels).

    If ``image`` is a second image, it must be complete. The value of a pixel is a sum of contributions from all pixels
    within the filter's radius, which are added row by row; each contribution is divided by the number of samples of the
    pixel from which it comes. A pixel without samples contributes nothing. The channels ``samples`` and ``error``
    (:data:`.OWN_AOVS`) are multiplied by the pixel's sum of filter weights, because a film divides all channels by this
    sum.
    """
    plan, channels, sums = image.plan, image.estimator.channels, image.accumulators
    left, top, right, bottom = plan.window
    x, y = pixels(plan.window)
    Double, reach = double(), image.estimator.reach
    side, first = 2 * reach + 1, dr.opaque(mi.UInt32, image.own.start)
    index_of = indexer(plan.region, image.outer)

    def add(totals: list[mi.Float64], k: mi.UInt32) -> tuple[list[mi.Float64], mi.UInt32]:
        """Adds the contribution of neighbour number ``k``, row by row, of the pixels within the filter's reach."""
        index, active = index_of(x + mi.Int32(k % side) - reach, y + mi.Int32(k // side) - reach)
        row = index + first
        count = dr.gather(mi.UInt32, sums.count, row, active)
        weight = dr.select(count > 0, dr.rcp(Double(count)), 0)
        # The sums of a pixel begin with those for the upper left pixel within the filter's reach; for this pixel, the
        # neighbour is the lower right one.
        values = sums.film_sums(row, side**2 - 1 - k, len(channels.names), active)
        return [total + weight * value for total, value in zip(totals, values)], k + 1

    start = [dr.zeros(Double, len(x)) for _ in channels.names], dr.zeros(mi.UInt32, len(x))
    totals, _ = dr.while_loop(start, lambda _, k: k < side**2, add, labels=("totals", "k"), max_iterations=-1)
    weight, index = totals[channels.names.index("W")], index_of(x, y)[0]
    for name in channels.own_aovs:
        statistic = dr_array(image.count if name == "samples" else image.error())
        totals.append(weight * mi.Float(dr.gather(type(statistic), statistic, index)))
    values = dr.ravel(mi.ArrayXf([mi.Float(total) for total in totals]))
    dr.eval(values)
    return mi.TensorXf(values, (bottom - top, right - left, len(totals)))
