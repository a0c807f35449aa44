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

    If a render has an error target but no time limit, a large image gets the same first samples as without a denoiser.
    If the image without denoising (the raw image) reaches the error target, the render ends, and the raw image is the
    result. If the raw image still needs many samples to reach the error target, a second image takes the other half of
    the samples. To measure the error, the denoiser is first called when the error of the raw image is at most ``FAR``
    times the error target. After the first call of the denoiser, the estimated error of the denoised image decides how
    many samples the next pass takes. Without a time limit, the number of samples depends neither on measured times nor
    on the last bits of the denoiser's output, which differ with the number of threads.

    To measure the error, the denoiser first uses its smallest neural networks without albedo and normals ("plain"),
    which cost little time. If the image needs many samples even with the networks "plain", the denoiser changes to its
    best networks, unless they are excluded.
    """

    #: Maximum ratio of the raw image's error to the target at which the denoiser is first called. A smaller value would
    #: make images too good whose error the denoiser reduces to a fifth.
    FAR = 3.5
    #: Ratio of the error to its limit at which a pass aims before the denoiser is called, because another pass or
    #: another call costs more than some samples.
    CLOSE = 0.93
    #: Maximum number of calls of the denoiser that estimate the error.
    CALLS = 5
    #: Cost of a call of the denoiser with the smallest networks, in rays per pixel.
    CALL_COST = 48
    #: In multiples of the cost of a call: the minimum number of samples that the raw image lacks when the second half
    #: begins; the minimum number of samples before the first call; the minimum number of samples that the denoiser must
    #: save after a call; and the minimum number of samples of the image for which the best networks are worth their
    #: time.
    BEGIN, FIRST, SAVED, BEST = 6, 3, {"plain": 2, "best": 6}, 32

    def __init__(self, denoiser: HalvesDenoiser) -> None:
        self.denoiser = denoiser

    def __call__(self, image: Image, second: SecondImage, target: ErrorTarget) -> Measurement:
        """Returns the error of the final image, and what the render needs next.

        If the denoiser is not called, the error is extrapolated from the denoiser's last call, or is the error of the
        raw image.
        """
        raw, samples = second.noise(), mean(image.all_counts())
        if not target.excess(raw) > 1:  # the excess is NaN without limits
            return Measurement(raw)
        return (self._with_both if second.complete else self._with_part)(image, target, raw, samples)

    def networks(self, estimates: Sequence[Sequence[Any]], samples: float) -> str:
        """Returns the kind of the networks for an image with ``samples`` samples per pixel: "plain", "fast" or "best".

        If no samples were added since the last of the ``estimates`` of the error, the networks of this estimate are
        used, because the estimate is valid for these networks only.
        """
        if estimates and estimates[-1][0] == samples:
            return str(estimates[-1][1])
        return "fast" if self.denoiser.fast else "best"

    def _with_part(self, image: Image, target: ErrorTarget, raw: Noise, samples: float) -> Measurement:
        """Measures the error with a second image of some pixels, by which the denoiser cannot be called."""
        # A complete second half doubles the samples, which is not worth while for an image that needs few samples.
        factor, least = (
            (target.excess(raw) / AIM) ** (1 / RATE),
            2 * samples + self.BEGIN * self.CALL_COST / image.estimator.transport.rays_per_sample,
        )
        return Measurement(raw, needs_complete=samples * factor >= least and needed(image, factor) >= least)

    def _with_both(self, image: Image, target: ErrorTarget, raw: Noise, samples: float) -> Measurement:
        """Measures the error with two complete images."""
        # ``cost`` is the cost of a call of the denoiser. Below, ``by_raw`` and ``by_final`` are the counts at which the
        # raw and the final image reach the target. All three are samples per pixel.
        excess, cost = target.excess(raw), self.CALL_COST / image.estimator.transport.rays_per_sample
        if not image.estimates and (excess > self.FAR or samples < self.FIRST * cost):
            by_error = (excess / (self.CLOSE * self.FAR)) ** (1 / RATE)
            return Measurement(raw, max(by_error, self.FIRST * cost / samples))
        by_raw = needed(image, (excess / AIM) ** (1 / RATE))
        called = list[Sequence[Any]]()
        networks = image.estimates[-1][1] if image.estimates else "plain"
        # Calls the denoiser at most twice: with the networks so far, and after the first call perhaps with the best.
        while True:
            if estimates := [*image.estimates, *called]:
                last, _, ratio = estimates[-1]  # the samples and the ratio of the errors at the last call
                noise = scaled(raw, ratio * (samples / last) ** RATIO_RATE)
                excess = target.excess(noise)
                by_final = needed(image, (excess / AIM) ** (1 / (RATE - RATIO_RATE)))
                if last == samples and excess <= 1:
                    return Measurement(noise, estimates=called)
                saves = by_raw - by_final >= self.SAVED[networks] * cost
                if len(estimates) == 1 and min(by_raw, by_final) > self.BEST * cost and not self.denoiser.fast:
                    networks = "best"
                elif not saves or len(estimates) >= self.CALLS:  # the denoiser saves too few samples
                    return Measurement(raw, estimates=called)
                elif last == samples or excess > 1:  # more samples are needed before the next call
                    more = (excess / self.CLOSE) ** (1 / (RATE - RATIO_RATE))
                    return Measurement(noise, more, estimates=called)
            result = self.denoiser(image.halves, networks, samples)
            # Rounded, because the bits of a denoised image depend on the number of threads.
            called.append((samples, networks, float(f"{result.at_most / BOUND / result.raw_noise:.3g}")))


def needed(image: Image, ratio: float) -> float:
    """Returns the mean number of samples per pixel with which the error is as small as with ``ratio`` times the current
    samples in every pixel.

    The policy of adaptive sampling distributes the samples. If the second image is complete, the result counts the
    samples of both images. The result is infinite if all pixels would need the maximum number of samples of a pixel,
    which may not suffice.
    """
    counts = image.crop(counts_for_ratio(image, ratio), image.plan.region)
    if counts.min() == image.plan.max_samples:
        return float("inf")
    return mean(counts) * (2 if image.second is not None and image.second.complete else 1)


def scaled(noise: Sequence[float], factor: float) -> Noise:
    """Returns the four errors of the measurement ``noise`` (:data:`.Noise`), each multiplied by ``factor``."""
    return noise[0] * factor, noise[1] * factor, noise[2] * factor, noise[3] * factor
