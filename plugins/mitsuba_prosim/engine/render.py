"""A progressive render: an iterator over the work items of an image, which the caller may stop after any work item."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator
from contextlib import closing, suppress
from typing import TYPE_CHECKING, NamedTuple

import mitsuba as mi
import numpy as np

from ..alone import alone
from ..compat import exposed
from .error_target import UNCERTAIN, ErrorTarget, mean
from .estimator import Estimator
from .goal import Measure, Pass, goal_of
from .image import Image, SecondImage, concentration
from .plan import Plan, area
from .policies import mean_around
from .standard_error import in_display_units
from .tiles import Part
from .tiny_lamps import lights_off, samples_for_tiny_lamps
from .work import Executor, Step, Steps, batches, lacking, work_items

if TYPE_CHECKING:
    from .checkpoint import Checkpoint

#: Minimum number of samples per pixel, and maximum relative deviation, of a bound of the RMS error that is known.
FEW, KNOWN = 8, 0.1
#: What gives NaN values, if their cause is unknown.
UNKNOWN = "a texture, material or lamp gives"


class Reached(NamedTuple):
    """Number of samples, error and elapsed time of the image so far."""

    #: Mean and minimum number of samples of a pixel.
    samples: float
    min_samples: int
    #: RMS error of the displayed image (white = 1), and the bound of the errors of 99 % of the pixels.
    #: The values are NaN without a limit of noise, because the errors were not measured.
    noise: float
    noise_99: float
    #: Upper bound of the RMS error, which exceeds the bound with a probability of about 5 %.
    noise_at_most: float
    #: Whether rays may miss a lamp, see :func:`.samples_for_tiny_lamps`.
    tiny_lamp: bool
    #: Seconds since the beginning of the render.
    seconds: float

    @property
    def uncertain(self) -> bool:
        """Whether the RMS error is uncertain, because few pixels have most of the error or rays may miss a lamp."""
        return self.tiny_lamp or self.noise_at_most > UNCERTAIN * self.noise


def check_size(plan: Plan, estimator: Estimator, halves: int) -> None:
    """Raises ValueError if the sums of the pixels of ``halves`` images exceed the size of a Dr.Jit array."""
    # A twentieth is left for the pixels around the image that decide, and for those of a second image that measures.
    left, top, right, bottom = plan.window
    most = 0.95 * 2**32 / estimator.sums_per_pixel / halves
    if area(plan.region) > most:
        raise ValueError(
            f"{right - left} x {bottom - top} pixels are too many for one image: with this filter and these channels, "
            f"it can have {most / 1e6:.3g} million; render crops of the film, or take a box filter or fewer channels"
        )


class Render(Steps):
    """A progressive render of the image ``plan``, or of the ``part`` of this image: an iterator over :class:`Step`
    objects.

    The methods of this class may be called between two steps of the iteration. After the end of the render or a call of
    :meth:`close`, the film holds the image so far. To cancel a render, leave the loop over its steps and call
    :meth:`close`. If the render has started, :meth:`close` takes the first sample of each pixel that has no sample.
    ``estimator`` takes the samples. ``executor`` computes the work items; the default executor computes them in this
    process. ``begin`` is a checkpoint from which the render continues.

    ``measure`` measures the error of the denoised image, see :func:`.goal_of`; None without a denoiser.

    Raises ValueError if the checkpoint ``begin`` belongs to another image, or cannot be continued with the policy of
    ``plan`` (:meth:`.Checkpoint.restore`), and if the image has too many pixels (:func:`check_size`).
    """

    def __init__(
        self,
        plan: Plan,
        estimator: Estimator,
        executor: Executor | None = None,
        begin: Checkpoint | None = None,
        part: Part | None = None,
        measure: Measure | None = None,
    ) -> None:
        check_size(plan, estimator, halves=1 if measure is None else 2)
        self.state = Image(plan, estimator, part if begin is None else begin.part)
        self.executor = executor or Executor()
        elapsed = 0.0 if begin is None else begin.attributes["seconds"]
        self.target = ErrorTarget(plan.sampling.noises, plan.sampling.time, time.perf_counter() - elapsed)
        self.state.finished = begin is not None and begin.restore(self.state)
        self.goal = goal_of(self.state, self.target, measure)
        #: Whether :meth:`stop` was called; whether the last pass came to its end; the progress, 0 to 1.
        self._stopped, self._complete, self._done = False, True, 0.0
        tree = getattr(getattr(estimator.transport, "settings", None), "follows_tree", False)
        by_chance = estimator.transport.caustics is None and not tree
        self._for_tiny_lamps, self.tiny_lamp = samples_for_tiny_lamps(estimator.scene, estimator.sensor, by_chance)
        super().__init__(self._run())

    # ---------------------------------------------------------------- as an iterator

    def stop(self) -> None:
        """Ends the render after the current work item; any thread may call this method."""
        self._stopped = True

    def close(self) -> None:
        """Ends the render. If any pixel has a sample, the others get their first, so that no pixel is missing."""
        self.stop()
        self.run()

    def _run(self) -> Generator[Step, None, None]:
        """Takes the samples of all passes over the image, yields the steps, and then writes the image to the film.

        If an error or Ctrl-C ends the render, the image so far is written to the film, and the error is raised again.
        """
        image = self.state
        try:
            while not self._stopped and (request := self.goal.next(image)) is not None:
                yield from self._take(request)
                complete = self._complete
                if complete:
                    image.wanted = None
                elif image.rounds == 0 and np.any(image.count):
                    # In the first pass, pixels without samples get one sample, so that no pixel is missing.
                    yield from self._take(Pass(image.one))
                if (not complete or self.goal.measure(image)) and np.all(image.counts > 0):
                    yield Step(self._done, True)
            image.finished = not self._stopped and (self._complete or self.target.time_is_up)
            if image.finished and self._done < 1:
                yield Step(1.0, True)
        except (Exception, KeyboardInterrupt):
            with suppress(Exception):  # a second error would hide the first one
                self.update_film()
            raise
        self.update_film()
        if self.lost:
            mi.Log(mi.LogLevel.Warn, f"{self.lost}.")

    def _take(self, request: Pass) -> Iterator[Step]:
        """Takes the samples of a pass, and yields a step after each work item."""
        image, (wanted, expected) = self.state, request
        # Number of samples that the batch lacks, and number that it has taken. The pass is complete if both agree in
        # the last batch.
        missing, taken, several = 0, 0, bool(np.any(wanted > 1))
        for by, batch in batches(image, wanted):
            have, taken = int(np.array(image.accumulators.count)[: len(wanted)].sum(dtype=np.int64)), 0
            missing = int(lacking(image, batch).sum())
            # The time limit cannot end a pass that takes the first samples, so it does not make its items small either.
            items = work_items(image, by, batch, self.executor, lambda: self.target.item_seconds if several else np.inf)
            with closing(self.executor(items)) as results:
                for item in results if not self._must_end(several) else ():
                    if item is not None:
                        taken += item.samples
                        self._done = self.target.progress((have + taken) / expected if expected else self._done)
                    yield Step(self._done, False)
                    if taken < missing and self._must_end(several):
                        break
        self._complete = taken == missing

    def _must_end(self, several: bool) -> bool:
        """Tells whether the current pass, in which pixels get ``several`` samples or only the first, must end now.

        A pass ends early if :meth:`stop` was called or if the time limit is reached. The time limit does not end a pass
        that takes only the first sample of each pixel. :meth:`stop` does not end a pass that follows an incomplete
        pass, because this pass takes the first samples of pixels without samples.
        """
        return bool((self._complete and self._stopped) or (several and self.target.time_is_up))

    @property
    def finished(self) -> bool:
        """Whether the image has all requested samples."""
        return self.state.finished

    @property
    @alone()
    def lost(self) -> str:
        """How many samples so far are infinite or NaN, in words; empty if none is."""
        lost = self.state.all_counts(lost=True)
        if not lost.any():
            return ""
        y, x = np.unravel_index(np.argmax(lost), lost.shape)
        params, wrong = exposed(self.state.estimator.scene), list[str]()
        for name in params.keys():  # noqa: SIM118 (a SceneParameters iterates over other things)
            with suppress(TypeError, ValueError):  # a parameter that is no number
                if not np.all(np.isfinite(np.array(params[name], np.float64))):
                    wrong.append(name)
        off = lights_off(self.state.estimator.scene, endless=True)
        cause = f"{', '.join(wrong[:3])} has" if wrong else f"{off[0]}, which gives" if off else UNKNOWN
        return (
            f"{lost.sum():,} of {self.counts().sum():,} samples are infinite or NaN, and count as black, most of them "
            f"in the pixel {x},{y}: {cause} such values"
        )

    @property
    def second(self) -> SecondImage | None:
        """The second image; None if the error is not measured."""
        return self.state.second

    # ---------------------------------------------------------------- the image so far

    def update_film(self, second: bool = False) -> None:
        """Writes the image so far to the film.

        If ``second`` is true and the render has a second image (:class:`.SecondImage`), writes the second image instead
        of the first to the film; the second image must be complete.
        """
        self.state.update_film(second)

    def image(self, second: bool = False) -> mi.TensorXf:
        """Returns the developed image so far, shape (height, width, channels).

        If ``second`` is true and the render has a second image (:class:`.SecondImage`), returns the second image
        instead of the first; the second image must be complete. The film holds the returned image afterwards.
        """
        return self.state.developed(second)

    def half_images(self) -> list[np.ndarray]:
        """Returns a list of one or two images of shape (height, width, channels), see :meth:`.Image.halves`."""
        return self.state.halves()

    @property
    @alone()
    def reached(self) -> Reached:
        """Samples, error and time so far; the error is that of the last measurement."""
        counts = self.counts()
        tiny_lamp = bool(counts.sum() < self._for_tiny_lamps)
        return Reached(mean(counts), int(counts.min()), *self.state.noise, tiny_lamp, self.target.elapsed)

    @alone()
    def error(self) -> np.ndarray:
        """Returns the standard error of the luminance of each pixel of the first image, estimated from the samples
        within the pixel, shape (height, width). The error is NaN for a pixel without samples.
        """
        return self.state.crop(self.state.error(), self.state.plan.window)

    def counts(self) -> np.ndarray:
        """Returns the number of samples of each pixel, with those of a complete second image; shape (height, width)."""
        return self.state.all_counts()

    @alone()
    def noise_bound(self) -> float:
        """Returns an upper bound of the RMS error of the displayed image (white = 1).

        The bound is estimated from the samples within each pixel (:meth:`.PixelSet.error`), as if these samples, or
        the passes, were independent. The samples are better distributed than independent samples, so the actual error
        is smaller than the bound; only a second image can measure the actual error. The bound is NaN
        where it would be a guess: if a pixel has fewer than two samples, if there are fewer than :data:`FEW` per pixel,
        or if few pixels have most of the error, because then other pixels may have missed as much light.
        """
        state = self.state
        total, _, count = state.statistics()
        with np.errstate(all="ignore"):  # NaN without samples
            # The mean of a pixel that a rare bright sample has met is too large, and the slope there too small.
            mean_of_pixel = state.crop(total / count, state.plan.region)
            mean_there = np.minimum(mean_of_pixel, mean_around(mean_of_pixel, 2))
            values = in_display_units(np.float64(state.crop(state.error(), state.plan.region)), mean_there)
            deviation = 0.5 * concentration(values**2) ** 0.5  # of the RMS, relative
        # The reconstruction filter multiplies the variance by the sum of its squared weights.
        result = float(np.sqrt(np.mean(values**2)) * np.linalg.norm(state.estimator.shares()))
        known = state.counts.min() > 1 and mean(state.counts) >= FEW and np.isfinite(result) and deviation <= KNOWN
        return result * (1 + 1.645 * deviation) if known else float("nan")

    @alone()
    def checkpoint(self) -> Checkpoint:
        """Returns the :class:`.Checkpoint` with which another process can continue the render. Raises RuntimeError
        while another variant is active, which the checkpoint would name.
        """
        from .checkpoint import Checkpoint  # imports modules that an image does not need

        self.check_variant()
        return Checkpoint.of(self.state, self.target.elapsed, self.finished)
