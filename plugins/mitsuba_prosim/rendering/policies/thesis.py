"""The thesis's criterion, to the letter (section 5.3.2): pass after pass until the pixel's own samples are quiet."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..error import standard_error
from ..plan import Plan


class Thesis:
    """Ends a pixel as soon as the standard error of its own samples is at most the threshold, in units of radiance.

    Deciding by the samples that make the estimate biases it (Kirk and Arvo 1991).
    """

    reach = 0

    def __init__(self, plan: Plan, threshold: float):
        self.first = plan.most
        self.least = plan.least
        self.threshold = dr.opaque(mi.Float, threshold)

    def quiet(self, total, squares, t):
        """Which pixels end, by the sums of the luminance and of its square over ``t`` samples."""
        return (t >= self.least) & (standard_error(total, squares, mi.Float(t)) <= self.threshold)

    def waves(self, estimate, x, y, size, band):
        """No further waves: each pixel decides within the first."""
        return ()
