"""The thesis's criterion, to the letter (section 5.3.2): pass after pass until the pixel's own samples are quiet."""

from __future__ import annotations

from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

from ..error import standard_error
from ..plan import Plan

if TYPE_CHECKING:
    from ..estimate import Estimate


class Thesis:
    """Ends a pixel as soon as the standard error of its own samples is at most the threshold, in units of radiance.

    Deciding by the samples that make the estimate biases it (Kirk and Arvo 1991).
    """

    reach = 0
    judgements = 1

    def __init__(self, plan: Plan, threshold: float) -> None:
        self.first, self.full = plan.least, plan.full
        self.threshold = dr.opaque(mi.Float, threshold)

    def quiet(self, total: mi.Float, squares: mi.Float, t: mi.UInt32) -> mi.Bool:
        """Which pixels end, by the sums of the luminance and of its square over ``t`` samples."""
        return (t >= self.first) & (standard_error(total, squares, mi.Float(t)) <= self.threshold)

    def need(self, estimate: Estimate, width: mi.UInt32, height: mi.UInt32) -> mi.Float:
        """All samples, of which a pixel takes as many as it is not ``quiet``."""
        return dr.full(mi.Float, self.full, dr.width(estimate.count))
