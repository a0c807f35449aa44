"""The samples that an image lacks, as work items, and the executor that takes them in this process."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator
from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple, Protocol

import drjit as dr
import mitsuba as mi
import numpy as np

from ..alone import alone
from ..compat import dr_array
from .accumulators import Accumulators
from .camera import has_own_rays, uncropped
from .estimator import Estimator
from .plan import Plan
from .policies import Policy

if TYPE_CHECKING:
    from collections.abc import Callable

#: Pixels in one work item lack about the same number of samples, within a factor of 2 to the power of 1 over this.
CLASSES = 4


class Step(NamedTuple):
    """The progress that :class:`.Render` yields after each work item."""

    #: The part of the image that is done, 0 to 1, as far as is known: it may fall.
    done: float
    #: Whether a pass over the image is complete: every pixel has a value, and the samples of that pass.
    complete: bool


class Pixels(Protocol):
    """Pixels that are sampled together: an image, or its second image. One entry a pixel."""

    plan: Plan
    estimator: Estimator
    x: mi.Int32
    y: mi.Int32
    accumulators: Accumulators


@dataclass(frozen=True)
class WorkItem:
    """The pixels (x, y), whose samples by ``plan`` continue from ``start`` to the counts ``end``, or until they have
    converged by ``policy``. All arrays are evaluated, with one entry a pixel.
    """

    estimator: Estimator
    plan: Plan
    x: mi.Int32
    y: mi.Int32
    start: Accumulators
    end: mi.UInt32
    policy: Policy | None = None
    #: Number of samples, about.
    work: int = 0
    #: Stores the sums.
    put: Callable[[Accumulators], None] = lambda sums: None

    def photon_sets(self) -> list[tuple[int, int, int]]:
        """The photon sets that it needs, see :meth:`.Estimator.photon_sets`."""
        sets = self.estimator.photon_sets(self.plan, self.start.count, self.end)
        return [which for which, _ in sets if which is not None]

    def take(self) -> Accumulators:
        """Takes the samples, in this process."""
        sensor = self.estimator.sensor
        with alone(), nullcontext() if has_own_rays(sensor) else uncropped(sensor):
            return self.estimator.take(self.plan, self.x, self.y, self.start, self.end, self.policy)


#: Work items with their sums; None while no result is ready: the caller may stop then.
Results = Generator["tuple[WorkItem, Accumulators] | None", None, None]


class Executor(Protocol):
    """Takes the samples of work items. Samples are pure, so that it may do so anywhere and in any order."""

    #: Photon sets that the work items of a step may need; None: as many as a process keeps.
    sets: int | None

    def limit(self, left: int, seconds: float) -> int:
        """Samples of the next work item at most, of those that are ``left``; ``seconds``: it should not take longer."""

    def __call__(self, items: Iterator[WorkItem]) -> Results:
        """Yields each of ``items`` with its sums."""


class TimeSlicer:
    """Sizes work items to take ``seconds``, about, by the time of those before."""

    #: Maximum growth of the speed from one work item to the next; and the remaining samples are one work item if they
    #: are fewer than this number of work items.
    GROWTH, LAST = 4, 1.25

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        #: Samples in a second; at first, those of a usual scene.
        cpu = dr.backend_v(mi.Float) == dr.JitBackend.LLVM
        self.speed: float = 2**20 * dr.thread_count() if cpu else 2**24
        self.first = True  # whose time is that of the compiler

    def limit(self, left: int, seconds: float = np.inf) -> int:
        """Samples of the next work item, of those that are ``left``, if it should not take more than ``seconds``."""
        size = self.speed * min(self.seconds, seconds)
        return left if left < self.LAST * size else max(int(size), 1)

    def learn(self, work: int, seconds: float) -> None:
        """Adapts the speed to the time of a work item of ``work`` samples."""
        speed = work / max(seconds, 1e-6)
        if speed > self.speed:
            self.speed = min(speed, self.GROWTH * self.speed)
        elif not self.first:
            self.speed = speed
        self.first = False


class Local:
    """Takes the samples in this process, one work item after the other."""

    sets = 1

    def __init__(self, seconds: float = 1.0) -> None:
        self.slicer = TimeSlicer(seconds)

    def limit(self, left: int, seconds: float) -> int:
        """Samples of the next work item, by the time of those before."""
        return self.slicer.limit(left, seconds)

    def __call__(self, items: Iterator[WorkItem]) -> Results:
        """Yields each of ``items`` with its sums."""
        for item in items:
            started = time.perf_counter()
            sums = item.take()
            dr.sync_thread()
            self.slicer.learn(item.work, time.perf_counter() - started)
            yield item, sums


def work_items(
    pixels: Pixels, wanted: np.ndarray, policy: Policy | None, limit: Callable[[int], int]
) -> Iterator[WorkItem]:
    """The samples that ``pixels`` lack to the counts ``wanted``, as work items of about ``limit(left)`` samples.

    Pixels that lack most come first: a render that stops has improved the noisiest. Pixels that lack about as many are
    together, row by row: the lanes of a kernel wait for the last of some neighbours.
    """
    with alone():
        lack = wanted - np.array(pixels.accumulators.count, dtype=np.int64)
    order = np.flatnonzero(lack > 0)
    order = order[np.argsort(-np.floor(CLASSES * np.log2(lack[order])), kind="stable")]
    ends = np.cumsum(lack[order])
    begin = before = 0
    while begin < len(order):
        most = before + limit(int(ends[-1]) - before)
        end = max(begin + 1, int(np.searchsorted(ends, most, side="right")))
        end = min(end, begin + pixels.plan.sampling.band)
        work, before = int(ends[end - 1]) - before, int(ends[end - 1])
        with alone():
            item = _work_item(pixels, order[begin:end], wanted, policy, work)
        begin = end
        yield item


def _work_item(pixels: Pixels, some: np.ndarray, wanted: np.ndarray, policy: Policy | None, work: int) -> WorkItem:
    """The work item of the entries ``some``."""
    x, y, start, plan, end = pixels.x, pixels.y, pixels.accumulators, pixels.plan, dr_array(wanted[some])
    index = None
    if len(some) < len(wanted) or np.any(some[1:] < some[:-1]):
        index = dr_array(some.astype(np.uint32))
        x, y, start = dr.gather(mi.Int32, x, index), dr.gather(mi.Int32, y, index), start.at(index)
        if dr.width(plan.seed) > 1:
            plan = replace(plan, seed=dr.gather(mi.UInt32, plan.seed, index))
        dr.eval(x, y, start, plan.seed)

    def put(sums: Accumulators) -> None:
        if index is None:
            pixels.accumulators = sums
        else:
            pixels.accumulators.put(sums, index)
            dr.eval(pixels.accumulators)

    return WorkItem(pixels.estimator, plan, x, y, start, end, policy, work, put)


def photon_steps(pixels: Pixels, wanted: np.ndarray, sets: int | None) -> list[np.ndarray]:
    """The counts up to those ``wanted`` that ``pixels`` reach step by step, so that each photon set is drawn once.

    In one process (``sets`` 1) all pixels proceed alike, and a render can stop between two sets; elsewhere a step has
    as many sets as a process keeps (None). Without caustics there is one step.
    """
    caustics = pixels.estimator.transport.caustics
    if caustics is None:
        return [wanted]
    have = np.array(pixels.accumulators.count)
    lacking = wanted > have
    if not lacking.any():
        return []
    maps = caustics.maps(pixels.plan.n)
    further = maps * (sets or caustics.capacity)
    first = int(have[lacking].min()) // maps * maps
    ends = range(first + further, int(wanted.max()) + further, further)
    return [np.minimum(wanted, np.uint32(end)) for end in ends]
