"""Every pixel gets all samples."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import mitsuba as mi

from ..plan import Plan, Rectangle

if TYPE_CHECKING:
    from ..estimate import Estimate


class Everything:
    """Takes all samples in one wave."""

    reach = 0
    quiet = None

    def __init__(self, plan: Plan, threshold: float) -> None:
        self.first = plan.most

    def waves(
        self, estimate: Estimate, x: mi.Int32, y: mi.Int32, size: list[mi.UInt32], band: Rectangle
    ) -> Iterable[tuple[mi.UInt32, int, int]]:
        """No further waves."""
        return ()
