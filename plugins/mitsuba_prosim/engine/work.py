"""Divides the samples that an image still needs into work items, and computes work items in this process."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from ..alone import alone
from ..compat import denormals_rounded, dr_array
from .accumulators import Accumulators
from .camera import without_crop_window
from .estimator import Estimator
from .pixel_set import PixelSet
from .plan import Plan

if TYPE_CHECKING:
    from typing_extensions import Self

    from .image import Image

#: Maximum number of sums of the pixels of a work item, which limits memory: wide filters have many sums per pixel.
MOST_SUMS = 1 << 23
#: Maximum number of values of all samples of a work item, in multiples of the parameter ``band``, for the same reason.
MOST_VALUES = 1 << 10
#: Minimum number of seconds, after the launch, from which the computation of a work item tells the speed.
CLEAR = 0.02


class Step(NamedTuple):
    """The progress that :class:`.Render` yields after each work item."""

    #: Finished fraction of the image, 0 to 1: an estimate, which may decrease.
    done: float
    #: Whether a pass over the image has ended, so that consumers may show the image. The pass may have been stopped
    #: before its end; every pixel has at least one sample.
    complete: bool


class Steps(Iterator[Step]):
    """An iterator over the :class:`Step` objects of a render."""

    def __init__(self, steps: Generator[Step, None, None]) -> None:
        self._steps, self._variant = steps, mi.variant()

    def __next__(self) -> Step:
        self.check_variant()
        return next(self._steps)

    def check_variant(self) -> None:
        """Raises RuntimeError if another variant is active than at the beginning, because the scene belongs to this
        one.
        """
        if mi.variant() != self._variant:
            raise RuntimeError(f"This render began in the variant {self._variant}; set it again to continue.")

    def run(self) -> Self:
        """Takes all steps, and returns the iterator."""
        for _ in self:
            pass
        return self


@dataclass(frozen=True)
class WorkItem:
    """A unit of work for an executor: some pixels of an image, and the number of samples that each pixel should reach.

    ``start`` are the sums over the earlier samples of the pixels (x, y). Each pixel gets further samples until it has
    ``end`` samples. All samples of a work item gather photons of the same photon pass. All Dr.Jit arrays of a work item
    are evaluated, and have one entry per pixel.
    """

    estimator: Estimator
    plan: Plan
    x: mi.Int32
    y: mi.Int32
    start: Accumulators
    end: mi.UInt32
    #: Number of samples that the pixels need together.
    samples: int
    #: Function that stores the sums in the image; in another process, it only evaluates them.
    store: Callable[..., None] = dr.eval

    def compute(self) -> Accumulators:
        """Returns the new sums of the pixels, evaluated, so that the next work item can use the same kernel."""
        with alone(), denormals_rounded(), dr.suspend_grad(), without_crop_window(self.estimator.sensor):
            if (caustics := self.estimator.transport.caustics) is not None:
                # All samples of a work item need the same photon pass, that of the last sample.
                number = (int(np.max(self.end)) - 1) // caustics.maps(self.plan.n)
                caustics.use_pass(self.plan.photon_seed, number, self.plan.n)
            sums = self.estimator.accumulate(self.plan, self.x, self.y, self.start, self.end, self.samples)
            self.store(sums)
        return sums


#: Yields work items whose sums are stored. Yields None while no result is ready, so that the caller can stop.
Results = Generator["WorkItem | None", None, None]


class Executor:
    """Computes work items in this process, one after the other.

    The value of a sample depends only on the scene, the plan, the pixel and the number of the sample, so a subclass may
    compute work items in other processes and in any order. The computation of a work item takes about ``seconds``: the
    executor chooses the size of the work item by the measured speed of earlier work items. If the item takes long to be
    traced and launched, its computation takes :attr:`TRACED` times as long, but at most ``longest`` seconds.
    """

    #: Minimum ratio of the time in which a work item is computed to that in which it is traced and launched.
    TRACED = 50

    #: Maximum factor by which the speed grows from one work item to the next.
    SPEED_GROWTH = 4
    #: The remaining samples become one work item if they are fewer than this multiple of the usual size.
    LAST = 1.25
    #: Minimum number of samples of a work item. A smaller item takes the same time, because a kernel must be launched.
    SMALLEST = 1 << 12

    def __init__(self, seconds: float = 1.0, longest: float = 5.0) -> None:
        self.seconds, self.longest = seconds, longest
        #: Samples per second; at first, the speed in a usual scene.
        cpu = dr.backend_v(mi.Float) == dr.JitBackend.LLVM
        self.speed: float = 2**20 * dr.thread_count() if cpu else 2**24
        #: Number of measured work items, whether they told the speed, and seconds in which the latest one was traced
        #: and launched.
        self.measured, self.is_known, self.overhead = 0, False, 0.0
        #: Seconds in which kernels were traced, compiled and launched.
        self.launching = 0.0

    def limit(self, left: int, seconds: float = np.inf) -> int:
        """Returns the maximum number of samples of the next work item.

        ``left`` is the number of samples that still have to be divided into work items. The computation of the work
        item should not take longer than ``seconds``, nor than an item usually takes. If ``left`` is less than
        :attr:`LAST` times the number of samples for this time, the result is ``left``; else it is at least
        :attr:`SMALLEST`, even if this takes longer. With limited ``seconds``, the work items are small until the speed
        is measured. Samples take at least as long as the launch of their work item.
        """
        usual = max(self.seconds, min(self.TRACED * self.overhead, self.longest))
        is_known = self.is_known or not np.isfinite(seconds)
        size = self.speed * max(min(usual, seconds), self.overhead) if is_known else self.SMALLEST
        return left if left < self.LAST * size else max(int(size), self.SMALLEST)

    def update_speed(self, samples: int, seconds: float, overhead: float = 0.0) -> None:
        """Updates the measured speed after a work item of ``samples`` samples took ``seconds``, after ``overhead``
        seconds in which it was traced and launched.

        The new speed is the speed of this work item, but at most :attr:`SPEED_GROWTH` times the old speed. What is
        computed in less than :data:`CLEAR` seconds was in part computed during the launch: then the launch counts, and
        the speed is lowered only if it was not known. The first item includes the compilation, unless in ``overhead``.
        """
        is_clear = seconds > CLEAR and bool(self.measured or overhead)
        speed = min(samples / max(seconds + (0.0 if is_clear else overhead), 1e-6), self.SPEED_GROWTH * self.speed)
        if is_clear or speed > self.speed or (self.measured and not self.is_known):
            self.speed = speed
        self.is_known = self.is_known or is_clear or self.measured > 0
        self.overhead = overhead if self.measured else 0.0
        self.launching += overhead
        self.measured += 1

    def __call__(self, items: Iterator[WorkItem]) -> Results:
        """Computes the work items ``items`` one by one, stores their sums, and yields each."""
        for item in items:
            started = time.perf_counter()
            item.compute()
            launched = time.perf_counter()
            dr.sync_thread()
            if self.measured and dr.thread_count() == 1 and dr.backend_v(mi.Float) == dr.JitBackend.LLVM:
                launched = started  # a single thread has computed the kernel when it launched it
            self.update_speed(item.samples, time.perf_counter() - launched, launched - started)
            yield item


def lacking(image: PixelSet, wanted: np.ndarray) -> np.ndarray:
    """Returns how many samples each of the first pixels of both images lacks until it has the number ``wanted``."""
    return np.maximum(wanted - np.array(image.accumulators.count, dtype=np.int64)[: len(wanted)], 0)


def work_items(
    image: PixelSet, plan: Plan, wanted: np.ndarray, executor: Executor, seconds: Callable[[], float]
) -> Iterator[WorkItem]:
    """Yields work items that together bring each of the first pixels of both images to the number of samples
    ``wanted``, by ``plan``.

    Pixels that already have this number are in no work item. ``executor`` limits the size of the work items, so that
    each one takes at most about ``seconds()``. The pixels that need most samples come first, so that the noisiest
    pixels have improved if the render is stopped early. Among pixels that need equal numbers of samples, neighbours are
    in the same work item if possible, because their rays are similar.
    """
    lack = lacking(image, wanted)
    here = image.along_z[image.along_z < len(lack)]
    order = here[lack[here] > 0]
    # A stable sort of 16 bits is fast, and keeps the order along the Z curve among equal numbers.
    order = order[np.argsort(np.minimum(lack.max() - lack[order], 0xFFFF).astype(np.uint16), kind="stable")]
    # Dr.Jit would compile another kernel for an item of one pixel. So each item has two at least, if the image has two;
    # the second one may lack no sample.
    if len(order) == 1:
        order = np.append(order, here[lack[here] == 0][:1])
    ends, wanted = np.cumsum(lack[order]), np.maximum(wanted, np.array(image.accumulators.count)[: len(wanted)])
    # A sample has the values of the channels, its luminance and its position.
    bound = plan.sampling.band * MOST_VALUES // (len(image.estimator.channels.names) + 3)
    begin = before = 0
    while begin < len(order):
        most = before + min(executor.limit(int(ends[-1]) - before, seconds()), bound)
        end = begin + min(plan.sampling.band, MOST_SUMS // image.estimator.sums_per_pixel)
        end = max(begin + 2, min(end, int(np.searchsorted(ends, most, side="right"))))
        end = end if end < len(order) - 1 else len(order)
        samples, before = int(ends[end - 1]) - before, int(ends[end - 1])
        some = order[begin:end].astype(np.uint32)
        yield _work_item(image, plan, dr_array(some), dr_array(wanted[some]), samples)
        begin = end


@alone()
def _work_item(image: PixelSet, plan: Plan, pixels: mi.UInt32, end: mi.UInt32, samples: int) -> WorkItem:
    """Returns the work item that brings ``pixels`` to ``end`` samples each: at most ``samples`` samples together."""
    sums = image.accumulators
    dr.make_opaque(sums)  # constants would be a part of the kernel
    (x, y, seed), start = dr.gather(tuple, (image.x, image.y, image.seed), pixels), sums.of(pixels)
    dr.eval(x, y, seed, start)
    store = alone()(partial(sums.store, pixels))
    return WorkItem(image.estimator, replace(plan, seed=seed), x, y, start, end, samples, store)


def batches(image: Image, wanted: np.ndarray) -> Iterator[tuple[Plan, np.ndarray]]:
    """Divides the samples that pixels need to reach the numbers ``wanted`` into batches.

    Yields, for each batch, its plan, and the number of samples of each pixel after the batch; a pixel that already has
    more samples takes none. The photon maps of one photon pass are used for a fixed number of successive samples of
    each pixel, so each photon pass has a batch. An image and its second image have different photons, so they have
    different batches. Without caustics, there is only one batch.
    """
    caustics = image.estimator.transport.caustics
    if caustics is None:
        yield image.plan, wanted
        return
    count = np.array(image.accumulators.count)[: len(wanted)]
    for pixels in (image, image.second):
        if pixels is not None and (lack := wanted[pixels.own] > count[pixels.own]).any():
            numbers, maps = wanted[pixels.own], caustics.maps(image.plan.n)
            for first in range(int(count[pixels.own][lack].min()) // maps * maps, int(numbers.max()), maps):
                batch = count.copy()
                batch[pixels.own] = np.minimum(numbers, np.uint32(first + maps))
                yield pixels.plan, batch
