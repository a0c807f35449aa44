"""Portions of an image that somebody looks at: short, as it is between two of them that something else may be wished,
and that more is to be seen.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from time import perf_counter as clock

import drjit as dr
import mitsuba as mi

from ..engine.estimate import Estimate
from ..engine.taking import Here, Portion
from ..scene import rendering

#: Seconds that the samples of a portion take, at least and at most, and their part of the time since the image was
#: begun: who has waited for it already can wait a little longer.
SHORTEST, LONGEST, SHARE = 0.2, 0.3, 0.5

#: Before them Dr.Jit follows the code, which takes as long for few samples as for many: this part of their time, up to
#: where that is so many seconds.
FOLLOWING, LONG = 0.2, 1.0

#: No portion may have more than so many times the samples of the one before: those of the next pixels may be slower.
GROWTH = 2

#: What is left, up to so many portions, is one.
LAST = 1.25


class Growing(Here):
    """Takes the samples in this process, in portions that grow with the time that the image takes."""

    def __init__(self) -> None:
        self._begun = clock()
        self._samples_a_second = float(rendering.samples_of_a_step())
        self._bound = rendering.samples_of_a_step()
        self._following: list[float] = []

    def bound(self, most: int | None, left: int) -> int | None:
        """As many as it takes until somebody is heard again."""
        seconds = min(max(SHORTEST, SHARE * (clock() - self._begun)), LONGEST)
        if self._following:  # the first time kernels may have been compiled
            seconds = max(seconds, min(min(self._following) / FOLLOWING, LONG))
        samples = max(1, int(min(seconds * self._samples_a_second, GROWTH * self._bound)))
        self._bound = samples
        samples = left if left < LAST * samples else samples
        return samples if most is None else min(samples, most)

    def __call__(
        self, portions: Iterator[Portion], cancelled: Callable[[], bool], in_order: bool
    ) -> Iterator[tuple[Portion, Estimate]]:
        """Takes them."""
        for portion in portions:
            if cancelled():
                return
            begun = clock()
            more = portion.take()
            followed = begun if at_once() else clock()
            dr.sync_thread()  # as whoever has it does, who may then wait for other things as well
            self._following = [*self._following[-1:], followed - begun]
            self._samples_a_second = portion.work / max(clock() - followed, 1e-3)
            yield portion, more


def at_once() -> bool:
    """Whether kernels have run when they are launched, as where Dr.Jit has one thread. How long the code was followed
    before is not known then.
    """
    return dr.backend_v(mi.Float) == dr.JitBackend.LLVM and dr.thread_count() == 1
