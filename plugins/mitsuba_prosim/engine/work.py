"""The samples that an image lacks, as work items, and the executors that take them."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple, Protocol

import drjit as dr
import mitsuba as mi
import numpy as np

from ..alone import alone
from ..compat import dr_array
from .camera import has_own_rays, uncropped
from .estimate import Estimate, Estimator
from .plan import Plan, Rectangle, area, index_within, pixels

if TYPE_CHECKING:
    from .estimate import Quiet
    from .state import State

#: Pixels count as lacking about as many samples within a factor of two to one over this.
CLASSES = 4

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
    """The pixels (x, y), whose samples by ``plan`` continue from ``start`` to the counts of ``end``, or until they are
    ``quiet``. All arrays are evaluated, with one entry a pixel.
    """

    estimator: Estimator
    x: mi.Int32
    y: mi.Int32
    start: Estimate
    plan: Plan
    end: mi.UInt32
    quiet: Quiet | None
    #: Number of samples, about; and the part of the pass that is done before it and with it.
    work: int
    span: tuple[float, float]
    #: Stores the sums.
    put: Callable[[Estimate], None]

    def sets(self) -> list[tuple[int, int, int]]:
        """The photon sets that it needs, see :meth:`.Estimator.sets`."""
        return list(self.estimator.sets(self.plan, self.start.count, self.end))

    def take(self) -> Estimate:
        """Takes the samples, in this process."""
        sensor = self.estimator.sensor
        with alone(), nullcontext() if has_own_rays(sensor) else uncropped(sensor):
            self.estimator.plan = self.plan
            return self.estimator.take(self.x, self.y, self.start, self.end, self.quiet)


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
        # All, in their order: spares two copies of the state.
        whole = dr.width(some) == dr.width(wanted) and dr.all(some == dr.arange(mi.UInt32, dr.width(some)))

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
        yield WorkItem(state.estimator, x, y, start, state.plan, end, quiet, work, done, put)


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
        end = dr.maximum(count, end)
        start = Estimate.nothing(state.estimator.values, area(band))

        def put(sums: Estimate, band: Rectangle = band, some: mi.UInt32 = some) -> None:
            state.estimate.put(replace(sums, sums=[]), some)
            state.add(image, band, band, sums)
            image.wait()
            state.decisions.rows = (image, band[3]) if band[3] < bottom else None
            if state.made is None or band[3] == bottom:
                state.made = image

        dr.eval(x, y, start, end)
        span = ((band[1] - top) / (bottom - top), (band[3] - top) / (bottom - top))
        yield WorkItem(state.estimator, x, y, start, state.plan, end, quiet, area(band) * most, span, put)


def photon_steps(
    count: mi.UInt32, wanted: mi.UInt32, state: State, sets: int | None
) -> Iterator[tuple[mi.UInt32, tuple[float, float]]]:
    """What is ``wanted`` of pixels that have ``count``, step by step: ``(wanted so far, (part done before, then))``.

    There is one step, but for caustics: each photon set is drawn once then. In one process (``sets`` 1) all pixels
    proceed alike, and a render can stop between two sets; elsewhere a step has as many sets as a process keeps (None).
    The parts are those of the time, where a photon counts as a sample: a set takes as long for few samples as for many.
    """
    caustics = state.estimator.transport.caustics
    if caustics is None:
        yield wanted, (0.0, 1.0)
        return
    maps = caustics.maps(state.plan.n)
    further = maps * (sets or caustics.kept)
    have, want = (np.array(values, dtype=np.int64) for values in (count, wanted))
    lacking = want > have
    have, want = have[lacking], want[lacking]
    if not have.size:
        return
    begun = int(have.min()) // maps * maps
    ends = range(begun + further, int(want.max()) + further, further)
    taken = [0, *(int(np.sum(np.maximum(np.minimum(want, end) - have, 0))) for end in ends)]
    costs = [samples + caustics.count * further / maps * number for number, samples in enumerate(taken)]
    for number, end in enumerate(ends):
        span = costs[number] / costs[-1], costs[number + 1] / costs[-1]
        yield dr.minimum(wanted, dr.opaque(mi.UInt32, end)), span


def portions(
    count: mi.UInt32, wanted: mi.UInt32, state: State, span: tuple[float, float], limit: Limit
) -> Iterator[tuple[tuple[float, float], mi.UInt32, int]]:
    """Indices of the pixels that lack samples, as many at a time as ``limit`` and the plan's ``band`` allow: ``((part
    done before, then), indices, samples)``. ``span``: the part done before and after all of them.

    Pixels that lack most come first: a render that stops has improved what is noisiest. Pixels that lack about as many
    are together, row by row: the lanes of a kernel wait for the last of some neighbours.
    """
    lack = np.array(wanted, dtype=np.int64) - np.array(count)
    order = np.flatnonzero(lack > 0)
    sampled, begin, before = state.estimator.sampler is not None, 0, 0
    rank = lack[order] if sampled else np.floor(CLASSES * np.log2(lack[order]))
    order = order[np.argsort(-rank, kind="stable")]
    lack = lack[order]
    ends = np.cumsum(lack)
    while begin < len(order):
        end = min(begin + state.plan.band, len(order))
        if sampled:  # it is told how many samples follow; and its work items must not depend on the time
            end = begin + int(np.sum(lack[begin:end] == lack[begin]))
        elif (most := limit(int(ends[-1]) - before)) is not None:
            end = min(end, max(begin + 1, int(np.searchsorted(ends, before + most, side="right"))))
        work = int(ends[end - 1]) - before
        first, last = (span[0] + (span[1] - span[0]) * part / ends[-1] for part in (before, before + work))
        yield (float(first), float(last)), dr_array(order[begin:end].astype(np.uint32)), work
        begin, before = end, before + work
