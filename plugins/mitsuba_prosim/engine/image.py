"""The image in progress, and the independent second image that measures its error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np

from ..alone import alone
from ..compat import denormals_rounded, double, dr_array
from ..sampling.hash import hash32
from ..sampling.sobol import z_curve
from .accumulators import Accumulators
from .estimator import Estimator
from .film import film_values, put
from .pixel_set import PixelSet
from .plan import UNLIMITED, Plan, Rectangle, area, indexer, pixels, widened
from .policies import mean_around
from .standard_error import displayed, in_display_units, variance
from .tiles import Part, part_numbers

#: RMS error of the displayed image (white = 1), the bound of the errors of 99 % of its pixels, and the upper bound of
#: the RMS error, which the error exceeds with a probability of about 5 %; NaN while they are not known.
Noise: TypeAlias = "tuple[float, float, float]"


class Image(PixelSet):
    """The state of an image in progress: the accumulators of all pixels, and the state of adaptive sampling.

    The n-th sample of a pixel does not depend on the order in which samples are taken, so the image depends only on the
    number of samples of each pixel. A :class:`.Checkpoint` stores this state in a file. ``part`` is the part of the
    image that is rendered; None for the whole image.
    """

    def __init__(self, plan: Plan, estimator: Estimator, part: Part | None = None) -> None:
        self.plan, self.estimator, self.policy, self.part = plan, estimator, plan.policy, part
        #: Width in pixels of the margin around the image whose samples the policy uses.
        self.margin = self.policy.rounds * self.policy.reach
        #: The rectangle of the pixels in the arrays, row by row.
        self.outer = widened(plan.region, self.margin, plan.domain)
        self.own = slice(0, area(self.outer))
        self._set_pixels(*pixels(self.outer))
        self.seed = dr_array(np.full(area(self.outer), plan.seed))
        self.accumulators = Accumulators.empty(estimator.sums_per_pixel, area(self.outer))
        #: The last measurement by :class:`.SecondImage`, see :data:`Noise`.
        self.noise: Noise = (float("nan"),) * 3
        #: Estimates of the error of the denoised image: samples per pixel, the denoiser's networks, and the ratio of
        #: the error of the denoised image to the error of the raw image.
        self.estimates = list[Sequence[Any]]()
        #: Number of decisions of the policy so far; 0 before the end of the first pass.
        self.rounds = 0
        #: The counts of the current pass; None during the first pass and between two passes.
        self.wanted: np.ndarray | None = None
        #: Whether the image has all requested samples.
        self.finished = False
        #: The second image; and the sums of a checkpoint (:meth:`.Accumulators.arrays`) with which it begins.
        self.second: SecondImage | None = None
        self.second_sums: Mapping[str, np.ndarray] = {}
        #: The last result of :attr:`film_values`, and the numbers of samples for which it holds.
        self._film: tuple[mi.UInt32, mi.TensorXf] | None = None

    # ---------------------------------------------------------------- changes of the state

    def _set_pixels(self, x: mi.Int32, y: mi.Int32) -> None:
        """Stores the coordinates of the pixels of both images."""
        self.x, self.y = x, y
        self.along_z = np.argsort(np.array(z_curve(x, y)))

    def begin_round(self, wanted: np.ndarray | None, rounds: int | None = None) -> None:
        """Begins a pass to ``wanted`` samples a pixel; ``rounds`` is its decision's number, by default the next."""
        self.wanted, self.rounds = wanted, self.rounds + 1 if rounds is None else rounds

    def begin_second(self, complete: bool) -> SecondImage:
        """Begins or continues a second image, and returns it; the samples for other pixels are discarded."""
        if self.second is not None and self.second.complete:
            return self.second
        second, stored = SecondImage(self, complete), self.second_sums
        number = len(second.index)
        values = ((np.array(v)[self.own], np.array(v)[second.index]) for v in (self.x, self.y))
        self._set_pixels(*(dr_array(np.concatenate(both)) for both in values))
        self.seed = dr_array(np.concatenate([np.full(self.own.stop, self.plan.seed), second.seeds]))
        if stored or np.any(self.count):
            ours = self.accumulators.arrays(self.own)
            if len(stored.get("count", ())) != number:  # the pixels are others
                stored = {name: np.zeros(number, values.dtype) for name, values in ours.items()}
            sums = {name: np.concatenate([values, stored[name]]) for name, values in ours.items()}
            self.accumulators = Accumulators.of_arrays(sums)
        else:
            self.accumulators = Accumulators.empty(self.estimator.sums_per_pixel, self.own.stop + number)
        second.accumulators, self.second, self.second_sums = self.accumulators, second, {}
        return second

    def record(self, noise: Noise, estimates: Sequence[Sequence[Any]] = ()) -> None:
        """Stores a measured error, and new estimates of the error of the denoised image."""
        self.noise, self.estimates = noise, [*self.estimates, *estimates]

    # ---------------------------------------------------------------- the state

    @property
    def one(self) -> np.ndarray:
        """An array that is 1 for each pixel that needs samples, and 0 for all other pixels."""
        return self.counts_of_part(np.ones(self.own.stop, np.uint32), self.margin)

    @property
    def most_samples(self) -> float:
        """Maximum number of samples of the whole image. The progress uses it while later passes are not decided."""
        return float(self.plan.max_samples * np.count_nonzero(self.one))

    @property
    def has_complete_second(self) -> bool:
        """Whether there are sums of a complete second image."""
        return len(self.second_sums.get("count", ())) == area(self.plan.region)

    @property
    def film_values(self) -> mi.TensorXf:
        """The values that the film stores for the image so far, see :func:`.film.film_values`."""
        count = self.accumulators.count
        # The sums change together with ``count``. The old ``count`` is kept, so that no new array gets its number.
        if self._film is None or self._film[0].index != count.index:
            self._film = mi.UInt32(count), film_values(self)
        return self._film[1]

    @alone()
    def all_counts(self, lost: bool = False) -> np.ndarray:
        """Returns the number of samples of each pixel, or of those that are infinite or NaN if ``lost`` is true, with
        those of a complete second image; shape (height, width).
        """
        every = np.array(self.accumulators.lost if lost else self.accumulators.count)
        counts = every[self.own]
        if self.second is not None and self.second.complete:
            counts[self.second.index] += every[self.second.own]
        return self.crop(counts, self.plan.window)

    @alone()
    def update_film(self, second: bool = False) -> None:
        """Writes the image, or the second image, which must be complete, to the film."""
        film = self.estimator.sensor.film()
        values = film_values(self.second) if second and self.second else self.film_values
        put(film, values, self.estimator.channels.aov_names)
        film.schedule_storage()
        dr.eval()  # pending work of this thread would break dr.freeze in another thread

    @alone()
    def developed(self, second: bool = False) -> mi.TensorXf:
        """Returns the developed image, or the second, shape (height, width, channels), which the film then holds."""
        self.update_film(second)
        return self.estimator.sensor.film().develop()

    def halves(self) -> list[np.ndarray]:
        """Returns the developed image and, if it is complete, the second; each (height, width, channels)."""
        second = self.second
        both = second is not None and second.complete and np.all(second.count > 0)
        # The first image is developed last, because the film must hold it at the end. So the list is reversed.
        return [np.array(self.developed(is_second)) for is_second in ((True, False) if both else (False,))][::-1]

    def crop(self, values: np.ndarray, rectangle: Rectangle) -> np.ndarray:
        """Returns a view of the entries of ``values`` for the pixels of ``rectangle``, shape (height, width).

        ``values`` has one entry for each pixel of the rectangle :attr:`outer`, row by row; ``rectangle`` must lie in
        :attr:`outer`.
        """
        left, top, right, bottom = self.outer
        plane = values.reshape(bottom - top, right - left)
        return plane[rectangle[1] - top : rectangle[3] - top, rectangle[0] - left : rectangle[2] - left]

    @property
    def counts(self) -> np.ndarray:
        """Number of samples of each pixel of ``plan.region``, the pixels that reach the crop window by the filter."""
        return self.crop(self.count, self.plan.region)

    def counts_of_part(self, counts: np.ndarray, reach: int) -> np.ndarray:
        """Returns ``counts``, but 0 for pixels that are farther than ``reach`` pixels from the image part :attr:`part`.

        ``counts`` has one entry for each pixel of :attr:`outer`. A distance is the larger one of the distances in rows
        and in columns. ``reach``, in pixels, must not exceed the side of a tile (:mod:`.tiles`). A place outside
        ``plan.region`` counts as the nearest pixel of ``plan.region``. If :attr:`part` is None, ``counts`` is returned
        unchanged.
        """
        if self.part is None:
            return counts
        x, y, needed = np.array(self.x)[self.own], np.array(self.y)[self.own], np.zeros(counts.shape, bool)
        left, top, right, bottom = self.plan.region
        # These nine places meet all tiles within ``reach`` pixels, because no tile is narrower than ``reach``.
        for px in (np.clip(x + step, left, right - 1) for step in (-reach, 0, reach)):
            for py in (np.clip(y + step, top, bottom - 1) for step in (-reach, 0, reach)):
                needed |= part_numbers(self.plan.region, self.part.of, self.margin, px, py) == self.part.number
        return np.where(needed, counts, np.uint32(0))

    def request(self, margin: int = 0) -> np.ndarray:
        """Returns the number of samples that the policy of adaptive sampling requests for each pixel of :attr:`outer`.

        The result is a flat array of total numbers, which include the samples that a pixel already has. The numbers are
        32-bit floats, neither rounded nor limited; the policy ``graded`` also requests infinity. The requested number
        is 0 for a pixel that is more than ``margin`` pixels outside ``plan.region``.
        """
        statistics = self.statistics()
        # The statistics of both images are added, because either image may have met a rare bright light.
        if self.second is not None:
            for first, second in zip(statistics, self.second.statistics()):
                np.add.at(first, self.second.index, second)
        with np.errstate(all="ignore"):  # the error is NaN without samples
            values = np.float32(self.policy.request(*(self.crop(sums, self.outer) for sums in statistics)))
        there, result = widened(self.plan.region, margin, self.plan.domain), np.zeros(area(self.outer), np.float32)
        self.crop(result, there)[:] = self.crop(values, there)
        return result

    def counts_for(self, request: np.ndarray) -> np.ndarray:
        """Converts the requested numbers of samples to the numbers of samples that the pixels will have.

        The numbers include the samples that a pixel already has. A request below the plan's minimum number of samples
        per pixel becomes this minimum. If the policy is unbounded, a request above the minimum is rounded up to a
        power of two, for which Sobol' points are best. Each number is limited to the plan's maximum number of samples
        per pixel. A request of NaN becomes 1.
        """
        plan, clipped = self.plan, np.float32(np.fmin(np.fmax(request, 1), UNLIMITED))  # ``fmax`` ignores NaN
        # The bits of a positive float begin with its exponent: a mantissa other than 0 raises the exponent by 1.
        fraction = np.uint32(0x7FFFFF)
        power_of_two = ((clipped.view(np.uint32) + fraction) & ~fraction).view(np.float32)
        rounded = power_of_two if plan.policy.unbounded else clipped
        counts = np.where(request <= plan.min_samples, np.float32(plan.min_samples), rounded)
        return np.minimum(counts, plan.max_samples).astype(np.uint32)


