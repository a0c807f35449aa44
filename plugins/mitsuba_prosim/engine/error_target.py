"""The error target of an image: when a render stops, how its error is measured, and how many samples the next pass
takes.
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
from ..compat import dr_array
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
#: The same ratio after an uncertain estimate, which may be too large.
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

    ``limits`` are the limits of the RMS error of the displayed image (white = 1) and of the errors of 99 % and of 99.9
    % of its pixels; 0 stands for no limit. The render ends when all errors are within ``limits``, or after ``seconds``.
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
        """Returns the largest ratio of a measured error in ``noise`` to its limit; NaN without limits.

        The upper bound of the RMS error, divided by :data:`TOLERANCE`, counts too. If the bound is more than
        :data:`UNCERTAIN` times the error, it does not count: few pixels have most of the error, and
        :attr:`.Reached.uncertain` reports this.
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
        """Seconds that are left for samples before the denoiser must start; infinite without a time limit."""
        return self.seconds - self.denoiser_seconds - self.elapsed if self.seconds else np.inf

    @property
    def time_is_up(self) -> bool:
        """Whether the time limit is reached, except for :data:`SHARE` of it, about the time of one work item."""
        return self.seconds_left <= self.seconds * SHARE

    @property
    def item_seconds(self) -> float:
        """Maximum seconds of a work item: :data:`SHARE` of the limit, within bounds; infinite without a time limit."""
        return min(LONGEST, max(self.seconds * SHARE, SHORTEST)) if self.seconds else np.inf


class SecondImage:
    """Error estimator: an independent second image of some pixels.

    The difference between the first and the second image shows the error of both, however well the samples are
    distributed in the scene. The variance of the samples within a pixel does not show the error of the image: well
    distributed samples can be ten times better. ``complete`` tells whether the second image has all pixels; if so, the
    final image is the mean of the two images.
    """

    #: One pixel of this many is in the second image, and at least this number of pixels.
    ONE_IN, MIN_PIXELS = 16, 4096
    #: Fewer pixels than this are sampled several times, because their differences could all be small by chance; and the
    #: maximum number of copies of a pixel.
    FEW, MAX_COPIES = 512, 64

    @alone()
    def __init__(self, state: FilmState, complete: bool = False) -> None:
        """Begins the second image of ``state``: all pixels of the region if ``complete``, else a random choice of them.

        If only few pixels are chosen, each of them is sampled several times with different seeds. If ``state`` stores
        accumulators with the right number of pixels, the second image continues from these accumulators.
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
    def noise(self) -> Noise:
        """Returns the error of the displayed image.

        The displayed image is the first image, or the mean of both images if the second image is complete. For each
        pixel of the second image, the method replaces the samples of this pixel in the first image by those of the
        second image, and sums the squared changes of the displayed values of all pixels within the filter's reach. The
        tone curve is applied before the difference. A difference of radiances times the slope of the tone curve would
        depend mostly on bright spots.
        """
        plan, channels, own = self.plan, self.estimator.channels, mi.UInt32(self.index)
        film, of_pixel, stored = film_values(self.state), len(channels.names), channels.names.index("W") + 1
        first, second, squares = self.state.accumulators, self.accumulators, dr.zeros(mi.Float, len(self.index))
        counts = [mi.Float(v) for v in (dr.gather(mi.UInt32, first.count, own), second.count)]
        around = pixels_around(self.x, self.y, self.estimator.reach, plan.window, plan.window)
        for place, (index, seen) in enumerate(around):
            sums = [image.sums[place * of_pixel :][:stored] for image in (first, second)]
            before = [dr.gather(mi.Float, film.array, index * film.shape[2] + k, seen) for k in range(stored)]
            after = [v + b / counts[1] - dr.gather(mi.Float, a, own) / counts[0] for v, a, b in zip(before, *sums)]
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
    """Returns the inverse of the effective number of pixels that have the error; ``squares`` are squared errors."""
    return float(np.sum(squares**2) / max(np.sum(squares) ** 2, 1e-300))


def next_counts(state: FilmState, target: ErrorTarget, speed: float) -> np.ndarray:
    """Returns the counts after the next pass: as high as the target requires, but limited to the size of one pass.

    ``speed`` is the number of samples per pixel and second; 0 if unknown.
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
    """Returns counts that reduce the error as much as ``ratio`` times the samples in each pixel.

    The additional samples are taken where the policy requests them, so the counts have a smaller mean than ``ratio``
    times the counts so far. ``most`` is the maximum of the mean; ``ratio`` is None if only ``most`` limits the counts.
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
        """Returns the counts after a pass in which each pixel gets its requested samples times ``effort``."""
        counts = state.counts_for(request * np.float32(effort))
        if caustics is not None:
            plan = state.plan
            limit = limit_by_photons(count, counts, plan.max_samples, caustics.maps(plan.n), caustics.count)
            counts = np.minimum(counts, np.uint32(limit))
        return np.maximum(counts, count)

    def reaches(effort: float) -> bool:
        """Tells whether a pass with this ``effort`` reaches ``goal`` or ``most``."""
        counts = np.float32(after(effort))
        return mean(counts) >= most or (goal is not None and mean(variances / counts) <= goal)

    return after(smallest_effort(reaches))


def remaining_factor(state: FilmState, target: ErrorTarget) -> float:
    """Returns the ratio of the samples needed for :data:`AIM` times the target to the samples so far.

    The error is assumed to fall as samples to the power of -:data:`RATE`.
    """
    return (target.excess(state.noise) / AIM) ** (1 / RATE)


def limit_by_photons(count: np.ndarray, wanted: np.ndarray, max_samples: int, maps: int, photons: int) -> int:
    """Returns the maximum number of samples of a pixel in a pass, so that photon passes are worth their cost.

    A photon pass emits ``photons`` photons, and has the photon maps of ``maps`` successive samples of each pixel. Its
    cost is fixed. So the last photon passes are left out if few samples would use them (:data:`SPARSE`); a later pass
    over the image takes these samples. The result is the maximum of the counts ``wanted``, or less if photon passes are
    left out, or 0 if all photon passes are left out. ``count`` has the samples of each pixel so far. ``max_samples`` is
    the maximum number of samples of a pixel; no photon pass is left out if the pass reaches this number.
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
    """Returns the variance of a sample of each pixel, as a squared error of the displayed value
    (:func:`.in_display_units`).
    """
    total, squares, count = accumulators.statistics()
    return np.square(in_display_units(np.sqrt(variance(total, squares, count)), total / count))


def smallest_effort(reaches: Callable[[float], bool]) -> float:
    """Returns the smallest effort from 2^-20 to 2^40 for which ``reaches`` is true, within 0.1 %; 2^40 if none is.

    The effort is the number of samples per requested sample.
    """
    exponents = np.linspace(-20, 40, 2**16 + 1)
    return float(2 ** exponents[bisect_left(exponents[:-1], True, key=lambda exponent: reaches(2**exponent))])


def mean(values: np.ndarray) -> float:
    """Returns the mean, computed with 64 bits."""
    return float(np.mean(values, dtype=np.float64))
