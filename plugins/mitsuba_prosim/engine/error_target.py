"""The error target of an image: the stopping criterion, the error estimator, and the samples of the next pass."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ..alone import alone
from ..compat import dr_array
from ..sampling.hash import hash32
from .accumulators import Accumulators, FilmState
from .error import displayed, in_display_units, variance
from .film import film_values
from .plan import UNLIMITED, area

#: Seconds of a work item with a time limit: this fraction of the limit, between these two.
SHARE, SHORTEST, LONGEST = 0.01, 0.01, 0.5

#: Maximum samples of a pass over those so far: few samples estimate the error badly.
GROWTH = 4.0

#: The estimated error that ends a render, over the target: the estimate is uncertain, and an image whose error is small
#: by chance would end too early. A pass aims a little lower.
ENOUGH, AIM = 0.97, 0.94

#: A pass may use a photon pass if the number of its samples is at least that of the photons, or that of one sample of
#: all pixels per map, over this.
SPARSE = 2


@dataclass(frozen=True)
class ErrorTarget:
    """Ends a render when the RMS error of the displayed image (white = 1) and the bounds of 99 and of 99.9 % of its
    pixels are within ``limits``, 0 for no limit, or after ``seconds``, whichever is first.
    """

    limits: tuple[float, float, float]
    seconds: float
    started: float
    #: Seconds at the end for the denoiser.
    denoiser_seconds: float = 0.0

    def excess(self, noise: Sequence[float]) -> float:
        """The measured ``noise`` over the target; the worst of the three."""
        ratios = [measured / limit for measured, limit in zip(noise, self.limits) if limit]
        return min(max(ratios, default=np.nan), 1e100)

    def loosened(self, factor: float) -> ErrorTarget:
        """The same with ``factor`` times the limits."""
        rms, most, nearly_all = self.limits
        return replace(self, limits=(factor * rms, factor * most, factor * nearly_all))

    @property
    def elapsed(self) -> float:
        """Seconds since the beginning."""
        return time.perf_counter() - self.started

    @property
    def seconds_left(self) -> float:
        """Seconds until the end."""
        return self.seconds - self.denoiser_seconds - self.elapsed if self.seconds else np.inf

    @property
    def time_is_up(self) -> bool:
        """Whether the time is up."""
        return self.seconds_left <= self.seconds * SHARE

    @property
    def item_seconds(self) -> float:
        """Seconds of a work item at most."""
        return min(LONGEST, max(self.seconds * SHARE, SHORTEST)) if self.seconds else np.inf


class SecondImage:
    """Error estimator: an independent second image of some pixels. Its difference from the first shows the error of
    both, whatever the distribution of the samples is worth in this scene. ``complete``: of all pixels; the image is
    then the mean of both.

    (The variance of the samples within a pixel does not: well distributed samples can be ten times as good.)
    """

    #: One pixel of this many is in the second image, and at least this number of pixels.
    ONE_IN, MIN_PIXELS = 16, 4096
    #: Fewer pixels than this are repeated, because their differences could all be small by chance; and the maximum
    #: number of copies of each.
    FEW, MAX_COPIES = 512, 64

    @alone()
    def __init__(self, state: FilmState, complete: bool = False) -> None:
        """The second image of ``state``, whose stored accumulators it continues if their number fits."""
        self.state, self.complete = state, complete
        index, seed = state.crop(np.arange(area(state.outer)), state.plan.region).ravel(), state.plan.seed + 1
        one_in = 1 if complete else max(1, min(self.ONE_IN, len(index) // self.MIN_PIXELS))
        index = index[hash32(hash32(index.astype(np.uint64)) + 1) % one_in == 0]
        copies = 1 if complete else min(-(-self.FEW // len(index)), self.MAX_COPIES)
        if copies > 1:
            seed = seed + dr.arange(mi.UInt32, len(index) * copies) // len(index)
            index = np.tile(index, copies)
        self.index, seed = index, hash32(seed)
        chosen = dr_array(index.astype(np.uint32))
        self.x, self.y = (dr.gather(mi.Int32, v, chosen) for v in (state.x, state.y))
        dr.make_opaque(seed, self.x, self.y)
        sampling = replace(state.plan.sampling, adaptive="none")  # it takes as many samples as the image
        self.plan = replace(state.plan, seed=seed, photon_seed=int(seed[0]), sampling=sampling)
        self.estimator = state.estimator
        if state.second is None or dr.width(state.second.count) != len(index):  # none, or those of other pixels
            self.accumulators = Accumulators.empty(self.estimator.sums_per_pixel, len(index))

    @property
    def accumulators(self) -> Accumulators:
        """Those of the state, which a checkpoint stores."""
        assert self.state.second is not None
        return self.state.second

    @accumulators.setter
    def accumulators(self, sums: Accumulators) -> None:
        self.state.second = sums

    @alone()
    def noise(self, state: FilmState) -> tuple[float, float, float]:
        """The RMS error of the displayed image of ``state``, or of the mean of both (white = 1), and the bounds of 99
        and of 99.9 % of its pixels.

        Each pixel of the first image is replaced by that of the second: what changes in the displayed values of the
        pixels to which the filter spreads it. (Errors by the slope of the tone curve would be those of bright spots.)
        """
        plan, channels, own = state.plan, state.estimator.channels, mi.UInt32(self.index)
        film, of_pixel, stored = film_values(state, ()), len(channels.names), channels.names.index("W") + 1
        height, width = (dr.opaque(mi.Int32, v) for v in film.shape[:2])
        first, second, squares = state.accumulators, self.accumulators, dr.zeros(mi.Float, len(self.index))
        counts = [mi.Float(v) for v in (dr.gather(mi.UInt32, first.count, own), second.count)]
        for place, (down, across) in enumerate(np.ndindex(2 * plan.reach + 1, 2 * plan.reach + 1)):
            x = self.x + dr.opaque(mi.Int32, across - plan.reach - plan.window[0])
            y = self.y + dr.opaque(mi.Int32, down - plan.reach - plan.window[1])
            seen = (x >= 0) & (x < width) & (y >= 0) & (y < height)
            sums = [image.sums[place * of_pixel :][:stored] for image in (first, second)]
            before = [dr.gather(mi.Float, film.array, (y * width + x) * of_pixel + k, seen) for k in range(stored)]
            after = [v + b / counts[1] - dr.gather(mi.Float, a, own) / counts[0] for v, a, b in zip(before, *sums)]
            change = displayed(channels.luminance(before)) - displayed(channels.luminance(after))
            squares += dr.select(seen, dr.square(change), 0)
            dr.eval(squares)
        # The pixels around a crop window have errors in it, too.
        part = (0.25 if self.complete else 0.5) * area(plan.region) / area(plan.window)
        errors = np.sqrt(part * np.array(squares, dtype=np.float64))
        tails = np.percentile(errors, [99, 99.9])
        return float(np.sqrt(np.mean(errors**2))), float(tails[0]), float(tails[1])


def requested(state: FilmState) -> np.ndarray:
    """The samples that the policy of ``state`` requests, in any unit; decided once or after each pass."""
    if state.requested is not None:
        return state.requested
    result = np.minimum(state.request(), np.float32(UNLIMITED))
    image = state.crop(result, state.plan.region)
    # Where all samples so far agree, others may not: no pixel of the image is left out for ever.
    image += np.float32(mean(image.ravel()) / 20)
    if state.policy.rounds == 1:
        state.requested = result
    return result


def next_counts(state: FilmState, target: ErrorTarget, speed: float) -> np.ndarray:
    """The counts of the next pass: in proportion to the requested samples, as many as the target needs, at most
    those of a pass. Sets ``state.effort``. ``speed``: samples of a pixel in a second, 0 if not known.
    """
    request, count = requested(state), np.array(state.accumulators.count)
    deviation, have = display_variance(state.accumulators), mean(count)
    most, goal = GROWTH * have, None
    if target.seconds:
        share = 0.9 if target.seconds_left < target.seconds / 5 else 0.5  # the last pass takes all
        most = min(most, have + speed * target.seconds_left * share) if speed else 2 * have
    if any(target.limits):
        # Well distributed samples are better than the first ones promise: not all of a long way at once.
        way = remaining_factor(state, target)
        goal = mean(deviation / np.float32(count)) / (way if way < 2 else way**0.7)
    caustics = state.estimator.transport.caustics

    def after(effort: float) -> np.ndarray:
        counts = state.counts_for(request * np.float32(effort))
        if caustics is not None:
            plan = state.plan
            limit = limit_by_photons(count, counts, plan.max_samples, caustics.maps(plan.n), caustics.count)
            counts = np.minimum(counts, np.uint32(limit))
        return np.maximum(counts, count)

    def reaches(effort: float) -> bool:
        counts = np.float32(after(effort))
        return mean(counts) >= most or (goal is not None and mean(deviation / counts) <= goal)

    # The policy may request more samples now than before: the search does not begin at the effort of before.
    state.effort = smallest_effort(reaches, state.effort / (4 if state.policy.rounds > 1 else 1))
    return after(state.effort)


def remaining_factor(state: FilmState, target: ErrorTarget) -> float:
    """The samples at the end over those so far, by the power law of the error."""
    return (target.excess(state.noise) / AIM) ** 2


def limit_by_photons(count: np.ndarray, wanted: np.ndarray, max_samples: int, maps: int, photons: int) -> int:
    """The maximum samples of a pixel in a pass: that of the counts ``wanted``, without the last photon passes if too
    few samples would use them; 0 if no photon pass is worth its cost.

    A photon pass has a fixed cost, so it waits until more pixels need it. It serves ``maps`` samples of each pixel.
    ``count``: samples so far; ``max_samples``: those that a pixel may get.
    """
    last, lacking = int(wanted.max()), wanted > count
    if last == max_samples or not lacking.any():
        return last  # there are no further passes
    passes = -(-last // maps)
    starts, ends = (np.bincount(counts[lacking], minlength=passes * maps + 1) for counts in (count, wanted))
    samples = np.cumsum(starts - ends)[: passes * maps].reshape(passes, maps).sum(axis=1)
    enough = np.flatnonzero(samples >= min(photons, count.size * maps) / SPARSE)
    return (int(enough[-1]) + 1) * maps if enough.size else 0


def display_variance(accumulators: Accumulators) -> np.ndarray:
    """Variance of a sample of each pixel, in display units squared."""
    total, squares, count = accumulators.statistics()
    return np.square(in_display_units(np.sqrt(variance(total, squares, count)), total / count))


def smallest_effort(reaches: Callable[[float], bool], begin: float) -> float:
    """The smallest effort (samples per requested sample) above ``begin`` for which ``reaches`` is true, within 0.1 %;
    at most 2^60.
    """
    low, high = max(begin, 2.0**-20), max(2 * begin, 2.0**-19)
    while not reaches(high) and high < 2.0**60:
        low, high = high, 4 * high
    for _ in range(12):
        middle = (low * high) ** 0.5
        low, high = (low, middle) if reaches(middle) else (middle, high)
    return high


def mean(values: np.ndarray) -> float:
    """Mean in 64 bits."""
    return float(np.mean(values, dtype=np.float64))
