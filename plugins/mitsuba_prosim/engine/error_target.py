"""The error target of an image: when a render stops, how the error of the image is measured, and how many samples the
next pass over the image takes.
"""

from __future__ import annotations

import itertools
import math
import time
from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from .image import Image, display_variance
from .plan import UNLIMITED

#: Maximum duration of a work item with a time limit: this fraction of the time that is left, or this many seconds.
SHARE, SHORTEST = 0.25, 0.01
#: The time is up when this fraction of the time limit is left.
REST = 0.01

#: Maximum ratio of the samples after a pass to the samples before. A greater ratio is unsafe, because few samples
#: estimate the error badly.
GROWTH = 4
#: Maximum ratio of the samples after a pass to the samples before, if the error estimate is uncertain: the estimate
#: may be too large.
UNCERTAIN_GROWTH = 1.4

#: Ratio of the error to the target at which a pass aims. A pass that misses the target costs another pass.
AIM = 0.96

#: Exponent of the power law by which more samples reduce the error. Sobol' points are better than independent samples,
#: whose exponent is 1/2. A pass that falls short is followed by another pass; a pass that takes too many samples wastes
#: them.
RATE = 0.65

#: Minimum ratio of the upper bound of the error to the error for an error that is uncertain because few pixels have
#: most of it.
UNCERTAIN = 1.2

#: A photon pass is used if enough samples gather its photons. Enough is the number of its photons, or the number of
#: pixels times its photon maps if that is less, divided by SPARSE.
SPARSE = 2

#: The size of a pass is decided by about this number of pixels, or by all of a smaller image.
SOME = 1 << 14


@dataclass
class ErrorTarget:
    """The target at which a render ends: limits of the error and of the time.

    ``limits`` are two upper limits: of the RMS error of the displayed image (white = 1), and of the errors of 99 % of
    the pixels; 0 stands for no limit. The render ends when both errors are within ``limits``, or after ``seconds``
    seconds; if ``seconds`` is 0, the time is not limited.
    """

    limits: tuple[float, float]
    seconds: float
    started: float
    #: Seconds at the end in which no samples are taken, because the denoiser needs them.
    reserved: float = 0.0
    #: Seconds in which the denoiser was prepared before the render.
    prepared: float = 0.0

    def excess(self, noise: Sequence[float]) -> float:
        """Returns the largest ratio of a measured error in ``noise`` to the limit of this error, at most 1e100.

        The result is NaN without limits, or if the errors are NaN because they were not measured yet. The limit of the
        RMS error holds for its upper bound. If the upper bound is more than :data:`UNCERTAIN` times the RMS error, the
        RMS error itself is compared, because few pixels have most of the error; :attr:`.Reached.uncertain` reports
        this case.
        """
        rms, tail, bound = noise
        rms = bound if bound <= UNCERTAIN * rms else rms
        ratios = [measured / limit for measured, limit in zip((rms, tail), self.limits) if limit]
        return min(max(ratios, default=np.nan), 1e100)  # finite even if an error is infinite

    @property
    def elapsed(self) -> float:
        """Seconds since the beginning of the render."""
        return time.perf_counter() - self.started

    @property
    def seconds_left(self) -> float:
        """Seconds in which the render may take samples before the denoiser must start; infinite without a limit."""
        return self.seconds - self.reserved - self.elapsed if self.seconds else np.inf

    @property
    def time_is_up(self) -> bool:
        """Whether at most the fraction :data:`REST` of the time limit is left."""
        return self.seconds_left <= self.seconds * REST

    def progress(self, done: float) -> float:
        """Returns the progress of the render, 0 to 1: ``done``, or the fraction of the time limit if that is more."""
        by_time = 1 - self.seconds_left / self.seconds if self.seconds else 0.0
        return min(max(done, by_time), 1.0)

    @property
    def item_seconds(self) -> float:
        """Maximum seconds of the next work item: the fraction :data:`SHARE` of the time that is left, but at least
        :data:`SHORTEST`; infinite without a time limit.
        """
        return max(self.seconds_left * SHARE, SHORTEST) if self.seconds else np.inf


def next_counts(state: Image, target: ErrorTarget, sample_ratio: float, speed: float) -> np.ndarray:
    """Returns the total number of samples of each pixel after the next pass: as many as the error target requires, but
    limited to the maximum size of one pass.

    Before the numbers are rounded up to powers of two, their mean is at most :data:`GROWTH` times the present mean, or
    :data:`UNCERTAIN_GROWTH` times if few pixels have most of the error. With a time limit, the pass also takes at most
    about half of the time that is left; 90 % if less than a fifth of the limit is left. ``sample_ratio`` is the ratio
    of the samples after the pass to the samples before; 0 if the measured error decides. ``speed`` is the measured
    speed of the render, in samples per pixel and second; 0 if the speed is not known. With a time limit and an unknown
    speed, the pass at most doubles the mean number of samples.
    """
    have, ratio = mean(state.count), None
    most = (UNCERTAIN_GROWTH if state.noise[2] > UNCERTAIN * state.noise[0] else GROWTH) * have
    if target.seconds:
        share = 0.9 if target.seconds_left < target.seconds / 5 else 0.5  # the last pass uses the rest of the time
        most = min(most, have + speed * target.seconds_left * share) if speed else 2 * have
    if any(target.limits):
        ratio = sample_ratio or remaining_factor(state, target)
    return counts_for_ratio(state, ratio, most)


