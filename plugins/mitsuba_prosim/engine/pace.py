"""Portions that take about a second, so that what is kept of an image is never old."""

from __future__ import annotations

import time

from .state import State


class Pace:
    """Bounds the portions of ``state`` by the time that the last one took; whatever their size, the samples are the
    same.
    """

    #: Seconds of a portion.
    SHORTEST, LONGEST = 0.5, 2.0
    #: Samples of the first: few, as nobody knows yet how slow they are. From one to the next they become so many times
    #: as many, at most.
    FIRST, GROWTH = 1 << 14, 16

    def __init__(self, state: State) -> None:
        self.state = state
        self.begun: float | None = None

    def look(self) -> None:
        """At the end of a portion."""
        if self.begun is None:
            return
        plan, took = self.state.plan, time.perf_counter() - self.begun
        most = plan.band * max(plan.n**2, plan.full)
        portion = most if self.state.portion is None else self.state.portion
        if took > self.LONGEST:
            self.state.portion = max(1, int(portion / took))
        elif took < self.SHORTEST and portion < most:
            self.state.portion = int(portion * min(1 / max(took, 1e-9), self.GROWTH))

    def go_on(self) -> None:
        """Before the next portion."""
        self.begun = time.perf_counter()
