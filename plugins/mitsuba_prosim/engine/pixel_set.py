"""Pixels that are sampled together."""

from __future__ import annotations

import mitsuba as mi

from .accumulators import Accumulators
from .estimator import Estimator
from .plan import Plan, Rectangle


class PixelSet:
    """Pixels that are sampled together: an image, or an independent second image of some of its pixels."""

    plan: Plan
    estimator: Estimator
    #: The rectangle of the pixels, row by row, if the set is a whole image.
    outer: Rectangle
    #: Coordinates of each pixel, and the sums over its samples.
    x: mi.Int32
    y: mi.Int32
    accumulators: Accumulators
