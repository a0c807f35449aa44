"""One image, band by band from top to bottom: the memory that it takes does not grow with it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi

from . import collector
from .accumulate import Image
from .estimate import Estimate, Estimator
from .plan import Plan, Rectangle, index_within, pixels, widened


def render(
    plan: Plan,
    policy: Any,
    estimator: Estimator,
    image: Image,
    own_aovs: Sequence[str],
    progress: Callable[[float], None] | None = None,
    cancelled: Callable[[], bool] = lambda: False,
    counts: list | None = None,
) -> None:
    """Renders ``image``, by ``policy`` (see :mod:`.policies`).

    ``own_aovs``: names of the channels that say how the image was made, see :func:`own_channel`; ``progress``: called
    after each band with the part done, 0 to 1; ``cancelled``: asked before each band whether to stop; ``counts``: a
    list that gets the number of samples of each pixel, band by band, which together are those of ``plan.region``.
    """
    left, top, right, bottom = plan.region
    rows = max(1, plan.band // (right - left))
    for begin in range(top, bottom, rows):
        if cancelled():
            break
        end = min(begin + rows, bottom)
        band = (left, begin, right, end)
        outer, estimate = take(plan, policy, estimator, band)
        if counts is not None:
            x, y, *_ = pixels(band)
            counts.append(dr.gather(mi.UInt32, estimate.count, index_within(outer, x, y)))
        inverse = dr.rcp(mi.Float(estimate.count))
        image.add(
            outer,
            band,
            [s * inverse for s in estimate.sums],
            [own_channel(name, estimate, plan.n) for name in own_aovs],
            plan.reach,
        )
        if progress is not None or end < bottom:
            image.wait()  # bounds the memory, and lets progress be true
        if progress is not None:
            progress((end - top) / (bottom - top))


@collector.suspended()
def take(plan: Plan, policy: Any, estimator: Estimator, band: Rectangle) -> tuple[Rectangle, Estimate]:
    """The samples of the pixels of ``band``, wave by wave: ``(outer, estimate)``, laid out over the rectangle
    ``outer``.

    The neighbours around the band that the policy looks at are taken too: samples are pure, so they are the same as in
    their own band.
    """
    outer = widened(band, policy.reach, plan.domain)
    x, y, *size = pixels(outer)
    estimate = estimator.take(x, y, 0, policy.first, policy.quiet)
    dr.eval(estimate)
    for where, begin, end in policy.waves(estimate, x, y, size, band):
        if dr.width(where) == 0:
            continue
        more = estimator.take(dr.gather(mi.Int32, x, where), dr.gather(mi.Int32, y, where), begin, end, policy.quiet)
        dr.eval(more)
        estimate.add(more, where)
    return outer, estimate


#: Channels that say how the image was made; any other AOV is one of Mitsuba's ``aov`` integrator.
OWN_AOVS = ("samples", "error")


def own_channel(name: str, estimate: Estimate, n: int) -> mi.Float:
    """``samples``: of each pixel; ``error``: the standard error of its luminance."""
    return mi.Float(estimate.count) if name == "samples" else estimate.error(n)
