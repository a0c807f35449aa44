"""Measures the error of the final image during a render, which decides how many samples the image gets."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..engine.error_target import AIM, ErrorTarget, counts_for_ratio, mean
from ..engine.goal import Measurement
from ..engine.image import Image, Noise, SecondImage
from .halves import HalvesDenoiser

#: Exponents of two power laws, means of several scenes. More samples reduce the error of the raw image, and increase
#: the ratio of the error of the denoised image to the error of the raw image.
RATE, RATIO_RATE = 0.68, 0.1

#: With a probability of about 95 %, the error of the final image is at most this many times the limit.
TOLERANCE = 1.1

#: A render ends when the upper bound of the error of the final image is at most this many times the limit. A value of
#: :data:`TOLERANCE` would miss some images whose two halves have an error in common.
BOUND = 1.05


class FinalError:
    """Measures the error of the final image, which ``denoiser`` makes from two images with half of the samples each.

    A large image gets the same first samples as without a denoiser. If this raw image reaches the error target, it is
    the result. If it still needs many samples, a second image takes the other half of them, and the denoiser is called.
    The estimated error of the denoised image then decides how many samples the next pass takes; between two calls it is
    extrapolated. Neither measured times nor the last bits of the denoiser's output, which differ with the number of
    threads, change the number of samples.
    """

    #: Maximum ratio of the raw image's error to the target at which the denoiser is first called. A smaller value would
    #: make images too good whose error the denoiser reduces to a fifth.
    FAR = 3.5
    #: Ratio of the error to its limit at which a pass aims before the denoiser is called, because another pass or
    #: another call costs more than some samples.
    CLOSE = 0.93
    #: Maximum number of calls of the denoiser, and cost of a call in rays per pixel. The denoiser must save that many.
    CALLS, CALL_COST = 5, 140

    def __init__(self, denoiser: HalvesDenoiser) -> None:
        self.denoiser = denoiser

    def __call__(self, image: Image, second: SecondImage, target: ErrorTarget) -> Measurement:
        """Returns the error of the final image, and what the render needs next; without a call of the denoiser, the
        error is extrapolated from the last call, or is that of the raw image.
        """
        raw, samples = second.noise(image), mean(image.all_counts())
        excess, cost = target.excess(raw), self.CALL_COST / image.estimator.transport.rays_per_sample
        if not excess > 1:  # the excess is NaN without limits
            return Measurement(raw)
        if second.complete:
            return self._with_both(image, target, raw, cost)
        # A complete second half doubles the samples, which is not worth while for an image that needs few samples.
        factor, least = (excess / AIM) ** (1 / RATE), 2 * (samples + cost)
        return Measurement(raw, needs_complete=samples * factor >= least and needed(image, factor) >= least)

    def _with_both(self, image: Image, target: ErrorTarget, raw: Noise, cost: float) -> Measurement:
        """``cost`` is that of a call of the denoiser, in samples per pixel."""
        excess, samples, rate = target.excess(raw), mean(image.all_counts()), RATE - RATIO_RATE
        if not image.estimates and (excess > self.FAR or samples < cost):
            return Measurement(raw, max((excess / (self.CLOSE * self.FAR)) ** (1 / RATE), cost / samples))
        by_raw, called = needed(image, (excess / AIM) ** (1 / RATE)), list[Sequence[Any]]()
        while True:
            if estimates := [*image.estimates, *called]:
                last, ratio = estimates[-1]  # the samples and the ratio of the errors at the last call
                noise = scaled(raw, ratio * (samples / last) ** RATIO_RATE)
                excess = target.excess(noise)
                if last == samples and excess <= 1:
                    return Measurement(noise, estimates=called)
                if by_raw - needed(image, (excess / AIM) ** (1 / rate)) < cost or len(estimates) >= self.CALLS:
                    return Measurement(raw, estimates=called)  # the denoiser saves too few samples
                if last == samples or excess > 1:  # more samples are needed before the next call
                    return Measurement(noise, (excess / self.CLOSE) ** (1 / rate), estimates=called)
            result = self.denoiser(image.halves, samples, image.estimator.transport.rays_per_sample)
            # Rounded, because the bits of a denoised image depend on the number of threads.
            ratio = float(f"{result.at_most / BOUND / result.raw_noise:.3g}")
            called.append((samples, ratio))


def needed(image: Image, ratio: float) -> float:
    """Returns the mean number of samples per pixel, distributed by the policy, with which the error is as small as with
    ``ratio`` times the current samples in every pixel.

    Samples of a complete second image count. The result is infinite if all pixels would need the maximum number of
    samples of a pixel, which may not suffice.
    """
    counts = image.crop(counts_for_ratio(image, ratio), image.plan.region)
    if counts.min() == image.plan.max_samples:
        return float("inf")
    return mean(counts) * (2 if image.second is not None and image.second.complete else 1)


def scaled(noise: Sequence[float], factor: float) -> Noise:
    """Returns the three errors ``noise`` (:data:`.Noise`), each multiplied by ``factor``."""
    return noise[0] * factor, noise[1] * factor, noise[2] * factor
