"""Wave after wave until an image is good enough."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .error import in_display_units, variance
from .estimate import Estimate
from .plan import UNLIMITED, in_patterns, pixels
from .state import State
from .target import Target
from .twin import Twin
from .work import Limit, Pass

#: A set of photons is worth while for so many times fewer samples than there are photons, or than all pixels take.
SPARSE = 2


class Pursuit:
    """Lets ``state`` grow, each pixel in proportion to its ``need``, until ``target`` is reached. The target says how
    many samples there are; each is a pure function of seed, pixel, pass and index as ever.
    """

    #: A wave takes so many times the samples that there are, at most, as the first ones know little.
    GROWTH = 4.0
    #: The noise that ends it, over the one asked for: what is measured is itself uncertain, and where it is small by
    #: chance it ends too early. A wave aims a little lower.
    ENOUGH, AIM = 0.97, 0.94

    def __init__(
        self,
        target: Target,
        state: State,
        policy: Any,
        sets: int | None,
        image_pass: Callable[[mi.UInt32, int | None], Pass],
        limit: Callable[[int | None], Limit],
    ) -> None:
        self.target, self.state, self.policy = target, state, policy
        self.sets, self.image_pass, self.limit = sets, image_pass, limit
        decisions = state.decisions
        if decisions.need is not None and decisions.variance is not None:
            self.need, self.variance = decisions.need, decisions.variance
        else:
            self._judge()
        if policy.judgements == 1:
            decisions.need, decisions.variance = self.need, self.variance
        self.twin = Twin(state) if target.noisy else None
        # Samples of a pixel, in the mean, in a second.
        self.speed = mean(state.estimate.count) / target.passed if decisions.effort else 0.0
        self._time_photons(mean(state.estimate.count), target.passed, 0.0)

    def passes(self) -> Iterator[Pass]:
        """The passes over the image; what they say of the progress may fall."""
        state, decisions = self.state, self.state.decisions
        if decisions.wanted is None and not (yield from self._measure(False)):
            return
        while not self.target.over and not self.target.excess(state) <= self.ENOUGH:
            samples = mean(state.estimate.count)
            wanted = decisions.wanted
            if wanted is None:
                wanted = self._everywhere(samples)
                if wanted is None:
                    if self.policy.judgements > 1:
                        self._judge()
                    if decisions.effort == 0:
                        self._choose_patterns(samples)
                    wanted = self._next(samples)
                if not dr.any(wanted > state.estimate.count):
                    return  # each pixel has all that the plan allows
                decisions.wanted = wanted
            drawing, work = self._drawing, self.image_pass(wanted, self._portion())
            work.timed, work.of_image, work.progress = True, self.twin is None, self._progress(wanted)
            yield work
            more, passed = mean(state.estimate.count) - samples, max(work.seconds, 1e-9)
            self.speed = more / passed
            self._time_photons(more, passed, drawing)
            if not work.whole or not (yield from self._measure(True)):
                return
            decisions.wanted = None

    def _judge(self) -> None:
        """Asks the policy what each pixel needs, as far as can be known by now."""
        state = self.state
        need = state.judge(self.policy.need, self.policy.reach)
        # Where all samples so far agree, others may not: no pixel of the image is left out for ever.
        x, y, *_ = pixels(state.plan.region)
        inside = state.index(x, y)
        need = dr.minimum(dr.gather(mi.Float, need, inside), float(UNLIMITED))
        self.need = dr.zeros(mi.Float, dr.width(state.estimate.count))
        dr.scatter(self.need, need + dr.opaque(mi.Float, mean(need) / 20), inside)
        self.variance = display_variance(state.estimate)

    def _measure(self, shown: bool) -> Generator[Pass, None, bool]:
        """Measures the noise; ``shown``: whether the image is shown then. Returns whether that got to its end."""
        if self.twin is None:
            return True
        work, twin, state = (
            self.twin.catch_up(self.state, self.sets, self.limit(self._portion())),
            self.twin,
            self.state,
        )

        def finish() -> None:
            state.noise, state.noise_99 = twin.noise(state)

        work.timed, work.of_image, work.finish = True, shown, finish
        yield work
        return work.whole

    def _portion(self) -> int | None:
        """Samples of a portion; None: no bound."""
        state, target = self.state, self.target
        if not target.seconds and state.estimator.sampler is not None:
            return None  # it has a state: which samples it draws must not depend on the time
        return target.portion(state, self.speed or mean(state.estimate.count) / target.passed)

    def _expected(self, samples: float) -> float:
        """Samples of a pixel in the end, in the mean, as far as can be known."""
        target, expected = self.target, float(UNLIMITED)
        if target.noisy:
            expected = samples * target.work(self.state)
        if target.seconds:
            expected = min(expected, samples + self.speed * target.left)
        return expected

    def _everywhere(self, samples: float) -> mi.UInt32 | None:
        """The counts of a wave that is the same for every pixel; None: there need not be one."""
        plan, count = self.state.plan, self.state.estimate.count
        size = plan.n**2
        if self.target.seconds and not self.speed:
            wanted = 2 * count  # the first wave had to compile; this one shows how fast the samples are
        elif self.state.decisions.effort == 0 and samples < size and self._expected(samples) > 8 * size:
            wanted = dr.opaque(mi.UInt32, size, dr.width(count))  # who stops a long render has a picture of one kind
        else:
            return None
        return dr.minimum(wanted, dr.opaque(mi.UInt32, plan.most))

    def _choose_patterns(self, samples: float) -> None:
        """Larger patterns from now on, if many samples are to come; as long as all pixels have the same number."""
        plan, count = self.state.plan, self.state.estimate.count
        n = min(size_of_patterns(self._expected(samples)), 2 * plan.n)  # twice: a wave is to reach most pixels
        if n > 1.3 * plan.n and plan.before is None and dr.all(count == dr.max(count)):
            self.state.follow(plan.continued(n, int(dr.max(count)[0])))

    def _next(self, samples: float) -> mi.UInt32:
        """The counts that the next wave leads to."""
        state, target = self.state, self.target
        most, goal = self.GROWTH * samples, None
        if target.seconds:
            share = 0.9 if target.left < target.seconds / 5 else 0.5  # the last takes all
            most = min(most, samples + self.speed * target.left * share)
        if target.noisy:
            # Well-filled patterns are better than the first samples promise: not all of a long way at once.
            now = mean(self.variance / mi.Float(state.estimate.count))
            way = target.work(state, self.AIM)
            goal = now / (way if way < 2 else way**0.7)

        after = self._by_effort()
        reaches = self._reaching(after, most, goal)
        # What the pixels need may be judged higher now than before: so not from where it was.
        effort = state.decisions.effort
        state.decisions.effort = least(reaches, effort / 4 if self.policy.judgements > 1 else effort)
        return after(state.decisions.effort)

    @property
    def _drawing(self) -> float:
        """Seconds that photons have taken so far, here."""
        caustics = self.state.estimator.transport.caustics
        return 0.0 if caustics is None else float(caustics.seconds)

    def _time_photons(self, samples: float, seconds: float, drawing: float) -> None:
        """Notes what a set of photons costs, after so many ``samples`` of a pixel in so many ``seconds``, before which
        photons had taken ``drawing`` seconds.
        """
        caustics, state = self.state.estimator.transport.caustics, self.state
        self.alone = samples / max(seconds - (self._drawing - drawing), 1e-9)
        if caustics is not None and caustics.draws:
            set_seconds = caustics.seconds / caustics.draws
            state.set_cost = set_seconds * self.alone * dr.width(state.estimate.count)

    def _seconds(self, have: mi.UInt32, want: mi.UInt32) -> tuple[float, float]:
        """What it takes to get from some counts to others, about: the image, and the twin, whose photons are others."""
        caustics, state = self.state.estimator.transport.caustics, self.state
        samples, sets = mean(want) - mean(have), 0
        if caustics is not None:
            maps = caustics.maps(state.plan.first.n)
            lacking = dr.select(have < want, have, want)
            sets = -(-int(dr.max(want)[0]) // maps) - int(dr.min(lacking)[0]) // maps
        drawing, share = sets * state.set_cost / dr.width(want), 0.0
        if self.twin is not None:
            share = dr.width(self.twin.index) / dr.width(want)
        speed = max(self.alone, 1e-9)
        return (samples + drawing) / speed, (samples * share + drawing) / speed if share else 0.0

    def _by_effort(self) -> Callable[[float], mi.UInt32]:
        """What gives the counts that an effort leads to."""
        state, caustics = self.state, self.state.estimator.transport.caustics
        have = None if caustics is None else np.array(state.estimate.count, dtype=np.int64)

        def after(effort: float) -> mi.UInt32:
            counts = in_patterns(state.plan, self.need * dr.opaque(mi.Float, effort))
            if have is not None:
                maps, want = caustics.maps(state.plan.first.n), np.array(counts, dtype=np.int64)
                bound = in_full_sets(have, want, state.plan.most, maps, caustics.count)
                counts = dr.minimum(counts, dr.opaque(mi.UInt32, bound))
            return dr.maximum(counts, state.estimate.count)

        return after

    def _progress(self, wanted: mi.UInt32) -> Callable[[float], float]:
        """From the part of a pass to the counts that are ``wanted`` to that of the image, as far as can be known."""
        state, target = self.state, self.target
        passed, (wave, rest) = target.passed, self._seconds(state.estimate.count, wanted)
        if target.noisy:
            rest += sum(self._seconds(wanted, dr.maximum(self._in_the_end(), wanted)))

        def progress(part: float) -> float:
            by_time = 1 - target.left / target.seconds if target.seconds else 0.0
            return min(max((passed + wave * part) / max(passed + wave + rest, 1e-9), by_time), 1.0)

        return progress

    def _in_the_end(self) -> mi.UInt32:
        """The counts with which the noise is what was asked for, as far as can be known."""
        now, work, after = self.state.estimate.count, self.target.work(self.state, self.AIM), self._by_effort()
        goal, most = mean(self.variance / mi.Float(now)) / max(work, 1e-24), mean(now) * work
        return after(least(self._reaching(after, most, goal), self.state.decisions.effort))

    def _reaching(
        self, after: Callable[[float], mi.UInt32], most: float, goal: float | None
    ) -> Callable[[float], bool]:
        """What says whether the counts ``after`` an effort are ``most`` in the mean, or leave a variance of ``goal`` or
        less, if there is one.
        """

        def reaches(effort: float) -> bool:
            counts = mi.Float(after(effort))
            return mean(counts) >= most or (goal is not None and mean(self.variance / counts) <= goal)

        return reaches


def in_full_sets(have: np.ndarray, want: np.ndarray, most: int, maps: int, photons: int) -> int:
    """The samples of a pixel to which a wave goes, at most: less than the largest of ``want``, where its last sets of
    so many ``photons``, for ``maps`` samples of each pixel, would be for few samples. They cost as much as for many, so
    that other pixels are to have a part in them first. ``have``: samples so far; ``most``: those that one may get.
    """
    last, lacking = int(want.max()), want > have
    if last == most or not lacking.any():
        return last  # nothing more is to come
    sets = -(-last // maps)
    begun, ended = (np.bincount(counts[lacking], minlength=sets * maps + 1) for counts in (have, want))
    samples = np.cumsum(begun - ended)[: sets * maps].reshape(sets, maps).sum(axis=1)
    enough = np.flatnonzero(samples >= min(photons, have.size * maps) / SPARSE)
    return (int(enough[-1]) + 1) * maps if enough.size else 0


def size_of_patterns(expected: float) -> int:
    """N for patterns of which a pixel takes some, where it is expected to get so many samples in the mean: the
    larger a pattern, the better each of its samples; the smaller, the nearer each pixel comes to what it needs.
    """
    return round((expected / 4) ** 0.5)


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
