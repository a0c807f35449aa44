"""The error target of an image: when a render stops, how the error of the image is measured, and how many samples the
next pass over the image takes.
"""

from __future__ import annotations

import time
from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np

from ..alone import alone
from ..compat import denormals_rounded, double, dr_array
from ..sampling.hash import hash32
from .accumulators import Accumulators, FilmState
from .error import displayed, in_display_units, variance
from .film import film_values
from .plan import UNLIMITED, area, pixels_around

#: Duration of a work item with a time limit: this fraction of the limit, within these bounds in seconds.
SHARE, SHORTEST, LONGEST = 0.01, 0.01, 0.5

#: Maximum ratio of the samples after a pass to the samples before. A greater ratio is unsafe, because few samples
#: estimate the error badly.
GROWTH = 4
#: Maximum ratio of the samples after a pass to the samples before, if the error estimate is uncertain: the estimate
#: may be too large.
UNCERTAIN_GROWTH = 1.4

#: Ratio of the error to the target at which a pass aims. A ratio of 1 would often be missed.
AIM = 0.98

#: Exponent of the power law by which more samples reduce the error. Sobol' points are better than independent samples,
#: whose exponent is 1/2. A pass that falls short is followed by another pass; a pass that takes too many samples wastes
#: them.
RATE = 0.8

#: Maximum ratio of the upper bound of the error to the target. With this ratio, at most 5 % of the images have more
#: than 1.05 times the target: a render is measured after each pass, and ends at the first small error. Minimum ratio of
#: the bound to the error for an error that is uncertain because few pixels have most of the error.
TOLERANCE, UNCERTAIN = 0.98, 1.2

#: A photon pass is used if enough samples gather its photons. Enough is the number of its photons, or the number of
#: pixels times its photon maps if that is less, divided by SPARSE.
SPARSE = 2

#: RMS error of the displayed image (white = 1), the bounds of 99 and of 99.9 % of its pixels, and the upper bound of
#: the RMS error, which the error exceeds with a probability of about 5 %; NaN while they are not known.
Noise: TypeAlias = "tuple[float, float, float, float]"


@dataclass
class ErrorTarget:
    """The target at which a render ends: limits of the error and of the time.

    ``limits`` are three upper limits: of the RMS error of the displayed image (white = 1), and of the errors of 99 %
    and of 99.9 % of the pixels; 0 stands for no limit. The render ends when all errors are within ``limits``, or after
    ``seconds`` seconds; if ``seconds`` is 0, the time is not limited.
    """

    limits: tuple[float, float, float]
    seconds: float
    started: float
    #: Seconds at the end that the denoiser needs. The denoiser sets this number.
    denoiser_seconds: float = 0.0
    #: Ratio of the samples after the next pass to the samples before; 0 if the measured error decides. The denoiser
    #: sets this ratio.
    sample_ratio: float = 0.0

    def excess(self, noise: Sequence[float]) -> float:
        """Returns the largest ratio of a measured error in ``noise`` to the limit of this error, at most 1e100.

        The result is NaN without limits, or if the errors are NaN because they were not measured yet. The upper bound
        of the RMS error, divided by :data:`TOLERANCE`, is compared with the limit of the RMS error, too. If the upper
        bound is more than :data:`UNCERTAIN` times the RMS error, the bound is ignored, because few pixels have most of
        the error; :attr:`.Reached.uncertain` reports this case.
        """
        rms, *tails, bound = noise
        rms = max(rms, bound / TOLERANCE) if bound <= UNCERTAIN * rms else rms
        ratios = [measured / limit for measured, limit in zip((rms, *tails), self.limits) if limit]
        return min(max(ratios, default=np.nan), 1e100)  # finite even if an error is infinite

    @property
    def elapsed(self) -> float:
        """Seconds since the beginning of the render."""
        return time.perf_counter() - self.started

    @property
    def seconds_left(self) -> float:
        """Remaining seconds in which the render may take samples before the denoiser must start; infinite without a
        time limit.
        """
        return self.seconds - self.denoiser_seconds - self.elapsed if self.seconds else np.inf

    @property
    def time_is_up(self) -> bool:
        """Whether at most the fraction :data:`SHARE` of the time limit is left, about the time of one work item; False
        without a time limit.
        """
        return self.seconds_left <= self.seconds * SHARE

    @property
    def item_seconds(self) -> float:
        """Maximum seconds of a work item: the fraction :data:`SHARE` of the time limit, but at least :data:`SHORTEST`
        and at most :data:`LONGEST`; infinite without a time limit.
        """
        return min(LONGEST, max(self.seconds * SHARE, SHORTEST)) if self.seconds else np.inf


