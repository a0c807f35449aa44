"""A progressive render: an iterator over the work items of an image, which the caller may stop after any work item."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator
from contextlib import closing, suppress
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from ..alone import alone
from .checkpoint import Checkpoint
from .error import in_display_units
from .error_target import GROWTH, UNCERTAIN, ErrorTarget, mean, next_counts, remaining_factor
from .estimator import Estimator
from .film import film_values, put
from .image import Image, SecondImage
from .pixel_set import PixelSet
from .plan import UNLIMITED, Plan, area
from .tiles import Part
from .tiny_lamps import sees_tiny_lamp
from .work import Executor, Step, Steps, photon_batches, work_items


class Reached(NamedTuple):
    """Number of samples, error and elapsed time of the image so far."""

    #: Mean and minimum number of samples of a pixel.
    samples: float
    min_samples: int
    #: RMS error of the displayed image (white = 1), and the bounds of the errors of 99 % and of 99.9 % of the pixels.
    #: The values are NaN without a limit of noise, because the errors were not measured.
    noise: float
    noise_99: float
    noise_999: float
    #: Upper bound of the RMS error, which exceeds the bound with a probability of about 5 %.
    noise_at_most: float
    #: Whether rays may miss a lamp, see :func:`.sees_tiny_lamp`.
    tiny_lamp: bool
    #: Seconds since the beginning of the render.
    seconds: float

    @property
    def uncertain(self) -> bool:
        """Whether the RMS error is uncertain, because few pixels have most of the error or rays may miss a lamp."""
        return self.tiny_lamp or self.noise_at_most > UNCERTAIN * self.noise


class Pass(NamedTuple):
    """A pass over the image: takes samples until each of ``pixels`` has ``wanted`` samples or has converged.

    After a pass that ended early, the next pass takes the first sample of each pixel that has no sample;
    :meth:`Render.stop` cannot end this next pass.
    """

    pixels: PixelSet
    wanted: np.ndarray
    #: Estimated number of samples of all pixels together at the end of the image; if the number is 0, the samples of
    #: this pass do not count as progress.
    expected: float = 0.0


#: Passes, and steps that show the image between two passes.
Passes = Iterator["Pass | Step"]


class Render(Steps):
    """A progressive render of the image ``plan``, or of the ``part`` of this image: an iterator over :class:`Step`
    objects.

    The methods of this class may be called between two steps of the iteration. After the end of the render or a call of
    :meth:`close`, the film holds the image so far. To cancel a render, leave the loop over its steps and call
    :meth:`close`. If the render has started, :meth:`close` takes the first sample of each pixel that has no sample.
    ``estimator`` takes the samples. ``executor`` computes the work items; the default executor computes them in this
    process. ``begin`` is a checkpoint from which the render continues.

    ``denoiser`` is a ``FinalImage``, which estimates the error of the denoised image. The denoiser needs a complete
    second image. The complete second image begins when the denoiser requests it, or at the end of the render unless the
    image without denoising has reached an error target. With a time limit, or with an error target for a small image,
    the complete second image begins together with the first image.

    Raises ValueError if the checkpoint ``begin`` belongs to another image, or cannot be continued with the policy of
    ``plan`` (:meth:`.Checkpoint.restore`).
    """

    def __init__(
        self,
        plan: Plan,
        estimator: Estimator,
        executor: Executor | None = None,
        begin: Checkpoint | None = None,
        part: Part | None = None,
        denoiser: Any = None,
    ) -> None:
        self.state = Image(plan, estimator, part if begin is None else begin.part)
        self.film, self.executor = estimator.sensor.film(), executor or Executor()
        elapsed = 0.0 if begin is None else begin.attributes["seconds"]
        self.target = ErrorTarget(plan.sampling.noises, plan.sampling.time, time.perf_counter() - elapsed)
        #: Whether the image has all requested samples.
        self.finished = begin is not None and begin.restore(self.state)
        #: Whether :meth:`stop` was called; whether the last pass came to its end; the progress, 0 to 1.
        self._stopped, self._complete, self._done = False, True, 0.0
        #: The film's values after the end of the render; None before.
        self._values: mi.TensorXf | None = None
        self.denoiser = denoiser
        self._tiny_lamp = sees_tiny_lamp(estimator.scene, estimator.sensor)
        self.second: SecondImage | None = None
        if any(self.target.limits) or (denoiser is not None and self.target.seconds):
            # With a denoiser, the second image is complete from the beginning if the time is limited (and the error is
            # not reached yet), if the image is small, or if the checkpoint has a complete second image.
            pixel_count, restored = area(plan.region), self.state.second
            begun = restored is not None and dr.width(restored.count) == pixel_count
            reached = self.target.excess(self.state.noise) <= 1
            complete = (bool(self.target.seconds) and not reached) or pixel_count < 2 * SecondImage.MIN_PIXELS or begun
            self.second = SecondImage(self.state, complete and denoiser is not None)
        super().__init__(self._run())

    # ---------------------------------------------------------------- as an iterator

    def stop(self) -> None:
        """Ends the render after the current work item; any thread may call this method."""
        self._stopped = True

    def close(self) -> None:
        """Ends the render. If any pixel has a sample, the pixels without samples get their first sample, so that no
        pixel of the image is missing.
        """
        self.stop()
        self.run()

    def _run(self) -> Generator[Step, None, None]:
        """Takes the samples of all passes over the image, yields the steps, and then writes the image to the film.

        If an error or Ctrl-C ends the render, the image so far is written to the film, and the error is raised again.
        """
        target = self.target
        try:
            for current in self._passes():
                if isinstance(current, Step):
                    yield current
                    continue
                pixels, wanted, expected = current
                shown = self.state.rounds == 0 or not self.state.plan.sampling.has_target
                # Number of samples that the pass lacks before the current batch, and number taken in this batch. The
                # pass is complete if both agree in the last batch.
                missing = taken = 0
                for batch in photon_batches(pixels, wanted):
                    # A pixel that converged in the previous batch still lacks samples, and takes none.
                    count, taken = np.array(pixels.accumulators.count, dtype=np.int64), 0
                    missing = int(np.maximum(wanted - count, 0).sum())
                    items = work_items(pixels, batch, self.executor, target.item_seconds)
                    with closing(self.executor(items)) as results:
                        for result in results if not self._must_end(wanted) else ():
                            if result is not None:
                                item, sums = result
                                item.store(sums)
                                taken += item.samples
                                done = (int(count.sum()) + taken) / expected if expected else self._done
                                by_time = 1 - target.seconds_left / target.seconds if target.seconds else 0.0
                                self._done = min(max(done, by_time), 1.0)
                            yield Step(self._done, False)
                            if taken < missing and self._must_end(wanted):
                                break
                self._complete = taken == missing
                # With an error target, :meth:`_refine` yields this step itself, after it has measured the error.
                if (shown or not self._complete) and np.all(self.state.counts > 0):
                    yield Step(self._done, True)
            self.finished = not self._stopped and (self._complete or target.time_is_up)
            if self.finished and self._done < 1:
                yield Step(1.0, True)
        except (Exception, KeyboardInterrupt):
            with suppress(Exception):  # a second error would hide the first one
                self.update_film()
            raise
        self._values = film_values(self.state)
        self.update_film()

    def _must_end(self, wanted: np.ndarray) -> bool:
        """Tells whether the current pass, in which the pixels get ``wanted`` samples, must end now.

        A pass ends early if :meth:`stop` was called or if the time limit is reached. The time limit does not end a pass
        that takes only the first sample of each pixel. :meth:`stop` does not end a pass that follows an incomplete
        pass, because this pass takes the first samples of pixels without samples.
        """
        return bool((self._complete and self._stopped) or (np.any(wanted > 1) and self.target.time_is_up))

    def begin_complete_second(self) -> SecondImage:
        """Begins or continues a complete second image, and returns it; the samples of a second image of only some
        pixels are discarded.
        """
        self.second = SecondImage(self.state, complete=True)
        return self.second

    # ---------------------------------------------------------------- the passes

    def _passes(self) -> Passes:
        """Yields the passes over the image until the image is complete or a pass ends early.

        If the first pass ends early after some samples, one more pass takes the first sample of each pixel that has
        none. If the render has a denoiser, was not stopped, and the image has not reached an error target, passes over
        the second image follow.
        """
        state = self.state
        one = state.counts_of_part(np.ones(dr.width(state.x), np.uint32), state.margin)
        for current in self._image_passes(one) if not self.finished else ():
            yield current
            if not self._complete:
                # In the first pass, pixels without samples get one sample, so that no pixel is missing.
                if state.rounds == 0 and np.any(state.accumulators.count):
                    yield Pass(state, one)
                break
        within = self.target.excess(state.noise) <= 1
        if self.denoiser is not None and not within and not self._stopped:
            second = self.begin_complete_second()  # a complete second image that has begun continues
            yield self._second_pass(second, 1)  # the time limit cannot end this pass: each pixel gets a sample
            yield self._second_pass(second)
            if any(self.target.limits) and not self._stopped:
                state.noise = second.noise()

    def _image_passes(self, one: np.ndarray) -> Passes:
        """Yields the passes over the first image; a state from a checkpoint continues with the checkpoint's samples and
        decisions.

        The array ``one`` is 1 for each pixel that needs samples, and 0 for all other pixels.
        """
        state, plan, policy = self.state, self.state.plan, self.state.policy
        # Maximum number of samples of the whole image. The progress uses it while later passes are not decided.
        most = float(plan.max_samples * np.count_nonzero(one))
        if state.rounds == 0:
            if self.target.seconds:  # shows an image after one sample per pixel
                yield Pass(state, one)
            yield Pass(state, one * np.uint32(policy.first_samples), most)
            if policy.first_samples == plan.max_samples and not any(self.target.limits):
                return
        if plan.sampling.has_target:
            state.rounds = 1
            yield from self._refine()
            return
        while state.wanted is not None or state.rounds < policy.rounds:
            left = policy.rounds - state.rounds
            if state.wanted is None:
                left -= 1
                # The next decisions use neighbouring pixels. The neighbours of a part of an image must have the same
                # samples as in the whole image. Each decision that is left needs a margin of ``policy.reach``.
                wanted = state.counts_for(state.request(left * policy.reach))
                if left:  # few samples give unreliable estimates
                    wanted = np.minimum(wanted, np.maximum(GROWTH * np.array(state.accumulators.count), plan.n**2))
                state.wanted, state.rounds = state.counts_of_part(wanted, left * policy.reach), state.rounds + 1
            expected = most if left else float(state.wanted.sum(dtype=np.int64))
            yield Pass(state, state.wanted, expected)
            state.wanted = None

    def _refine(self) -> Passes:
        """Yields passes until the error target or the time limit is reached; after each pass, the error is measured.

        In each pass, the number of samples of a pixel is the number that the policy requests, times a factor that
        depends on the error target and the time limit. The passes also end if each pixel has the plan's maximum number
        of samples; a render with a denoiser then first begins a complete second image. If the checkpoint was made
        during a pass (``state.wanted`` is not None), the render first completes this pass, and then measures the error.
        """
        state, target, started = self.state, self.target, time.perf_counter()
        have = mean(state.counts)
        # Samples per pixel and second of a restored render. After the first pass alone the speed is not known (0),
        # because the first pass also compiles kernels.
        speed = have / target.elapsed if have > state.plan.min_samples else 0.0
        while True:
            if state.wanted is not None:
                count = np.array(state.accumulators.count)
                have, started, expected = mean(count), time.perf_counter(), np.inf
                if any(target.limits):
                    expected = max(have * remaining_factor(state, target), mean(state.wanted))
                yield Pass(state, state.wanted, expected * len(count))
                state.wanted = None
            if (second := self.second) is not None:
                yield self._second_pass(second)
                target.sample_ratio = 0.0
                state.noise = self.denoiser.estimate(self) if self.denoiser else second.noise()
                if self.second is not second:  # the denoiser has begun a complete second image: take its samples
                    continue
            if (more := mean(state.counts) - have) > 0:
                speed = more / max(time.perf_counter() - started, 1e-9)
            yield Step(self._done, True)  # lets consumers show the image with its error
            if target.time_is_up or target.excess(state.noise) <= 1:
                return
            wanted = next_counts(state, target, speed)
            if np.any(wanted > np.array(state.accumulators.count)):
                state.wanted = wanted
            elif self.denoiser is not None and self.second is not None and not self.second.complete:
                self.begin_complete_second()
            else:  # each pixel has the maximum number of samples of the plan
                return

    def _second_pass(self, second: SecondImage, most: int = UNLIMITED) -> Pass:
        """Returns a pass in which each pixel of the ``second`` image gets as many samples as the pixel has in the first
        image, but at most ``most``.
        """
        return Pass(second, np.minimum(np.array(self.state.accumulators.count)[second.index], np.uint32(most)))

    # ---------------------------------------------------------------- the image so far

    @alone()
    def update_film(self, second: bool = False) -> None:
        """Writes the image so far to the film.

        If ``second`` is true and the render has a second image (:class:`.SecondImage`), writes the second image instead
        of the first to the film; the second image must be complete.
        """
        # After the end of the render, the values of the first image are stored; otherwise they are computed now.
        stored, image = (self._values, self.state) if self.second is None or not second else (None, self.second)
        put(self.film, film_values(image) if stored is None else stored, self.state.estimator.channels.aov_names)
        self.film.schedule_storage()
        dr.eval()  # pending work of this thread would break dr.freeze in another thread

    @alone()
    def image(self, second: bool = False) -> mi.TensorXf:
        """Returns the developed image so far, shape (height, width, channels).

        If ``second`` is true and the render has a second image (:class:`.SecondImage`), returns the second image
        instead of the first; the second image must be complete. The film holds the returned image afterwards.
        """
        self.update_film(second)
        return self.film.develop()

    def half_images(self) -> list[np.ndarray]:
        """Returns a list of one or two images of shape (height, width, channels).

        The list has the developed first image, and the second image if the second image is complete and has a sample of
        each pixel.
        """
        second = self.second
        both = second is not None and second.complete and np.all(np.array(second.accumulators.count) > 0)
        # The first image is developed last, because the film must hold it at the end. So the list is reversed.
        return [np.array(self.image(is_second)) for is_second in ((True, False) if both else (False,))][::-1]

    @property
    @alone()
    def reached(self) -> Reached:
        """Samples, error and time so far; the error is that of the last measurement."""
        counts = self.counts()
        return Reached(mean(counts), int(counts.min()), *self.state.noise, self._tiny_lamp, self.target.elapsed)

    @alone()
    def error(self) -> np.ndarray:
        """Returns the standard error of the luminance of each pixel of the first image, estimated from the samples
        within the pixel, shape (height, width). The error is NaN for a pixel without samples.
        """
        return self.state.crop(self.state.accumulators.error(self.state.plan.n), self.state.plan.window)

    @alone()
    def counts(self) -> np.ndarray:
        """Returns the number of samples of each pixel, shape (height, width), including the samples of a complete
        second image.
        """
        counts = np.array(self.state.accumulators.count)
        if self.second is not None and self.second.complete:
            counts[self.second.index] += np.array(self.second.accumulators.count)
        return self.state.crop(counts, self.state.plan.window)

    @alone()
    def noise_bound(self) -> float:
        """Returns an upper bound of the RMS error of the displayed image (white = 1).

        The bound is estimated from the samples within each pixel (:meth:`.Accumulators.error`), as if these samples, or
        the passes, were independent. The samples are better distributed than independent samples, so the actual error
        is smaller than the bound; only a second image can measure the actual error. The bound is NaN if a pixel has
        fewer than two samples.
        """
        state, sums = self.state, self.state.accumulators
        total, _, count = sums.statistics()
        with np.errstate(all="ignore"):  # NaN without samples
            error = in_display_units(sums.error(state.plan.n), total / count)
        values = np.float64(state.crop(error, state.plan.region))
        # The reconstruction filter multiplies the variance by the sum of its squared weights. On each axis, the sample
        # is a quarter of a pixel from the centre of its pixel: the mean distance of a random sample.
        weights = np.array(dr.concat(state.estimator.weights(mi.Point2f(0.25))))
        result = float(np.sqrt(np.mean(values**2)) * np.linalg.norm(weights) / np.sum(weights))
        return result if state.counts.min() > 1 and np.isfinite(result) else float("nan")

    @alone()
    def checkpoint(self) -> Checkpoint:
        """Returns the :class:`.Checkpoint` with which another process can continue the render."""
        return Checkpoint.of(self.state, self.target.elapsed, self.finished)
