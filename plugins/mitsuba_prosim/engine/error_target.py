"""Until an image is good enough: the error target, how the error is estimated, and the passes that reach it."""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..sampling.hash import hash32
from .error import displayed, in_display_units, variance
from .estimate import Estimate
from .plan import UNLIMITED, Plan, area, pixels
from .state import State
from .work import Limit, Pass, WorkItem, photon_steps, portions

#: Seconds of a work item where the time ends the image, at most; and its part of that time.
STEP, SHARE = 0.5, 0.01

#: A photon set is worth while for so many times fewer samples than it has photons, or than all pixels take.
SPARSE = 2


@dataclass(frozen=True)
class ErrorTarget:
    """When an image is good enough. ``noise``: root mean square over the pixels of the error of the displayed value,
    white being 1; ``noise_99`` and ``noise_999``: what that of 99 pixels in 100, and of 999 in 1000, is within;
    ``seconds`` from the beginning. 0: not asked for. All of the noise that is asked for, or the time, whichever comes
    first, end it.
    """

    noise: float = 0.0
    seconds: float = 0.0
    begun: float = field(default_factory=time.perf_counter)
    noise_99: float = 0.0
    noise_999: float = 0.0

    @classmethod
    def of(cls, plan: Plan, passed: float) -> ErrorTarget:
        """What ``plan`` asks for; ``passed``: seconds since the beginning."""
        sampling = plan.sampling
        begun = time.perf_counter() - passed
        return cls(sampling.noise, sampling.time, begun, sampling.noise_99, sampling.noise_999)

    def __bool__(self) -> bool:
        return self.noisy or self.seconds > 0

    @property
    def noisy(self) -> bool:
        """Whether it is a noise that is asked for."""
        return self.noise > 0 or self.noise_99 > 0 or self.noise_999 > 0

    def excess(self, state: State) -> float:
        """The noise of ``state``, as measured last, over the one asked for; the worst of those."""
        asked = ((state.noise, self.noise), (state.noise_99, self.noise_99), (state.noise_999, self.noise_999))
        return min(max((measured / most for measured, most in asked if most), default=np.nan), 1e100)

    def remaining(self, state: State, aim: float) -> float:
        """The samples in the end over those so far, where the noise is to be ``aim`` times the one asked for: they grow
        with the inverse square of the noise.
        """
        return (self.excess(state) / aim) ** 2

    @property
    def passed(self) -> float:
        """Seconds since the beginning."""
        return time.perf_counter() - self.begun

    @property
    def left(self) -> float:
        """Seconds until the end."""
        return self.seconds - self.passed if self.seconds else np.inf

    @property
    def over(self) -> bool:
        """Whether the time is up."""
        return self.left <= self.seconds * SHARE

    def portion(self, state: State, speed: float) -> int | None:
        """Samples of a work item that is short beside the time that is asked for, where a pixel gets ``speed`` samples
        in a second; None: any number, as no time is.
        """
        seconds = min(STEP, self.seconds * SHARE)
        return max(1, int(speed * dr.width(state.estimate.count) * seconds)) if seconds else None


