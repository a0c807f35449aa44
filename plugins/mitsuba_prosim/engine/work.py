"""The samples that an image lacks, as work items, and the executor that takes them in this process."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator
from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np

from ..alone import alone
from ..compat import dr_array
from .accumulators import Accumulators
from .camera import is_perspective, without_crop_window
from .estimator import Estimator
from .plan import UNLIMITED, Plan

if TYPE_CHECKING:
    from collections.abc import Callable

    from typing_extensions import Self

    from .accumulators import FilmState
    from .error_target import SecondImage

    #: Pixels that are sampled together: an image, or its second image.
    Pixels: TypeAlias = FilmState | SecondImage

#: Pixels are sorted by their number of missing samples, in this many classes for each factor of 2.
CLASSES_PER_OCTAVE = 4


class Step(NamedTuple):
    """The progress that :class:`.Render` yields after each work item."""

    #: The part of the image that is done, 0 to 1, as far as is known: it may fall.
    done: float
    #: Whether a pass over the image is complete: every pixel has a value, and the samples of that pass.
    complete: bool


class Steps(Iterator[Step]):
    """An iterator of :class:`Step`."""

    def __init__(self, steps: Generator[Step, None, None]) -> None:
        self._steps = steps

    def __next__(self) -> Step:
        return next(self._steps)

    def run(self) -> Self:
        """Takes all steps, and returns itself."""
        for _ in self:
            pass
        return self


@dataclass(frozen=True)
class WorkItem:
    """The pixels (x, y), whose samples by ``plan`` continue from ``start`` to the counts ``end``, or until they have
    converged. They need one photon pass. All arrays are evaluated, with one entry a pixel.
    """

    estimator: Estimator
    plan: Plan
    x: mi.Int32
    y: mi.Int32
    start: Accumulators
    end: mi.UInt32
    #: Number of samples, about.
    samples: int = 0
    #: Stores the sums.
    store: Callable[[Accumulators], None] = lambda sums: None

    def compute(self) -> Accumulators:
        """Takes the samples in this process and returns the sums. All arrays are evaluated, so that one kernel serves
        every work item.
        """
        sensor = self.estimator.sensor
        window = nullcontext() if is_perspective(sensor) else without_crop_window(sensor)
        with alone(), dr.suspend_grad(), window:
            if (caustics := self.estimator.transport.caustics) is not None:
                number = (int(np.max(self.end)) - 1) // caustics.maps(self.plan.n)
                caustics.draw(self.plan.photon_seed, number, self.plan.n)
            sums = self.estimator.accumulate(self.plan, self.x, self.y, self.start, self.end)
            dr.eval(sums)
        return sums


#: Work items with their sums; None while no result is ready: the caller may stop then.
Results = Generator["tuple[WorkItem, Accumulators] | None", None, None]


class Executor:
    """Takes the samples of work items, here one after the other in this process. Samples are pure, so that a subclass
    may do so anywhere and in any order. A work item takes about ``seconds``, by the time of those before.
    """

    #: Maximum growth of the speed from one work item to the next.
    SPEED_GROWTH = 4
    #: The remaining samples are one work item if they are fewer than this multiple of its size.
    LAST = 1.25
    #: Minimum number of samples of a work item: fewer take as long, as the kernel has to be launched.
    SMALLEST = 1 << 12

    def __init__(self, seconds: float = 1.0) -> None:
        self.seconds = seconds
        #: Samples in a second; at first, those of a usual scene.
        cpu = dr.backend_v(mi.Float) == dr.JitBackend.LLVM
        self.speed: float = 2**20 * dr.thread_count() if cpu else 2**24
        self.measured = False

    def limit(self, left: int, seconds: float = np.inf) -> int:
        """Samples of the next work item, of those that are ``left``, if it should not take more than ``seconds``."""
        size = self.speed * min(self.seconds, seconds)
        return left if left < self.LAST * size else max(int(size), self.SMALLEST)

    def update_speed(self, samples: int, seconds: float) -> None:
        """Updates the speed from the time of a work item."""
        speed = min(samples / max(seconds, 1e-6), self.SPEED_GROWTH * self.speed)
        if self.measured or speed > self.speed:  # the first work item compiles: it must not lower the speed
            self.speed = speed
        self.measured = True

    def __call__(self, items: Iterator[WorkItem]) -> Results:
        """Yields each of ``items`` with its sums."""
        for item in items:
            started = time.perf_counter()
            sums = item.compute()
            dr.sync_thread()
            self.update_speed(item.samples, time.perf_counter() - started)
            yield item, sums


def work_items(pixels: Pixels, wanted: np.ndarray, executor: Executor, seconds: float = np.inf) -> Iterator[WorkItem]:
    """The samples that ``pixels`` lack to the counts ``wanted``, as work items of the size that suits ``executor`` and
    takes ``seconds`` at most.

    Pixels with most missing samples come first: if the render stops, the noisiest have improved. Pixels with similar
    numbers are together, row by row: the lanes of a kernel wait for the slowest of their neighbours.
    """
    lack = wanted - np.array(pixels.accumulators.count, dtype=np.int64)
    order = np.flatnonzero(lack > 0)
    order = order[np.argsort(-np.floor(CLASSES_PER_OCTAVE * np.log2(lack[order])), kind="stable")]
    ends = np.cumsum(lack[order])
    begin = before = 0
    while begin < len(order):
        most = before + executor.limit(int(ends[-1]) - before, seconds)
        end = max(begin + 1, int(np.searchsorted(ends, most, side="right")))
        end = min(end, begin + pixels.plan.sampling.band)
        samples, before = int(ends[end - 1]) - before, int(ends[end - 1])
        yield _work_item(pixels, order[begin:end], wanted, samples)
        begin = end


@alone()
def _work_item(pixels: Pixels, some: np.ndarray, wanted: np.ndarray, samples: int) -> WorkItem:
    """The work item of the entries ``some``."""
    x, y, start, plan, end = pixels.x, pixels.y, pixels.accumulators, pixels.plan, dr_array(wanted[some])
    index = None
    if len(some) < len(wanted) or np.any(some[1:] < some[:-1]):
        index = dr_array(some.astype(np.uint32))
        x, y, start = (dr.gather(type(values), values, index) for values in (x, y, start))
        if dr.width(plan.seed) > 1:
            plan = replace(plan, seed=dr.gather(mi.UInt32, plan.seed, index))
        dr.eval(x, y, start, plan.seed)

    @alone()
    def store(sums: Accumulators) -> None:
        if index is None:
            pixels.accumulators = sums
        else:
            dr.scatter(pixels.accumulators, sums, index, mode=dr.ReduceMode.NoConflicts)
            dr.eval(pixels.accumulators)

    return WorkItem(pixels.estimator, plan, x, y, start, end, samples, store)


def photon_batches(pixels: Pixels, wanted: np.ndarray) -> Iterator[np.ndarray]:
    """Splits the samples that ``pixels`` lack to the counts ``wanted`` into batches, each of which needs one photon
    pass: the counts after each of them. A pass has a map for each of some samples of a pixel. Without caustics there is
    one batch; none if no pixel lacks samples.
    """
    caustics, count = pixels.estimator.transport.caustics, np.array(pixels.accumulators.count)
    lacking, maps = wanted > count, UNLIMITED if caustics is None else caustics.maps(pixels.plan.n)
    if lacking.any():
        for first in range(int(count[lacking].min()) // maps * maps, int(wanted.max()), maps):
            yield np.minimum(wanted, np.uint32(first + maps))