class SecondImage:
    """An independent second image of some or all pixels, from which the error of the first image is estimated.

    The difference between two independent images shows the error of these images, however well the samples are
    distributed. The variance of the samples within a pixel does not show the error of the image: if the samples are
    well distributed, the actual error can be ten times smaller. ``complete`` tells whether the second image was begun
    as a whole image, which has each pixel once; then the final image is the mean of the first and the second image.
    """

    #: One pixel of this many is in the second image, and at least this number of pixels.
    ONE_IN, MIN_PIXELS = 16, 4096
    #: Fewer pixels than this are sampled several times, because their differences could all be small by chance; and the
    #: maximum number of copies of a pixel.
    FEW, MAX_COPIES = 512, 64

    @alone()
    def __init__(self, state: FilmState, complete: bool = False) -> None:
        """Begins a second image for ``state``: of all pixels of the plan's region if ``complete`` is true, else of
        randomly chosen pixels.

        One of :attr:`ONE_IN` pixels is chosen, or more, so that there are at least about :attr:`MIN_PIXELS` pixels; in
        a small image, all pixels are chosen. If fewer than :attr:`FEW` pixels are chosen, each chosen pixel is sampled
        several times with different seeds, but at most :attr:`MAX_COPIES` times. If ``state.second`` already has
        accumulators for this number of pixels, the second image continues from these accumulators.
        """
        self.state, self.estimator, self.complete = state, state.estimator, complete
        #: The rectangle of the pixels of a complete second image, row by row.
        self.outer = state.plan.region
        index, seed = state.crop(np.arange(area(state.outer)), state.plan.region).ravel(), state.plan.seed + 1
        one_in = 1 if complete else max(1, min(self.ONE_IN, len(index) // self.MIN_PIXELS))
        index = index[hash32(hash32(index.astype(np.uint64)) + 1) % one_in == 0]  # a pseudo-random choice
        copies = 1 if complete else min(-(-self.FEW // len(index)), self.MAX_COPIES)
        if copies > 1:
            seed = seed + dr.arange(mi.UInt32, len(index) * copies) // len(index)
            index = np.tile(index, copies)
        self.index, seed = index, hash32(seed)
        state.second_index = index
        self.x, self.y = dr.gather(tuple, (state.x, state.y), dr_array(index.astype(np.uint32)))
        dr.make_opaque(seed, self.x, self.y)
        sampling = replace(state.plan.sampling, adaptive="none")  # the second image takes as many samples as the first
        self.plan = replace(state.plan, seed=seed, photon_seed=int(seed[0]), sampling=sampling)
        if state.second is None or dr.width(state.second.count) != len(index):  # none, or for other pixels
            state.second = Accumulators.empty(self.estimator.sums_per_pixel, len(index))
        #: The sums of the second image: the object ``state.second``, which a checkpoint stores.
        self.accumulators = state.second

    @alone()
    @denormals_rounded()
    def noise(self) -> Noise:
        """Returns the measured error of the displayed image, see :data:`Noise`.

        The displayed image is the first image, or the mean of both images if the second image is complete. For each
        pixel of the second image, the method replaces the samples of this pixel in the first image by those of the
        second image, and sums the squared changes of the displayed values of all pixels within the filter's reach and
        the crop window. The tone curve is applied to the values before their difference is computed. If the difference
        of radiances were multiplied by the slope of the tone curve instead, the measured error would depend mostly on
        bright spots.
        """
        # ``of_pixel`` is the number of channels, and ``stored`` the number of the channels up to the weight W.
        plan, channels, own = self.plan, self.estimator.channels, mi.UInt32(self.index)
        film, of_pixel, stored = film_values(self.state), len(channels.names), channels.names.index("W") + 1
        first, second, squares = self.state.accumulators, self.accumulators, dr.zeros(mi.Float, len(self.index))
        Double = double()
        counts = [Double(v) for v in (dr.gather(mi.UInt32, first.count, own), second.count)]
        around = pixels_around(self.x, self.y, self.estimator.reach, plan.window, plan.window)
        for place, (index, seen) in enumerate(around):
            sums = [image.sums[place * of_pixel :][:stored] for image in (first, second)]
            before = [dr.gather(mi.Float, film.array, index * film.shape[2] + k, seen) for k in range(stored)]
            means = ((dr.gather(Double, a, own) / counts[0], b / counts[1]) for a, b in zip(*sums))
            after = [v + mi.Float(b - a) for v, (a, b) in zip(before, means)]
            change = displayed(channels.luminance(before)) - displayed(channels.luminance(after))
            squares += dr.select(seen, dr.square(change), 0)
            dr.eval(squares)
        # The difference of two images has twice the variance of one image, and four times the variance of their mean.
        # Pixels around a crop window also cause errors in the window, by the filter.
        factor = (0.25 if self.complete else 0.5) * area(plan.region) / area(plan.window)
        errors = np.sqrt(factor * np.array(squares, dtype=np.float64))
        tails = np.percentile(errors, [99, 99.9])
        rms, within = float(np.sqrt(np.mean(errors**2))), display_variance(first) / np.float64(np.array(first.count))
        # Relative standard deviation of the RMS error. The second image may lack the brightest pixels. The variance of
        # the samples within a pixel shows such pixels.
        deviation = 0.5 * (concentration(errors**2) + 2 * concentration(self.state.crop(within, plan.window))) ** 0.5
        # 95 % of a normal distribution are below its mean plus 1.645 standard deviations.
        return rms, float(tails[0]), float(tails[1]), rms * (1 + 1.645 * deviation)


def concentration(squares: np.ndarray) -> float:
    """Returns how concentrated the squared errors ``squares`` are: 1 if one pixel has the whole error, 1/n if n pixels
    have equal errors, 0 if no pixel has an error.
    """
    return float(np.sum(squares**2) / max(np.sum(squares) ** 2, 1e-300))


def next_counts(state: FilmState, target: ErrorTarget, speed: float) -> np.ndarray:
    """Returns the total number of samples of each pixel after the next pass: as many as the error target requires, but
    limited to the maximum size of one pass.

    Before the numbers are rounded up to powers of two, their mean is at most :data:`GROWTH` times the present mean, or
    :data:`UNCERTAIN_GROWTH` times if few pixels have most of the error. With a time limit, the pass also takes at most
    about half of the time that is left; 90 % if less than a fifth of the limit is left. ``speed`` is the measured speed
    of the render, in samples per pixel and second; 0 if the speed is not known. With a time limit and an unknown speed,
    the pass at most doubles the mean number of samples.
    """
    have, ratio = mean(state.accumulators.count), None
    most = (UNCERTAIN_GROWTH if state.noise[3] > UNCERTAIN * state.noise[0] else GROWTH) * have
    if target.seconds:
        share = 0.9 if target.seconds_left < target.seconds / 5 else 0.5  # the last pass uses the rest of the time
        most = min(most, have + speed * target.seconds_left * share) if speed else 2 * have
    if any(target.limits):
        ratio = target.sample_ratio or remaining_factor(state, target)
    return counts_for_ratio(state, ratio, most)


def counts_for_ratio(state: FilmState, ratio: float | None, most: float = np.inf) -> np.ndarray:
    """Returns the number of samples for each pixel with which the error is as small as with ``ratio`` times the current
    samples in every pixel.

    The policy of adaptive sampling distributes the additional samples, so fewer samples suffice than ``ratio`` times
    the current number in every pixel. The returned numbers include the samples that a pixel already has. ``most`` is
    the maximum of the mean number of samples per pixel, before the numbers are rounded up to powers of two. ``ratio``
    is None if only ``most`` limits the numbers of samples. No pixel gets more than the plan's maximum number of
    samples, even if the error is then larger.
    """
    request, count = np.minimum(state.request(), np.float32(UNLIMITED)), np.array(state.accumulators.count)
    # All samples of a pixel so far may agree by chance. So every pixel of the region gets samples from time to time.
    # ``region`` is a view of ``request``.
    region = state.crop(request, state.plan.region)
    region += np.float32(mean(region.ravel()) / 20)
    variances, caustics = display_variance(state.accumulators), state.estimator.transport.caustics
    # The mean variance of the pixels' means at which the samples suffice.
    goal = None if ratio is None else mean(variances / np.float32(count)) / ratio

    def after(effort: float) -> np.ndarray:
        """Returns the total number of samples that each pixel has after the next pass, if all requested numbers of
        samples are multiplied by ``effort``.
        """
        counts = state.counts_for(request * np.float32(effort))
        if caustics is not None:
            plan = state.plan
            limit = limit_by_photons(count, counts, plan.max_samples, caustics.maps(plan.n), caustics.count)
            counts = np.minimum(counts, np.uint32(limit))
        return np.maximum(counts, count)

    def reaches(effort: float) -> bool:
        """Tells whether a pass with the factor ``effort`` reaches the variance ``goal`` or the mean number of samples
        ``most``. If ``goal`` is None, only ``most`` counts.
        """
        counts = np.float32(after(effort))
        return mean(counts) >= most or (goal is not None and mean(variances / counts) <= goal)

    return after(smallest_effort(reaches))


def remaining_factor(state: FilmState, target: ErrorTarget) -> float:
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


def display_variance(accumulators: Accumulators) -> np.ndarray:
    """Returns, for each pixel, the variance of one sample, converted from radiance to displayed values
    (:func:`.in_display_units`); 32-bit floats.
    """
    total, squares, count = accumulators.statistics()
    return np.float32(np.square(in_display_units(np.sqrt(variance(total, squares, count)), total / count)))


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
