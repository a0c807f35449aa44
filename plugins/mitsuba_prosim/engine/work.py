"""The samples that an image lacks, as work items, and the executors that take them."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple, Protocol

import drjit as dr
import mitsuba as mi
import numpy as np

from ..alone import alone
from .camera import has_own_rays, uncropped
from .estimate import Estimate, Estimator
from .plan import Plan, Rectangle, area, index_within, pixels

if TYPE_CHECKING:
    from .estimate import Quiet
    from .state import State

#: Pixels of a work item at least, where the number of their samples bounds it.
FEWEST = 4096

#: From the samples that are still to be asked for: how many the next work item may have; None for any number.
Limit = Callable[[int], "int | None"]


class Step(NamedTuple):
    """What :class:`.Render` yields after each work item."""

    #: The part of the image that is done, 0 to 1, as far as is known: it may fall.
    done: float
    #: Whether a pass over the image is complete: every pixel has a value, and the samples that the pass was to bring.
    complete: bool


@dataclass(frozen=True)
class WorkItem:
    """The pixels (x, y), whose samples continue from ``start`` in stages, each until they have the counts of its end,
    or are ``quiet``. All arrays are evaluated, with one entry a pixel.
    """

    estimator: Estimator
    x: mi.Int32
    y: mi.Int32
    start: Estimate
    stages: Sequence[tuple[Plan, mi.UInt32]]
    quiet: Quiet | None
    #: Number of samples, about; and the part of the pass that is done before it and with it.
    work: int
    span: tuple[float, float]
    #: Stores the sums.
    put: Callable[[Estimate], None]

    def sets(self) -> list[tuple[int, int, int]]:
        """The photon sets that it needs, see :meth:`.Estimator.sets`."""
        found: list[tuple[int, int, int]] = []
        count = self.start.count
        for plan, end in self.stages:
            found += self.estimator.sets(plan, count, end)
            count = dr.maximum(count, end)
        return found

    def take(self) -> Estimate:
        """Takes the samples, in this process."""
        sums, sensor = self.start, self.estimator.sensor
        with alone():
            for plan, end in self.stages:
                self.estimator.plan = plan
                if has_own_rays(sensor):
                    sums = self.estimator.take(self.x, self.y, sums, end, self.quiet)
                else:
                    with uncropped(sensor):
                        sums = self.estimator.take(self.x, self.y, sums, end, self.quiet)
        return sums


#: Work items with their sums; None where there is nothing yet: the caller may stop then.
Results = Generator["tuple[WorkItem, Estimate] | None", None, None]


class Executor(Protocol):
    """Takes the samples of work items. Samples are pure, so that it may do so anywhere and in any order."""

    #: Photon sets that the work items of a step may need.
    sets: int | None

    def limit(self, most: int | None, left: int) -> int | None:
        """Samples of the next work item at most; None for any number. ``most``: another limit; ``left``: samples that
        are still to be asked for.
        """

    def __call__(self, items: Iterator[WorkItem], ordered: bool) -> Results:
        """Yields each of ``items`` with its sums; ``ordered``: whether in the order of ``items``."""


class Local:
    """Takes them in this process, one after the other, in work items that take ``seconds``, about."""

    sets = 1

    #: A work item has so many times the samples of the one before, at most; what is left, up to so many work items,
    #: is one.
    GROWTH, LAST = 4, 1.25

    def __init__(self, seconds: float = 1.0) -> None:
        self.seconds, self.size = seconds, int(seconds * samples_of_a_second())
        self.first = True  # whose time is that of the compiler

    def limit(self, most: int | None, left: int) -> int | None:
        """As many as take ``seconds``, by the time of those before."""
        size = left if left < self.LAST * self.size else self.size
        return size if most is None else min(size, most)

    def __call__(self, items: Iterator[WorkItem], ordered: bool) -> Results:
        """Takes them."""
        for item in items:
            begun = time.perf_counter()
            sums = item.take()
            dr.sync_thread()
            self.learn(item.work, time.perf_counter() - begun)
            yield item, sums

    def learn(self, work: int, seconds: float) -> None:
        """Adapts the size to the time of a work item of ``work`` samples."""
        size = int(work * self.seconds / max(seconds, 1e-6))
        if seconds > self.seconds and not self.first:
            self.size = max(size, 1)
        elif size > self.size:
            self.size = min(size, self.GROWTH * self.size)
        self.first = False


def samples_of_a_second() -> int:
    """How many samples take a second or so in a scene of the usual kind."""
    return 2**20 * dr.thread_count() if dr.backend_v(mi.Float) == dr.JitBackend.LLVM else 2**24


@dataclass
class Pass:
    """Samples to be taken: work items in ``steps``, of which those of a step are asked for when the sums of all before
    are stored. An executor of :class:`.Render` sets the other attributes.
    """

    steps: Iterable[Iterator[WorkItem]]
    #: From the part of the pass that is done to that of the image, both 0 to 1; None: the latter stays.
    progress: Callable[[float], float] | None = None
    #: Whether the image is to be shown when the pass is whole; and what is done then.
    of_image: bool = True
    finish: Callable[[], None] = lambda: None
    #: Whether work items are to be stored in their order; whether the time limit ends it; whether nothing does.
    ordered: bool = False
    timed: bool = False
    always: bool = False
    #: Whether all samples have been taken; and the seconds that it took.
    whole: bool = field(default=False, init=False)
    seconds: float = field(default=0.0, init=False)


def image_pass(state: State, wanted: mi.UInt32, quiet: Quiet | None, sets: int | None, limit: Limit) -> Pass:
    """A pass over the image until each pixel has the samples that are ``wanted`` of it; those that have them stay as
    they are. ``sets``: as :attr:`Executor.sets`.
    """
    if state.keeps:
        steps = photon_steps(state.estimate.count, wanted, state, sets)
        return Pass(_portions(state, *step, quiet, limit) for step in steps)
    if state.decisions.rows is not None or dr.any(wanted > state.estimate.count):
        return Pass([_bands(state, wanted, quiet, limit)], ordered=True)
    return Pass([])


def _portions(
    state: State, wanted: mi.UInt32, span: tuple[float, float], quiet: Quiet | None, limit: Limit
) -> Iterator[WorkItem]:
    """The pixels that lack samples, where sums are kept."""
    for done, some, work in portions(state.estimate.count, wanted, state, span, limit):
        whole = dr.width(some) == dr.width(wanted)  # all: spares two copies of the state

        def put(sums: Estimate, some: mi.UInt32 = some, whole: bool = whole) -> None:
            if whole:
                state.estimate = sums
            else:
                state.estimate.put(sums, some)
            dr.eval(state.estimate)

        x, y = state.places(some)
        start = state.estimate if whole else state.estimate.at(some)
        end = wanted if whole else dr.gather(mi.UInt32, wanted, some)
        dr.eval(x, y, start, end)
        yield WorkItem(state.estimator, x, y, start, [(state.plan, end)], quiet, work, done, put)


def _bands(state: State, wanted: mi.UInt32, quiet: Quiet | None, limit: Limit) -> Iterator[WorkItem]:
    """All pixels, band by band, with all their samples from the first on, where sums are not kept."""
    left, top, right, bottom = state.outer
    width = right - left
    image, begin = state.decisions.rows or (state.black(), top)
    above = dr.arange(mi.UInt32, dr.width(wanted)) < (begin - top) * width
    if dr.any(above & (wanted > state.estimate.count)):
        image, begin = state.black(), top  # the rows above were made of fewer samples
    most = max(int(dr.max(wanted)[0]), 1)
    while begin < bottom:
        size, bound = state.plan.band, limit(width * (bottom - begin) * most)
        size = size if bound is None else min(size, bound // most)
        band = (left, begin, right, min(begin + max(1, size // width), bottom))
        begin = band[3]
        x, y, *_ = pixels(band)
        some = index_within(state.outer, x, y)
        count, end = (dr.gather(mi.UInt32, counts, some) for counts in (state.estimate.count, wanted))
        stages = [
            (plan, dr.minimum(dr.maximum(count, end), dr.opaque(mi.UInt32, until)))
            for plan, until in state.plan.stages()
        ]
        start = Estimate.nothing(state.estimator.values, area(band))

        def put(sums: Estimate, band: Rectangle = band, some: mi.UInt32 = some) -> None:
            state.estimate.put(replace(sums, sums=[]), some)
            state.add(image, band, band, sums)
            image.wait()
            state.decisions.rows = (image, band[3]) if band[3] < bottom else None
            if state.made is None or band[3] == bottom:
                state.made = image

        dr.eval(x, y, start, stages)
        span = ((band[1] - top) / (bottom - top), (band[3] - top) / (bottom - top))
        yield WorkItem(state.estimator, x, y, start, stages, quiet, area(band) * most, span, put)


def photon_steps(
    count: mi.UInt32, wanted: mi.UInt32, state: State, sets: int | None
) -> Iterator[tuple[mi.UInt32, tuple[float, float]]]:
    """What is ``wanted`` of pixels that have ``count``, step by step: ``(wanted so far, (part done before, then))``.

    There is one step, but for caustics: each photon set is drawn once then. In one process (``sets`` 1) all pixels
    proceed alike, and a render can stop between two sets; elsewhere a step has as many sets as a process keeps (None).
    The parts are those of the time: a set takes as long for few samples as for many.
    """
    caustics = state.estimator.transport.caustics
    if caustics is None:
        yield wanted, (0.0, 1.0)
        return
    maps = caustics.maps(state.plan.first.n)
    further = maps * (sets or caustics.kept)
    have, want = (np.array(values, dtype=np.int64) for values in (count, wanted))
    lacking = want > have
    have, want = have[lacking], want[lacking]
    if not have.size:
        return
    begun = int(have.min()) // maps * maps
    ends = range(begun + further, int(want.max()) + further, further)
    taken = [0, *(int(np.sum(np.maximum(np.minimum(want, end) - have, 0))) for end in ends)]
    costs = [samples + state.set_cost * further / maps * number for number, samples in enumerate(taken)]
    for number, end in enumerate(ends):
        span = costs[number] / costs[-1], costs[number + 1] / costs[-1]
        yield dr.minimum(wanted, dr.opaque(mi.UInt32, end)), span


def portions(
    count: mi.UInt32, wanted: mi.UInt32, state: State, span: tuple[float, float], limit: Limit
) -> Iterator[tuple[tuple[float, float], mi.UInt32, int]]:
    """Indices of the pixels that lack samples, as many at a time as ``limit`` and the plan's ``band`` allow: ``((part
    done before, then), indices, samples)``. ``span``: the part done before and after all of them.
    """
    plan, sampled = state.plan, state.estimator.sampler is not None
    # A sampler that is given takes whole patterns only, and its portions must not depend on the time.
    classes = by_lack(count, wanted, 1.0 if sampled else 1.5)
    work, finished = sum(size * each for _, size, each in classes), 0
    for where, size, each in classes:
        most = lanes = max(min(plan.band, FEWEST), plan.band * min(plan.n**2, each) // each)
        begin = end = 0
        while end < size:
            bound = None if sampled else limit(work - finished)
            if bound is not None:  # it may change on the way
                lanes = max(1, min(most, bound // each))
            begin, end = end, min(end + lanes, size)
            some = where
            if end - begin < size:
                some = dr.gather(mi.UInt32, where, dr.arange(mi.UInt32, end - begin) + dr.opaque(mi.UInt32, begin))
            before, finished = finished, finished + (end - begin) * each
            first, last = (span[0] + (span[1] - span[0]) * part / work for part in (before, finished))
            yield (first, last), some, finished - before


def by_lack(count: mi.UInt32, wanted: mi.UInt32, ratio: float) -> list[tuple[mi.UInt32, int, int]]:
    """Pixels that lack samples, in classes that lack about as many, so that few lanes wait for others: ``(indices,
    number of pixels, most samples that one lacks)``. ``ratio``: of the most to the fewest in a class. The class that
    lacks most comes first: a render that stops has improved what is noisiest.
    """
    lacking = wanted - dr.minimum(count, wanted)
    dr.eval(lacking)
    sizes = np.bincount(np.array(lacking))
    sizes[0] = 0
    classes, low = [], 0
    for fewest in map(int, np.flatnonzero(sizes)):
        if fewest <= low:
            continue
        low = int(fewest * ratio)
        size = int(sizes[fewest : low + 1].sum())
        if size == dr.width(wanted):
            where = dr.arange(mi.UInt32, size)
        else:
            first, last = dr.opaque(mi.UInt32, fewest), dr.opaque(mi.UInt32, low)
            where = dr.compress((lacking >= first) & (lacking <= last))
        classes.append((where, size, min(low, len(sizes) - 1)))
    return classes[::-1]
