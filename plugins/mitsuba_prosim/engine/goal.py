"""The goals of a render: which samples an image takes next, and when it has enough of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from .error_target import GROWTH, ErrorTarget, mean, next_counts, remaining_factor
from .image import Image, Noise, SecondImage
from .plan import UNLIMITED, area


class Pass(NamedTuple):
    """A pass over an image or both: samples by ``plan`` until each pixel has ``wanted`` samples or has converged.

    ``wanted`` has the pixels of the image first, and perhaps those of its second image.
    """

    wanted: np.ndarray
    #: Estimated number of samples of all these pixels together at the end of the image; if the number is 0, the samples
    #: of this pass do not count as progress.
    expected: float = 0.0


class Measurement(NamedTuple):
    """The error of an image, and what follows from it."""

    noise: Noise
    #: Ratio of the samples after the next pass to the samples before; 0 if the measured error decides.
    sample_ratio: float = 0.0
    #: Whether the error can only be measured with a complete second image.
    needs_complete: bool = False
    #: Estimates of the error of the denoised image that are new, see :attr:`.Image.estimates`.
    estimates: Sequence[Sequence[Any]] = ()


#: Measures the error of an image that has a second image. The target tells which error is wanted.
Measure: TypeAlias = Callable[[Image, SecondImage, ErrorTarget], Measurement]


class PolicyGoal:
    """Ends a render after the decisions of the adaptive-sampling policy, or when it requests no more samples.

    A goal decides which samples an image takes next: ``next`` returns the next pass, or None if the image has enough
    samples or if the time is up. ``measure`` takes note that a pass is complete, and returns whether the image and its
    error may now be shown.
    """

    #: Number of samples of an image up to which the samples before the first decision are one pass.
    LONG = 1 << 22

    def __init__(self, target: ErrorTarget) -> None:
        self.target = target
        self._first: Iterator[Pass] | None = None

    def next(self, image: Image) -> Pass | None:
        """Returns the first passes, and then a pass for each decision of the policy."""
        if image.finished:
            return None
        plan, policy, most = image.plan, image.policy, image.most_samples
        if image.rounds == 0:
            self._first = self._first or self._first_passes(image)
            if (request := next(self._first, None)) is not None:
                return request
        if image.wanted is None:
            if image.rounds >= policy.rounds or policy.first_samples == plan.max_samples:
                return None
            # The next decisions use neighbouring pixels. The neighbours of a part of an image must have the same
            # samples as in the whole image. Each decision that is left needs a margin of ``policy.reach``.
            left = policy.rounds - image.rounds - 1
            wanted = image.counts_for(image.request(left * policy.reach))
            if left and policy.unbounded:  # few samples give unreliable estimates
                wanted = np.minimum(wanted, np.maximum(GROWTH * image.count, plan.n**2))
            wanted = image.counts_of_part(wanted, left * policy.reach)
            if not np.any(wanted > image.count):
                return None
            image.begin_round(wanted)
        assert image.wanted is not None
        expected = most if image.rounds < policy.rounds else float(image.wanted.sum(dtype=np.int64))
        return Pass(image.wanted, expected)

    def _first_passes(self, image: Image) -> Iterator[Pass]:
        """Yields the passes before the first decision; several if there are many samples, to show an image early."""
        numbers = [image.policy.first_samples]
        while numbers[0] * area(image.outer) > self.LONG and numbers[0] > 1:
            numbers.insert(0, -(-numbers[0] // GROWTH**2))
        for number in numbers:
            yield Pass(image.one * np.uint32(number), image.most_samples)

    def measure(self, image: Image) -> bool:
        """Returns True: the image may be shown after each pass."""
        return True


class ErrorGoal:
    """Ends a render when the error is within its limits, when the time is up, or when each pixel has the plan's maximum
    number of samples.

    In each pass, the number of samples of a pixel is the number that the policy requests, times a factor that depends
    on the limits. The second image takes as many samples as the first image. After each pass, ``measure`` measures the
    error. If a checkpoint was made during a pass, the render first completes this pass.
    """

    def __init__(self, target: ErrorTarget, measure: Measure) -> None:
        self.target, self._measure, self._ratio = target, measure, 0.0
        self._first: Iterator[Pass] | None = None
        #: The current pass, None after its end.
        self._pass: Pass | None = None
        #: Samples per pixel and second, None before the first measurement; samples per pixel at the beginning of the
        #: current pass, and its time.
        self._speed: float | None = None
        self._begun: tuple[float, float] | None = None

    def next(self, image: Image) -> Pass | None:
        """Returns the first passes, and then a pass for each measurement of the error."""
        if image.finished or self._pass is not None:  # a pass that has not ended: the time is up
            return None
        if image.rounds == 0:
            self._first = self._first or self._first_passes(image)
            self._pass = next(self._first, None)
            if self._pass is not None:
                return self._pass
            if image.policy.first_samples == image.plan.max_samples and not any(self.target.limits):
                return None
            image.begin_round(None)
        self._pass = self._next(image)
        return self._pass

    def _first_passes(self, image: Image) -> Iterator[Pass]:
        """Yields the passes before the first decision of the policy."""
        if self.target.seconds:  # shows an image after one sample per pixel
            yield Pass(image.one)
        yield both(image, image.one * np.uint32(image.policy.first_samples), image.plan.max_samples)

    def _next(self, image: Image) -> Pass | None:
        """Returns the next pass after the first passes."""
        count = image.count
        if image.wanted is None:
            if image.second is not None and image.second.lags(image):
                return second_pass(image, image.second)
            if self.target.time_is_up or self.target.excess(image.noise) <= 1:
                return None
            wanted = next_counts(image, self.target, self._ratio, self._samples_per_second(image))
            if not np.any(wanted > count):
                return None
            image.begin_round(wanted, 1)
        assert image.wanted is not None
        have, expected = mean(count), np.inf
        self._begun = have, time.perf_counter()
        if any(self.target.limits):
            needed = max(have * remaining_factor(image, self.target), mean(image.wanted))
            expected = min(needed, image.plan.max_samples)
        return both(image, image.wanted, expected)

    def _samples_per_second(self, image: Image) -> float:
        """Returns the measured speed of the render, in samples per pixel and second; 0 if it is not known.

        After the first pass alone the speed is not known, because the first pass also compiles kernels.
        """
        if self._speed is None:
            have = mean(image.counts)
            self._speed = have / self.target.elapsed if have > image.plan.min_samples else 0.0
        return self._speed

    def measure(self, image: Image) -> bool:
        """Measures the error; returns False if it is unknown, because the second image has fewer samples."""
        self._pass, second = None, image.second
        if second is not None:
            if second.lags(image):
                return image.rounds == 0
            measured = self._measure(image, second, self.target)
            image.record(measured.noise, measured.estimates)
            self._ratio = measured.sample_ratio
            if measured.needs_complete:
                image.begin_second(complete=True)
                return False
        if self._begun is not None:
            have, started = self._begun
            if (more := mean(image.counts) - have) > 0:
                self._speed = more / max(time.perf_counter() - started, 1e-9)
        return True


class HalvesGoal:
    """Ends a render with two complete images for the denoiser, unless the image has reached an error target before."""

    def __init__(self, goal: PolicyGoal | ErrorGoal) -> None:
        self.target, self._goal = goal.target, goal
        self._last: Iterator[Pass] | None = None

    def next(self, image: Image) -> Pass | None:
        """Returns the next pass of the inner goal, and then the passes that complete the second image."""
        if self._last is None:
            if (request := self._goal.next(image)) is not None:
                return request
            if self.target.excess(image.noise) <= 1:
                return None
            second = image.second
            if second is not None and not second.complete and not image.finished and not self.target.time_is_up:
                image.begin_second(complete=True)  # each pixel has the maximum number of samples
                return self._goal.next(image)
            self._last = self._last_passes(image)
        return next(self._last, None)

    def _last_passes(self, image: Image) -> Iterator[Pass]:
        """Yields the passes that complete the second image, and then measures the error."""
        second = image.begin_second(complete=True)  # a complete second image that has begun continues
        yield second_pass(image, second, 1)  # the time limit cannot end this pass: each pixel gets a sample
        yield second_pass(image, second)
        if any(self.target.limits):
            image.record(second.noise(image))

    def measure(self, image: Image) -> bool:
        """Measures the error by the inner goal."""
        return self._last is not None or self._goal.measure(image)


#: Decides which samples an image takes next, and when it has enough of them.
Goal: TypeAlias = "PolicyGoal | ErrorGoal | HalvesGoal"


def second_pass(image: Image, second: SecondImage, most: int = UNLIMITED) -> Pass:
    """Returns a pass that gives each pixel of ``second`` as many samples as in ``image``, but at most ``most``."""
    count = image.count
    return Pass(np.concatenate([count, np.minimum(count[second.index], np.uint32(most))]))


def both(image: Image, wanted: np.ndarray, expected: float) -> Pass:
    """Returns a pass in which each pixel of ``image``, and of its second image, gets ``wanted`` samples; at the end of
    the image, a pixel has about ``expected`` samples.
    """
    if image.second is not None:
        wanted = np.concatenate([wanted, wanted[image.second.index]])
    return Pass(wanted, expected * len(wanted))


def raw_error(image: Image, second: SecondImage, target: ErrorTarget) -> Measurement:
    """Measures the error of the image without denoising."""
    return Measurement(second.noise(image))


def goal_of(image: Image, target: ErrorTarget, measure: Measure | None) -> Goal:
    """Returns the goal of a render of ``image``, and begins the second image if its error must be measured.

    ``measure`` measures the error of the denoised image; None without a denoiser. A denoiser needs a complete second
    image. It is complete from the beginning if the time is limited (and the error is not reached yet), if the image is
    small, or if the checkpoint has a complete second image.
    """
    if any(target.limits) or (measure is not None and target.seconds):
        small = area(image.plan.region) < 4 * SecondImage.MIN_PIXELS
        early = bool(target.seconds) and not target.excess(image.noise) <= 1
        image.begin_second((early or small or image.has_complete_second) and measure is not None)
    goal = ErrorGoal(target, measure or raw_error) if image.plan.sampling.has_target else PolicyGoal(target)
    return goal if measure is None else HalvesGoal(goal)
