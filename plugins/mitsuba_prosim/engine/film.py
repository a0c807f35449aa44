"""Computes the values of the film's pixels from the sums of the samples."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi

from ..alone import alone
from ..compat import denormals_rounded, double, dr_array
from .pixel_set import PixelSet
from .plan import pixels, pixels_around


def put(film: mi.Film, values: mi.TensorXf, aov_names: Sequence[str]) -> None:
    """Replaces the content of ``film`` by ``values``; the earlier content may belong to another image."""
    film.prepare(aov_names)
    film.put_block(mi.ImageBlock(values, mi.ScalarPoint2i(film.crop_offset()), border=False))


@alone()
@denormals_rounded()
def film_values(image: PixelSet) -> mi.TensorXf:
    """Returns the values that the film stores for the crop window of the image so far, shape (height, width, channels).

    If ``image`` is a second image, it must be complete. The value of a pixel is a sum of
    contributions from all pixels within the filter's radius, which are added row by row; each contribution is divided
    by the number of samples of the pixel from which it comes. A pixel without samples contributes nothing. The channels
    ``samples`` and ``error`` (:data:`.OWN_AOVS`) are multiplied by the pixel's sum of filter weights, because a film
    divides all channels by this sum.
    """
    plan, channels, sums = image.plan, image.estimator.channels, image.accumulators
    left, top, right, bottom = plan.window
    x, y = pixels(plan.window)
    Double = double()
    totals, first = [Double(0) for _ in channels.names], dr.opaque(mi.UInt32, image.own.start)
    sources = list(pixels_around(x, y, image.estimator.reach, plan.region, image.outer))
    # The sums of a pixel begin with those for the upper left pixel within the filter's reach; for this pixel, the
    # source is the lower right one. So the sources come row after row if the sums are taken from the last to the first.
    for place, (index, active) in zip(reversed(range(len(sources))), sources):
        row = index + first
        count = dr.gather(mi.UInt32, sums.count, row, active)
        weight = dr.select(count > 0, dr.rcp(Double(count)), 0)
        values = sums.film_sums(row, place, len(channels.names), active)
        totals = [total + weight * value for total, value in zip(totals, values)]
    weight, (index, _) = totals[channels.names.index("W")], sources[len(sources) // 2]
    for name in channels.own_aovs:
        statistic = dr_array(image.count if name == "samples" else image.error())
        totals.append(weight * mi.Float(dr.gather(type(statistic), statistic, index)))
    values = dr.ravel(mi.ArrayXf([mi.Float(total) for total in totals]))
    dr.eval(values)
    return mi.TensorXf(values, (bottom - top, right - left, len(totals)))
