"""A progressive render: a loop over work items, which its consumers may leave at any time."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..alone import alone
from .error import in_display_units
from .error_target import ErrorTarget, Refinement
from .estimate import Estimator
from .part import Part
from .plan import Plan, index_within, pixels
from .policies import POLICIES
from .record import Record
from .state import State
from .work import Executor, Local, Pass, Step, WorkItem, image_pass

#: A pass over the image takes so many times the samples that a pixel has, at most.
GROWTH = 4


@dataclass(frozen=True)
class Reached:
    """How far an image came."""

    #: Mean number of samples of a pixel, and that of the one which has the fewest.
    samples: float
    least: int
    #: Root mean square over the pixels of the error of the displayed value, white being 1; not a number where no noise
    #: was asked for, as nobody has measured it then.
    noise: float
    #: What the error of 99 pixels in 100 is within; likewise.
    noise_99: float
    #: And of 999 pixels in 1000.
    noise_999: float
    #: Since the beginning.
    seconds: float


class Render:
    """The image of ``plan``, or a ``part`` of it, in progress: an iterator of :class:`Step`.

    Its methods may be called between two steps. When it ends, or is closed, the film holds the image so far. To leave
    its loop is to cancel it: :meth:`close` then gives every pixel a sample, if it has begun. ``estimator`` takes the
    samples; ``own_aovs``: names of the channels that say how the image was made, None where the image is not to be put
    into the film; ``executor``: of this process unless given; ``begin``: continues from there.

    Raises ValueError where ``begin`` belongs to another image.
    """

    def __init__(
        self,
        plan: Plan,
        estimator: Estimator,
        own_aovs: Sequence[str] | None,
        part: Part | None = None,
        executor: Executor | None = None,
        begin: Record | None = None,
    ) -> None:
        policy: Any = POLICIES[plan.sampling.adaptive](plan, plan.sampling.threshold)
        self.policy, self.executor = policy, executor or Local()
        self.state = State(plan, estimator, own_aovs or [], policy.judgements * policy.reach, part)
        self.film = estimator.sensor.film()
        self.target = ErrorTarget.of(plan, 0.0 if begin is None else begin.facts["seconds"])
        #: Whether it has ended; and whether the image has then all that was asked for.
        self.ended = self.finished = False
        self._stopped, self._put, self._before, self._done = False, own_aovs is not None, False, 0.0
        if begin is not None:
            begin.restore(self.state)
            self._before = begin.finished and begin.same_aim(self.state)
        self._steps: Generator[Step, None, None] = self._run()

    # ---------------------------------------------------------------- as an iterator

    def __iter__(self) -> Render:
        return self

    def __next__(self) -> Step:
        try:
            return next(self._steps)
        except BaseException:
            self._end()
            raise

    def run(self) -> Render:
        """Takes all steps, and returns itself."""
        for _ in self:
            pass
        return self

    def stop(self) -> None:
        """Ends it after the work item at hand; from any thread."""
        self._stopped = True

    def close(self) -> None:
        """Ends it with what there is."""
        if not self.ended:
            self.stop()
            self.run()

    def _end(self) -> None:
        if not self.ended:
            self.ended = True
            self._steps.close()
            if self._put:
                self.put()

    def _run(self) -> Generator[Step, None, None]:
        """Gives the work items of all passes to the executor."""
        whole = True
        for work in _guarded(self._passes()):
            if not self._over(work):
                for _ in self.execute(work):
                    yield Step(self._done, False)
            whole = work.whole
            with alone():
                if whole:
                    self._progress(work, 1.0)
                    work.finish()
                complete = (work.of_image or not whole) and bool(dr.all(self.state.counts() > 0))
            if complete:
                yield Step(self._done, True)
        self.finished = not self._stopped and (whole or self.target.over)
        if self.finished and self._done < 1:
            yield Step(1.0, True)

    def execute(self, work: Pass) -> Iterator[None]:
        """Takes the samples of a pass, until it is whole or over."""
        begun = time.perf_counter()
        for items in _guarded(work.steps):
            asked = _Asked(items, lambda: self._over(work))
            with closing(self.executor(_guarded(asked), work.ordered)) as results:
                for result in results:
                    if result is not None:
                        item, sums = result
                        with alone():
                            item.put(sums)
                            dr.sync_thread()  # bounds the memory, and lets progress be true
                        self._progress(work, asked.done(item))
                    work.seconds += time.perf_counter() - begun
                    yield
                    begun = time.perf_counter()
                    if asked.out and self._over(work):
                        return
            if not asked.exhausted or asked.out:
                return
        work.whole = True

    def _progress(self, work: Pass, part: float) -> None:
        self._done = self._done if work.progress is None else work.progress(part)

    def _over(self, work: Pass) -> bool:
        return not work.always and (self._stopped or (work.timed and self.target.over))

    # ---------------------------------------------------------------- what it takes

    def _limit(self, most: int | None = None) -> Callable[[int], int | None]:
        return lambda left: self.executor.limit(most, left)

    def image_pass(self, wanted: mi.UInt32, most: int | None = None) -> Pass:
        """A pass over the image to the counts that are ``wanted``; ``most``: samples of a work item."""
        return image_pass(self.state, wanted, self.policy.quiet, self.executor.sets, self._limit(most))

    def _passes(self) -> Iterator[Pass]:
        """The passes over the image, decided one after the other. A state with samples and decisions continues."""
        plan, policy, state, target = self.state.plan, self.policy, self.state, self.target
        if self._before:
            yield Pass([], lambda _: 1.0)
            return
        pixel_count = dr.width(state.estimate.count)
        begun = policy.first / plan.most  # the first pass's part, as long as nobody knows how many follow
        decisions = state.decisions
        if decisions.judged == 0:
            first = state.share(dr.opaque(mi.UInt32, policy.first, pixel_count), policy.judgements * policy.reach)
            whole = yield from self._first(first, begun)
            if not whole or policy.first == plan.most:
                return
        if target:
            decisions.judged = 1
            yield from Refinement(target, state, policy, self.executor.sets, self.image_pass, self._limit).passes()
            return
        while decisions.wanted is not None or decisions.judged < policy.judgements:
            left = policy.judgements - decisions.judged
            if decisions.wanted is None:
                left -= 1
                # What is to be judged again must be known as far as those after it look.
                wanted = plan.counts(state.judge(policy.need, policy.reach, left * policy.reach))
                if left:
                    wanted = dr.minimum(wanted, soon(plan, state.estimate.count))
                decisions.wanted, decisions.judged = state.share(wanted, left * policy.reach), decisions.judged + 1
            end = int(dr.max(decisions.wanted)[0]) / plan.most if left else 1.0
            work = self.image_pass(decisions.wanted)
            work.progress = between(begun, end)
            yield work
            if not work.whole:
                return
            decisions.wanted = None
            begun = end

    def _first(self, first: mi.UInt32, end: float) -> Generator[Pass, None, bool]:
        """The pass that takes the ``first`` samples of each pixel; if it is cut short, another takes one of those that
        have none. ``end``: the part of the image that it is. Returns whether it got to its end.
        """
        state, target = self.state, self.target
        counts, most = [first], int(dr.max(first)[0])
        by_time = target.seconds and state.keeps and state.estimator.sampler is None
        if by_time:  # sample by sample, as after one of them there is an image
            counts = [dr.minimum(first, dr.opaque(mi.UInt32, count)) for count in range(1, most + 1)]
        portion = None
        for number, count in enumerate(counts, 1):
            work = self.image_pass(count, portion)
            work.progress = between((number - 1) / len(counts) * end, number / len(counts) * end)
            work.of_image, work.timed = number == len(counts), number > 1
            yield work
            if not work.whole:
                break
            if by_time:
                passed = (0.1 if number == 1 else 1) * work.seconds  # the first had to compile
                portion = target.portion(state, 1 / max(passed, 1e-9))
        if not work.whole and state.keeps and dr.any(state.estimate.count > 0):
            one = self.image_pass(dr.minimum(first, dr.opaque(mi.UInt32, 1)))
            one.always, one.of_image = True, False
            yield one
        return work.whole

    # ---------------------------------------------------------------- what can be seen of it

    @alone()
    def put(self) -> None:
        """Makes the image so far what the film holds."""
        image = self.state.image()
        self.film.prepare(self.state.aov_names)  # another image on this film may have had others meanwhile
        self.film.put_block(mi.ImageBlock(image.tensor(), mi.ScalarPoint2i(image.window[:2]), border=False))
        self.film.schedule_storage()
        dr.eval()  # what is pending in one thread is in the way of a function that another one freezes

    @alone()
    def image(self) -> mi.TensorXf:
        """The developed image so far, shape (height, width, channels)."""
        self.put()
        return self.film.develop()

    @property
    def current(self) -> bool:
        """Whether :meth:`image` has all samples so far, and not those of the last whole pass alone."""
        return self.state.current

    @property
    @alone()
    def reached(self) -> Reached:
        """How far it came."""
        counts, state = np.array(self.state.counts()), self.state
        mean = float(np.mean(counts, dtype=np.float64))
        noises = state.noise, state.noise_99, state.noise_999
        return Reached(mean, int(counts.min()), *noises, self.target.passed)

    @alone()
    def error(self) -> np.ndarray:
        """Standard error of the luminance of each pixel as its own samples show it, shape (height, width)."""
        return self._picture(self.state.estimate.error(self.state.plan.n))

    @alone()
    def counts(self) -> np.ndarray:
        """Number of samples of each pixel, shape (height, width)."""
        return self._picture(self.state.estimate.count)

    @alone()
    def known(self) -> np.ndarray:
        """Which pixels have samples, and so have all around whose samples reach them, shape (height, width): within the
        first pass some have not.
        """
        plan, side = self.state.plan, 2 * self.state.plan.reach + 1
        (left, top, right, bottom), window = plan.region, plan.window
        taken = np.array(self.state.counts()).reshape(bottom - top, right - left) > 0
        # Beyond the domain there are none to wait for.
        above, below = plan.reach - (window[1] - top), plan.reach - (bottom - window[3])
        before, after = plan.reach - (window[0] - left), plan.reach - (right - window[2])
        taken = np.pad(taken, ((above, below), (before, after)), constant_values=True)
        return np.asarray(np.lib.stride_tricks.sliding_window_view(taken, (side, side)).all(axis=(2, 3)))

    @alone()
    def noise_at_most(self) -> float:
        """Root mean square of the error of the displayed pixels, white being 1, as the samples within each pixel show
        it; not a number where some have less than two.

        It is what these samples would come to if they had been drawn without a pattern, or in passes that knew nothing
        of each other. Their pattern makes the error smaller, by how much only another image can show.
        """
        state = self.state
        x, y, *_ = pixels(state.plan.region)
        estimate = replace(state.estimate, sums=[]).at(state.index(x, y))
        error = in_display_units(estimate.error(state.plan.n), estimate.total / mi.Float(estimate.count))
        values = np.array(error, dtype=np.float64)
        result = float(np.sqrt(np.mean(values**2))) * state.estimator.smoothing
        return result if int(dr.min(estimate.count)[0]) > 1 and np.isfinite(result) else float("nan")

    @alone()
    def checkpoint(self) -> Record:
        """What a process that continues it has to know."""
        return Record.of(self.state, self.target.passed, self.finished)

    def _picture(self, values: mi.Float) -> np.ndarray:
        outer, window = self.state.outer, self.state.plan.window
        if outer != window:
            x, y, *_ = pixels(window)
            values = dr.gather(type(values), values, index_within(outer, x, y))
        return np.array(values).reshape(window[3] - window[1], window[2] - window[0])


class _Asked:
    """The work items of a step that an executor asks for, until it is ``over``, and what part of the pass is done."""

    def __init__(self, items: Iterator[WorkItem], over: Callable[[], bool]) -> None:
        self.items, self.over = items, over
        #: Whether all have been asked for, and how many of them are out.
        self.exhausted, self.out = False, 0
        self.end = self.open = 0.0

    def __iter__(self) -> Iterator[WorkItem]:
        while not self.over():
            item = next(self.items, None)
            if item is None:
                self.exhausted = True
                return
            self.out += 1
            self.end, self.open = item.span[1], self.open + item.span[1] - item.span[0]
            yield item

    def done(self, item: WorkItem) -> float:
        """The part of the pass that is done, now that ``item`` is."""
        self.out -= 1
        self.open = self.open - (item.span[1] - item.span[0]) if self.out else 0.0
        return self.end - self.open


def _guarded(items: Iterable[Any]) -> Iterator[Any]:
    """Yields ``items``, each made while this thread is :func:`.alone`."""
    iterator = iter(items)
    while True:
        with alone():
            item = next(iterator, None)
        if item is None:
            return
        yield item


def soon(plan: Plan, count: mi.UInt32) -> mi.UInt32:
    """The most samples that a pass leads to if it is not the last, as few samples know little: a first pattern, or some
    times as many as there are.
    """
    return dr.maximum(GROWTH * count, dr.opaque(mi.UInt32, plan.n**2))


def between(begin: float, end: float) -> Callable[[float], float]:
    """From a part of a pass to that of the image, of which the pass is what lies between ``begin`` and ``end``."""
    return lambda done: begin + (end - begin) * done