def counts_for_ratio(state: Image, ratio: float | None, most: float = np.inf) -> np.ndarray:
    """Returns the number of samples for each pixel with which the error is as small as with ``ratio`` times the current
    samples in every pixel.

    The policy of adaptive sampling distributes the additional samples, so fewer samples suffice than ``ratio`` times
    the current number in every pixel. The returned numbers include the samples that a pixel already has. ``most`` is
    the maximum of the mean number of samples per pixel, before the numbers are rounded up to powers of two. ``ratio``
    is None if only ``most`` limits the numbers of samples. No pixel gets more than the plan's maximum number of
    samples, even if the error is then larger.
    """
    request, count = np.minimum(state.request(), np.float32(UNLIMITED)), state.count
    # All samples of a pixel so far may agree by chance. So every pixel of the region gets samples from time to time.
    # ``region`` is a view of ``request``.
    region = state.crop(request, state.plan.region)
    region += np.float32(mean(region.ravel()) / 20)
    variances, caustics = display_variance(state), state.estimator.transport.caustics
    # Some of the pixels stand for all: ``step`` has no factor in common with the width, so they are in all columns.
    left, _, right, _ = state.outer
    fewest = 1 if caustics is not None else 1 + count.size // SOME
    step = next(step for step in itertools.count(fewest) if math.gcd(step, right - left) == 1)
    # The mean variance of the pixels' means at which the samples suffice; unknown if only the second image met light.
    now = 0.0 if ratio is None else mean(variances[::step] / np.float32(count[::step]))
    goal = now / ratio if ratio is not None and now > 0 else None

    def after(effort: float, step: int = 1) -> np.ndarray:
        """Returns each ``step``-th pixel's number of samples after a pass that is multiplied by ``effort``."""
        counts = state.counts_for(request[::step] * np.float32(effort))
        if caustics is not None:
            plan = state.plan
            limit = limit_by_photons(count, counts, plan.max_samples, caustics.maps(plan.n), caustics.count)
            counts = np.minimum(counts, np.uint32(limit))
        return np.maximum(counts, count[::step])

    def reaches(effort: float) -> bool:
        """Tells whether a pass times ``effort`` reaches the variance ``goal`` (unless None) or the mean ``most``."""
        counts = np.float32(after(effort, step))
        return mean(counts) >= most or (goal is not None and mean(variances[::step] / counts) <= goal)

    return after(smallest_effort(reaches))


def remaining_factor(state: Image, target: ErrorTarget) -> float:
    """Returns the factor by which the samples must increase until the error is :data:`AIM` times the error target.

    The error is assumed to be proportional to the number of samples to the power of -:data:`RATE`. The result is NaN if
    the error has no limit.
    """
    return (target.excess(state.noise) / AIM) ** (1 / RATE)


def limit_by_photons(count: np.ndarray, wanted: np.ndarray, max_samples: int, maps: int, photons: int) -> int:
    """Returns the maximum number of samples that a pixel may have after a pass over the image, so that enough samples
    use the photons of each photon pass.

    A photon pass emits ``photons`` photons, and makes the photon maps for ``maps`` successive samples of each pixel.
    The cost of a photon pass does not depend on the number of samples that use its photons. The last photon passes are
    left out if too few samples would use their photons (:data:`SPARSE`); a later pass over the image takes these
    samples. The result is the number of samples of a pixel that has used all photon maps up to the last remaining
    photon pass, which may exceed all requested counts ``wanted``; 0 if all photon passes are left out. ``count`` is the
    number of samples that each pixel already has. ``max_samples`` is the plan's maximum number of samples of a pixel.
    If the maximum of ``wanted`` is ``max_samples``, or if no pixel needs samples, no photon pass is left out, and the
    result is the maximum of ``wanted``.
    """
    last, lacking = int(wanted.max()), wanted > count
    if last == max_samples or not lacking.any():
        return last  # this is the last pass
    passes = -(-last // maps)
    starts, ends = (np.bincount(counts[lacking], minlength=passes * maps + 1) for counts in (count, wanted))
    # The cumulative sum has, for each t, the number of pixels that take the t-th sample; each row has one photon pass.
    samples = np.cumsum(starts - ends)[: passes * maps].reshape(passes, maps).sum(axis=1)
    enough = np.flatnonzero(samples >= min(photons, count.size * maps) / SPARSE)
    return (int(enough[-1]) + 1) * maps if enough.size else 0


def smallest_effort(reaches: Callable[[float], bool]) -> float:
    """Returns the smallest effort from 2^-20 to 2^40 for which ``reaches(effort)`` is true, within 0.1 %; 2^40 if
    ``reaches`` is always false.

    The effort is the factor by which all requested numbers of samples are multiplied. If ``reaches`` is true for an
    effort, it must be true for every greater effort.
    """
    exponents = np.linspace(-20, 40, 2**16 + 1)
    return float(2 ** exponents[bisect_left(exponents[:-1], True, key=lambda exponent: reaches(2**exponent))])


def mean(values: np.ndarray) -> float:
    """Returns the mean, computed with 64 bits."""
    return float(np.mean(values, dtype=np.float64))
