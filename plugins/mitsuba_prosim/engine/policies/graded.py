"""As many samples as the error asks for that the pixels around suggest; the pixel itself has no say."""

from __future__ import annotations

from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

from ..error import in_display_units, variance
from ..plan import Plan
from .neighbours import around

#: Reach of the neighbourhood: 7 x 7 pixels, as few samples say little of a variance.
REACH = 3

if TYPE_CHECKING:
    from ..estimate import Estimate


class Graded:
    """A first wave everywhere, then samples in proportion to the standard deviation that the 48 pixels around suggest,
    in display units, which makes the most of a number of samples (Neyman 1934): N² where these would bring the
    standard error down to the threshold. Judged again after each wave: the first one misses what is rare.
    """

    quiet = None
    judgements = 2

    def __init__(self, plan: Plan, threshold: float) -> None:
        self.first = plan.least
        self.reach = REACH if self.first < plan.most else 0
        self.scale = dr.opaque(mi.Float, plan.n / max(threshold, 1e-9))

    def need(self, estimate: Estimate, width: mi.UInt32, height: mi.UInt32) -> mi.Float:
        """In proportion to the standard deviation."""
        return self.scale * deviation(estimate, width, height)


def deviation(estimate: Estimate, width: mi.UInt32, height: mi.UInt32) -> mi.Float:
    """Standard deviation of a sample in display units, as the 48 pixels around each pixel suggest it; infinite where
    there are none.

    It is the variance *within* these pixels, averaged: what differs between them may be an edge or a texture, which is
    no noise.
    """
    count = mi.Float(estimate.count)
    own = [variance(estimate.total, estimate.squares, count), estimate.total / count]
    within, mean = around(own, width, height, REACH)
    return dr.select(dr.isfinite(within), in_display_units(dr.sqrt(within), mean), dr.inf)