class SecondImage(PixelSet):
    """An independent second image of some or all pixels, from which the error of the first image is estimated.

    The difference between two independent images shows the error of these images, however well the samples are
    distributed. The variance of the samples within a pixel does not show the error of the image: if the samples are
    well distributed, the actual error can be ten times smaller. ``complete`` tells whether the second image was begun
    as a whole image, which has each pixel once; then the final image is the mean of the first and the second image.
    """

    #: One pixel of this many is in the second image, and at least this number of pixels.
    ONE_IN, MIN_PIXELS = 64, 2048
    #: Fewer pixels than this are sampled several times, because their differences could all be small by chance; and the
    #: maximum number of copies of a pixel.
    FEW, MAX_COPIES = 512, 64
    #: Minimum ratio of the error of a pixel that a rare bright sample has met to the measured RMS error.
    RARE = 30

    @alone()
    def __init__(self, image: Image, complete: bool) -> None:
        """Begins a second image for ``image``: of all pixels of the plan's region if ``complete`` is true, else of
        randomly chosen pixels.

        One of :attr:`ONE_IN` pixels is chosen, or more, so that there are at least about :attr:`MIN_PIXELS` pixels; in
        a small image, all pixels are chosen. If fewer than :attr:`FEW` pixels are chosen, each chosen pixel is sampled
        several times with different seeds, but at most :attr:`MAX_COPIES` times. If ``image.second_sums`` are
        accumulators for this number of pixels, the second image continues from these accumulators.
        """
        self.estimator, self.complete = image.estimator, complete
        #: The rectangle of the pixels of a complete second image, row by row.
        self.outer = image.plan.region
        index, seed = image.crop(np.arange(area(image.outer)), image.plan.region).ravel(), image.plan.seed + 1
        one_in = 1 if complete else max(1, min(self.ONE_IN, len(index) // self.MIN_PIXELS))
        index = index[hash32(hash32(index.astype(np.uint64)) + 1) % one_in == 0]  # a pseudo-random choice
        copies = 1 if complete else min(-(-self.FEW // len(index)), self.MAX_COPIES)
        if copies > 1:
            seed = seed + dr.arange(mi.UInt32, len(index) * copies) // len(index)
            index = np.tile(index, copies)
        self.index, seed = index, hash32(seed)
        self.own = slice(image.own.stop, image.own.stop + len(index))
        self.seeds = np.broadcast_to(np.array(seed), index.shape)
        self.plan = replace(image.plan, seed=seed, photon_seed=int(seed[0]))

    def lags(self, image: Image) -> bool:
        """Tells whether any pixel has fewer samples than in the first ``image``."""
        return bool(np.any(self.count < image.count[self.index]))

    @alone()
    @denormals_rounded()
    def noise(self, image: Image) -> Noise:
        """Returns the measured error of the displayed image, see :data:`Noise`.

        The displayed image is the first ``image``, or the mean of both images if the second image is complete. For each
        pixel of the second image, the method replaces the samples of this pixel in the first image by those of the
        second image, and sums the squared changes of the displayed values of all pixels within the filter's reach and
        the crop window. The tone curve is applied to the values before their difference is computed. If the difference
        of radiances were multiplied by the slope of the tone curve instead, the measured error would depend mostly on
        bright spots.
        """
        plan, channels, film, sums = self.plan, self.estimator.channels, image.film_values, self.accumulators
        reach, stored = self.estimator.reach, channels.names.index("W") + 1  # the channels up to the weight W
        side, Double = 2 * reach + 1, double()
        # Each lane is one of the pixels within the filter's reach of one pixel of the second image.
        lane = dr.arange(mi.UInt32, side**2 * len(self.index))
        number, place = lane // side**2, lane % side**2
        pixel = dr.gather(mi.UInt32, dr_array(self.index.astype(np.uint32)), number)
        x = dr.gather(mi.Int32, image.x, pixel) + mi.Int32(place % side) - reach
        y = dr.gather(mi.Int32, image.y, pixel) + mi.Int32(place // side) - reach
        index, seen = indexer(plan.window, plan.window)(x, y)
        means = []
        for one in (pixel, number + dr.opaque(mi.UInt32, self.own.start)):
            values = sums.film_sums(one, place, len(channels.names))[:stored]
            means.append([value / Double(dr.gather(mi.UInt32, sums.count, one)) for value in values])
        before = list(dr.gather(mi.ArrayXf, film.array, index, seen, shape=(film.shape[2], len(lane))))[:stored]
        after = [value + mi.Float(second - first) for value, first, second in zip(before, *means)]
        change = displayed(channels.luminance(before)) - displayed(channels.luminance(after))
        squares = np.array(dr.select(seen, dr.square(change), 0), dtype=np.float64).reshape(-1, side**2).sum(axis=1)
        # The difference of two images has twice the variance of one image, and four times the variance of their mean.
        # Pixels around a crop window also cause errors in the window, by the filter.
        factor = (0.25 if self.complete else 0.5) * area(plan.region) / area(plan.window)
        errors = np.sqrt(factor * squares)
        rms, within = float(np.sqrt(np.mean(errors**2))), display_variance(image) / np.float64(image.count)
        # Relative standard deviation of the RMS error. The second image may lack the brightest pixels. The variance of
        # the samples within a pixel shows such pixels.
        deviation = 0.5 * (concentration(errors**2) + 2 * concentration(image.crop(within, plan.window))) ** 0.5
        # 95 % of a normal distribution are below its mean plus 1.645 standard deviations.
        missed = 0.0 if self.complete else error_of_few(image, self.RARE * rms)
        return rms, float(np.percentile(errors, 99)), float(np.hypot(rms * (1 + 1.645 * deviation), missed))


def error_of_few(image: Image, least: float) -> float:
    """Returns the RMS error that the displayed ``image`` has if only those pixels are wrong whose samples tell an error
    above ``least``. A rare bright sample makes such an error, which a second image of some pixels misses.

    The light around a pixel, without the bright sample, tells the slope of the tone curve.
    """
    (total, _, count), window = image.statistics(), area(image.plan.window)
    mean, error = (image.crop(values, image.plan.region) for values in (total / count, image.error()))
    light = np.minimum(mean, mean_around(mean, 2))
    # The error of a mean that one sample dominates is this mean; not so where a lamp has its edge.
    few = (displayed(light + error) - displayed(light) > least) & (error > 0.7 * mean)
    shares = image.estimator.shares()
    changed = displayed(light[few] + shares[:, None] * error[few]) - displayed(light[few])
    return float(np.sqrt(np.sum(np.square(changed)) / window))


def concentration(squares: np.ndarray) -> float:
    """Returns how concentrated ``squares`` are: 1 if one pixel has all, 1/n if n pixels have equal errors."""
    return float(np.sum(squares**2) / max(np.sum(squares) ** 2, 1e-300))


@denormals_rounded()
def display_variance(image: PixelSet) -> np.ndarray:
    """Returns each pixel's variance of one sample in displayed values (:func:`.in_display_units`)."""
    total, squares, count = image.accumulators.total, image.accumulators.squares, double()(image.accumulators.count)
    deviation = in_display_units(dr.sqrt(variance(total, squares, count)), total / count)
    return np.array(mi.Float(dr.square(deviation)))[image.own]
