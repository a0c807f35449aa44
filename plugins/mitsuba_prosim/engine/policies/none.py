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
    judgements = 1

    def __init__(self, plan: Plan, threshold: float) -> None:
        self.first = plan.most if plan.full == plan.most else plan.least
        self.full = plan.full

    def need(self, estimate: Estimate, width: mi.UInt32, height: mi.UInt32) -> mi.Float:
        """As many as any other."""
        return dr.full(mi.Float, self.full, dr.width(estimate.count))
