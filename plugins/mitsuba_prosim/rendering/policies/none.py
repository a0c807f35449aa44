"""Every pixel gets all samples."""

from __future__ import annotations

from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

from ..plan import Plan

if TYPE_CHECKING:
    from ..estimate import Estimate


class Everything:
    """Takes all samples in one wave."""

    reach = 0
    quiet = None

    def __init__(self, plan: Plan, threshold: float) -> None:
        self.first = self.most = plan.most

    def need(self, estimate: Estimate, width: mi.UInt32, height: mi.UInt32) -> mi.Float:
        """All of them."""
        return dr.full(mi.Float, self.most, dr.width(estimate.count))