class SecondImage:
    """Estimates the error: an independent image of some pixels alone. How it differs from the first says what error
    both have, whatever the distribution of the samples is worth in this scene.

    (The variance of the samples within a pixel does not: well distributed samples can be ten times as good.)
    """

    #: One pixel in so many, and at least so many pixels.
    ONE_IN, LEAST = 16, 4096
    #: Where the image has fewer pixels than this, whose differences could all happen to be small, each is there several
    #: times, but no more often than so many times.
    FEW, MOST = 512, 64

    def __init__(self, state: State) -> None:
        x, y, *_ = pixels(state.plan.region)
        index = state.index(x, y)
        every = max(1, min(self.ONE_IN, area(state.plan.region) // self.LEAST))
        chosen = dr.compress(hash32(hash32(index) + 1) % every == 0) if every > 1 else dr.arange(mi.UInt32, dr.width(x))
        size = dr.width(chosen)
        self.copies = min(-(-self.FEW // size), self.MOST)
        self.seed = state.plan.seed + 1
        if self.copies > 1:
            lane = dr.arange(mi.UInt32, size * self.copies)
            chosen, self.seed = dr.gather(mi.UInt32, chosen, lane % size), self.seed + lane // size
        self.x, self.y, self.index = (dr.gather(type(v), v, chosen) for v in (x, y, index))
        self.estimator = copy.copy(state.estimator)
        self.seed = hash32(self.seed)
        dr.make_opaque(self.seed)
        self.photon_seed = int(self.seed[0])
        if state.decisions.twin is None:
            state.decisions.twin = Estimate.nothing(self.estimator.values, dr.width(self.index))
        self.estimate = state.decisions.twin
        dr.eval(self.x, self.y, self.index)

    def catch_up(self, state: State, sets: int | None, limit: Limit) -> Pass:
        """A pass until it has as many samples as ``state``; the arguments as for :func:`.work.image_pass`."""
        end = dr.gather(mi.UInt32, state.estimate.count, self.index)
        dr.eval(end)
        steps = photon_steps(self.estimate.count, end, state, sets)
        return Pass((self._items(state, *step, limit) for step in steps), of_image=False)

    def _items(self, state: State, wanted: mi.UInt32, step: tuple[float, float], limit: Limit) -> Iterator[WorkItem]:
        for span, some, work in portions(self.estimate.count, wanted, state, step, limit):
            x, y, end = (dr.gather(type(v), v, some) for v in (self.x, self.y, wanted))
            start, seed = self.estimate.at(some), self.seed
            if self.copies > 1:
                seed = dr.gather(mi.UInt32, seed, some)
            dr.eval(x, y, start, end, seed)

            def put(sums: Estimate, some: mi.UInt32 = some) -> None:
                self.estimate.put(sums, some)
                dr.eval(self.estimate)

            plan = replace(state.plan, seed=seed, own_photon_seed=self.photon_seed)
            yield WorkItem(self.estimator, x, y, start, plan, end, None, work, span, put)

    def noise(self, state: State) -> tuple[float, float, float]:
        """Root mean square of the error of the displayed pixels of ``state``, white being 1, and what 99 in 100 and 999
        in 1000 are within.

        The displayed values are compared, as the slope of the tone curve would be that of bright spots where there are
        some, and make little of them.
        """
        mine = state.estimate.at(self.index)
        first, second = (displayed(e.total / mi.Float(e.count)) for e in (mine, self.estimate))
        errors = np.abs(np.array(first - second, dtype=np.float64)) / 2**0.5 * state.estimator.smoothing
        tails = np.percentile(errors, [99, 99.9])
        return float(np.sqrt(np.mean(errors**2))), float(tails[0]), float(tails[1])


class Refinement:
    """The passes by which ``state`` reaches ``target``: each pixel gets samples in proportion to what ``policy`` says
    that it needs. The target decides how many there are; each is a pure function of seed, pixel and index as ever.
    """

    #: A pass takes so many times the samples that there are, at most, as the first ones know little.
    GROWTH = 4.0
    #: The noise that ends it, over the one asked for: what is measured is itself uncertain, and where it is small by
    #: chance it ends too early. A pass aims a little lower.
    ENOUGH, AIM = 0.97, 0.94

    def __init__(
        self,
        target: ErrorTarget,
        state: State,
        policy: Any,
        sets: int | None,
        image_pass: Callable[[mi.UInt32, int | None], Pass],
        limit: Callable[[int | None], Limit],
    ) -> None:
        self.target, self.state, self.policy = target, state, policy
        self.sets, self.image_pass, self.limit = sets, image_pass, limit
        self.second = SecondImage(state) if target.noisy else None
        #: Samples of a pixel in a second, in the mean; 0: not known, as the first pass had to compile.
        self.speed = mean(state.estimate.count) / target.passed if state.decisions.effort else 0.0

    def passes(self) -> Iterator[Pass]:
        """The passes over the image, each followed by one that measures its noise."""
        state, decisions, target = self.state, self.state.decisions, self.target
        if decisions.wanted is None and not (yield from self._measure(False)):
            return
        while not target.over and not target.excess(state) <= self.ENOUGH:
            have = mean(state.estimate.count)
            if decisions.wanted is None:
                wanted = self._next(have)
                if not dr.any(wanted > state.estimate.count):
                    return  # each pixel has all that the plan allows
                decisions.wanted = wanted
            work = self.image_pass(decisions.wanted, self._portion(have))
            work.timed, work.of_image = True, self.second is None
            work.progress = self._progress(have, mean(decisions.wanted))
            yield work
            self.speed = (mean(state.estimate.count) - have) / max(work.seconds, 1e-9)
            if not work.whole or not (yield from self._measure(True)):
                return
            decisions.wanted = None

    def _measure(self, shown: bool) -> Generator[Pass, None, bool]:
        """Measures the noise; ``shown``: whether the image is shown then. Returns whether that got to its end."""
        if self.second is None:
            return True
        second, state = self.second, self.state
        work = second.catch_up(state, self.sets, self.limit(self._portion(mean(state.estimate.count))))

        def finish() -> None:
            state.noise, state.noise_99, state.noise_999 = second.noise(state)

        work.timed, work.of_image, work.finish = True, shown, finish
        yield work
        return work.whole

    def _portion(self, have: float) -> int | None:
        return self.target.portion(self.state, self.speed or have / self.target.passed)

    def _need(self) -> mi.Float:
        """What the policy says that each pixel needs, as far as can be known by now."""
        state, decisions = self.state, self.state.decisions
        if decisions.need is not None:
            return decisions.need
        need = state.judge(self.policy.need, self.policy.reach)
        # Where all samples so far agree, others may not: no pixel of the image is left out for ever.
        x, y, *_ = pixels(state.plan.region)
        inside = state.index(x, y)
        need = dr.minimum(dr.gather(mi.Float, need, inside), float(UNLIMITED))
        result = dr.zeros(mi.Float, dr.width(state.estimate.count))
        dr.scatter(result, need + dr.opaque(mi.Float, mean(need) / 20), inside)
        if self.policy.judgements == 1:
            decisions.need = result
        return result

    def _next(self, have: float) -> mi.UInt32:
        """The counts that the next pass leads to, of pixels that ``have`` so many samples in the mean."""
        state, target, need = self.state, self.target, self._need()
        most, goal = self.GROWTH * have, None
        if target.seconds:
            share = 0.9 if target.left < target.seconds / 5 else 0.5  # the last takes all
            most = min(most, have + self.speed * target.left * share) if self.speed else 2 * have
        deviation = display_variance(state.estimate)
        if target.noisy:
            # Well distributed samples are better than the first ones promise: not all of a long way at once.
            way = target.remaining(state, self.AIM)
            goal = mean(deviation / mi.Float(state.estimate.count)) / (way if way < 2 else way**0.7)
        caustics = state.estimator.transport.caustics

        def after(effort: float) -> mi.UInt32:
            counts = state.plan.counts(need * dr.opaque(mi.Float, effort))
            if caustics is not None:
                maps = caustics.maps(state.plan.n)
                had, want = (np.array(values, dtype=np.int64) for values in (state.estimate.count, counts))
                bound = in_full_sets(had, want, state.plan.most, maps, caustics.count)
                counts = dr.minimum(counts, dr.opaque(mi.UInt32, bound))
            return dr.maximum(counts, state.estimate.count)

        def reaches(effort: float) -> bool:
            counts = mi.Float(after(effort))
            return mean(counts) >= most or (goal is not None and mean(deviation / counts) <= goal)

        # What the pixels need may be judged higher now than before: so not from where it was.
        decisions = state.decisions
        decisions.effort = least(reaches, decisions.effort / (4 if self.policy.judgements > 1 else 1))
        return after(decisions.effort)

    def _progress(self, have: float, wanted: float) -> Callable[[float], float]:
        """From the part of a pass to that of the image, as far as is known: it may fall."""
        target = self.target
        end = max(have * target.remaining(self.state, self.AIM), wanted) if target.noisy else np.inf

        def progress(part: float) -> float:
            by_time = 1 - target.left / target.seconds if target.seconds else 0.0
            return float(min(max((have + (wanted - have) * part) / end, by_time), 1.0))

        return progress


def in_full_sets(have: np.ndarray, want: np.ndarray, most: int, maps: int, photons: int) -> int:
    """The samples of a pixel to which a pass goes, at most: less than the largest of ``want``, where its last photon
    sets, for ``maps`` samples of each pixel, would be for few samples. A set costs as much as for many, so that other
    pixels are to have a part in it first. ``have``: samples so far; ``most``: those that one may get.
    """
    last, lacking = int(want.max()), want > have
    if last == most or not lacking.any():
        return last  # nothing more is to come
    sets = -(-last // maps)
    begun, ended = (np.bincount(counts[lacking], minlength=sets * maps + 1) for counts in (have, want))
    samples = np.cumsum(begun - ended)[: sets * maps].reshape(sets, maps).sum(axis=1)
    enough = np.flatnonzero(samples >= min(photons, have.size * maps) / SPARSE)
    return (int(enough[-1]) + 1) * maps if enough.size else 0


def display_variance(estimate: Estimate) -> mi.Float:
    """Variance of a sample of each pixel, in display units squared."""
    count = mi.Float(estimate.count)
    deviation = dr.sqrt(variance(estimate.total, estimate.squares, count))
    result = dr.square(in_display_units(deviation, estimate.total / count))
    dr.eval(result)
    return result


def least(reaches: Callable[[float], bool], begin: float) -> float:
    """Least effort beyond ``begin`` that ``reaches``, to a thousandth or so; at most 2^60."""
    low, high = max(begin, 2.0**-20), max(2 * begin, 2.0**-19)
    while not reaches(high) and high < 2.0**60:
        low, high = high, 4 * high
    for _ in range(12):
        middle = (low * high) ** 0.5
        low, high = (low, middle) if reaches(middle) else (middle, high)
    return high


def mean(values: mi.Float | mi.UInt32) -> float:
    """Mean of an array, by NumPy: the order of the sum, and with it the bits, must not depend on the threads."""
    return float(np.mean(np.array(values), dtype=np.float64))
