"""An image that grows: what says how many samples it gets, what takes them, and what they come to."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import mitsuba as mi

from .camera import ray_sampler, uncropped
from .derivatives import Derivatives
from .estimate import Estimator
from .pace import Pace
from .part import Part
from .plan import Plan
from .policies import POLICIES
from .record import Record
from .snapshot import Reached, Snapshot, put
from .state import State
from .taking import Taker
from .target import Target
from .waves import waves


class Growth:
    """The image of ``plan``, or a ``part`` of it, without samples at first. ``estimator`` takes them; ``own_aovs`` are
    the names of what the image says of itself; ``taker``: of :class:`.State`.
    """

    def __init__(
        self,
        plan: Plan,
        estimator: Estimator,
        own_aovs: Sequence[str],
        part: Part | None = None,
        taker: Taker | None = None,
    ) -> None:
        policy: Any = POLICIES[plan.sampling.adaptive](plan, plan.sampling.threshold)
        self.policy = policy
        self.state = State(plan, estimator, own_aovs, policy.judgements * policy.reach, part, taker)
        self._paced = taker is None  # others have a pace of their own
        self.target = _target(plan, time.perf_counter())
        self._done = False

    def restore(self, begin: Record) -> None:
        """Goes on from there. Raises ValueError where ``begin`` belongs to another image."""
        begin.restore(self.state)
        self.target = _target(self.state.plan, time.perf_counter() - begin.facts["seconds"])
        self._done = begin.finished and begin.same_aim(self.state)

    def waves(
        self,
        tell: Callable[[float], None] | None = None,
        keep: Callable[[Callable[[], Record], bool], None] | None = None,
        cancelled: Callable[[], bool] = lambda: False,
    ) -> Iterator[Growth]:
        """Takes the samples, and yields itself after each wave; ``keep`` is called as often as ``tell``, and has
        portions of about a second.
        """
        if self._done:
            yield self
            return
        state, estimator = self.state, self.state.estimator
        pace = Pace(state) if keep is not None and self._paced else None
        if pace is not None:
            state.portion = Pace.FIRST

        def pause() -> bool:
            if pace is not None:
                pace.look()
            if keep is not None:
                keep(lambda: self.record(False), False)
            if pace is not None:
                pace.go_on()
            return cancelled()

        steps = waves(state.plan, self.policy, state, self.target, tell, pause)
        while True:
            with uncropped(estimator.sensor):
                estimator.rays = estimator.rays or ray_sampler(estimator.sensor)
                if next(steps, None) is None:
                    return
            yield self

    def reached(self) -> Reached:
        """How far it came."""
        return Reached.of(self.state, self.target.passed)

    def snapshot(self, reached: Reached) -> Snapshot:
        """What can be seen of it."""
        return Snapshot(self.state, self._film, reached)

    def so_far(self) -> Snapshot | None:
        """What can be seen of it within a wave. None where that is no more than after the last one: where sums are not
        kept; and where there is a crop window, which the film has only between two waves.
        """
        plan, size = self.state.plan, self._film.size()
        if plan.window != (0, 0, int(size[0]), int(size[1])) or not self.state.current:
            return None
        return self.snapshot(self.reached())

    def record(self, finished: bool) -> Record:
        """What a process that goes on with it has to know."""
        return Record.of(self.state, self.target.passed, finished)

    def put(self) -> None:
        """Makes it what its film holds."""
        put(self.state, self._film)

    def derivatives(self, attached: Any) -> Derivatives:
        """Those of the image so far, by its very samples; ``attached``: the transport with derivatives."""
        self.state.estimator.transport = attached
        return Derivatives(self.state.plan, self.state.estimator, self.state.image(), self.state.counts())

    @property
    def _film(self) -> mi.Film:
        return self.state.estimator.sensor.film()


def _target(plan: Plan, begun: float) -> Target:
    return Target(plan.sampling.noise, plan.sampling.time, begun, plan.sampling.noise_99)
