"""Samples of pixels, summed: what an image grows from (section 5.3.2)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..sampling import wavelengths
from ..sampling.hash import combine, hash32
from ..sampling.nrook import NRook, SamplerPoints
from ..sampling.sobol import Points, Sobol
from ..transport.context import LENS, PIXEL, TIME_AND_WAVELENGTH
from .camera import ray_sampler
from .error import error_between_passes, standard_error
from .film import Channels, luminance
from .plan import Plan

if TYPE_CHECKING:
    #: From the sums of the luminance and of its square over the first ``t`` samples: which pixels need no more.
    Quiet = Callable[[mi.Float, mi.Float, mi.UInt32], mi.Bool]

#: A sample counts as no brighter than this in what is said of the error: the squares of N² samples stay finite.
BRIGHTEST = 1e16

#: A sample that is darker counts as black there: its square would be a denormal number, which Dr.Jit's threads take for
#: zero and the main thread, which works where there is but one, does not.
DARKEST = 1e-16


@dataclass
class Estimate:
    """Sums over the first ``count`` samples of each pixel: Dr.Jit arrays with one entry a pixel.

    They are taken in the order of the samples, wherever one stops in between: the bits depend on ``count`` alone.
    """

    #: The film's values, weighted by its filter, for every pixel within the filter's reach, row by row, channel by
    #: channel.
    sums: list[mi.Float]
    #: Sums of the luminance, of its square, and of the square of its mean over each whole pass.
    total: mi.Float
    squares: mi.Float
    pass_squares: mi.Float
    #: Sum of the luminance over the pass that is not whole yet.
    in_pass: mi.Float
    #: Number of samples.
    count: mi.UInt32

    @classmethod
    def nothing(cls, values: int, pixels: int) -> Estimate:
        """No samples yet, of so many values in each of so many pixels."""
        floats = [dr.zeros(mi.Float, pixels) for _ in range(values + 4)]
        count = dr.zeros(mi.UInt32, pixels)
        dr.make_opaque(floats, count)
        return cls(floats[4:], floats[0], floats[1], floats[2], floats[3], count)

    def at(self, where: mi.UInt32) -> Estimate:
        """The entries with the indices ``where``."""
        floats = [dr.gather(mi.Float, values, where) for values in self._floats()]
        count = dr.gather(mi.UInt32, self.count, where)
        return Estimate(floats[4:], floats[0], floats[1], floats[2], floats[3], count)

    def put(self, other: Estimate, where: mi.UInt32) -> None:
        """Replaces the entries with the indices ``where``, each at most once."""
        for mine, theirs in zip([*self._floats(), self.count], [*other._floats(), other.count]):
            dr.scatter(mine, theirs, where, mode=dr.ReduceMode.NoConflicts)

    def _floats(self) -> list[mi.Float]:
        return [self.total, self.squares, self.pass_squares, self.in_pass, *self.sums]

    def error(self, n: int) -> mi.Float:
        """Standard error of the mean luminance; between passes of ``n`` samples where there are two or more, whole."""
        count = mi.Float(self.count)
        passes = count / n
        between = error_between_passes(self.total / n, self.pass_squares, passes)
        whole = (self.count > n) & (self.count % n == 0)
        return dr.select(whole, between, standard_error(self.total, self.squares, count))


class Estimator:
    """Takes samples: from the camera through the scene to the film's values."""

    def __init__(
        self,
        plan: Plan,
        scene: mi.Scene,
        sensor: mi.Sensor,
        transport: Any,
        channels: Channels,
        sampler: mi.Sampler | None = None,
    ) -> None:
        self.plan, self.scene, self.sensor, self.transport, self.channels = plan, scene, sensor, transport, channels
        #: What the samples are drawn from, if not from N-rook patterns; and how often it was seeded.
        self.sampler, self.seeded = sampler, 0
        self.rays = ray_sampler(sensor)
        width, height = (int(v) for v in sensor.film().size())
        self.rfilter = sensor.film().rfilter()
        self.inverse_size = mi.Vector2f(dr.opaque(mi.Float, 1 / width), dr.opaque(mi.Float, 1 / height))

    @property
    def values(self) -> int:
        """How many values a sample has: for each channel, one for each pixel within the filter's reach."""
        return len(self.channels.names) * (2 * self.plan.reach + 1) ** 2

    @property
    def smoothing(self) -> float:
        """What the filter leaves of the standard error of pixels that differ by their noise alone."""
        r = self.plan.reach + 0.5
        x = np.linspace(-r, r, 2001)
        f = np.array(self.rfilter.eval(mi.Float(x)), dtype=np.float64)
        return 1.0 if self.rfilter.is_box_filter() else float(np.mean(f**2) / np.mean(f) ** 2 / (2 * r))

    def camera_ray(self, x: mi.Int32, y: mi.Int32, points: Points) -> tuple[mi.Ray3f, mi.Spectrum, mi.Point2f]:
        """Camera ray through pixel (x, y): ``(ray, weight, position)``, the position being that within the pixel."""
        position = points(PIXEL)
        lens = points(LENS) if self.sensor.needs_aperture_sample() else mi.Point2f(0.5)
        moving = self.sensor.shutter_open_time() > 0
        other = points(TIME_AND_WAVELENGTH) if moving or mi.is_spectral else mi.Point2f(0.5)
        wavelength = other.y
        if mi.is_spectral and not isinstance(points, SamplerPoints):
            wavelength = self._wavelength(points)
        time = mi.Float(self.sensor.shutter_open())
        if moving:
            time += other.x * self.sensor.shutter_open_time()
        on_film = (mi.Point2f(mi.Float(x), mi.Float(y)) + position) * self.inverse_size
        ray, weight = self.rays(time, wavelength, on_film, lens)
        return ray, weight, position

    def _wavelength(self, points: NRook | Sobol) -> mi.Float:
        """The number in [0, 1) by which the sensor draws the wavelengths of a sample: those of its photons, or the
        pixel's own. That they go through the spectrum in the order of the samples does no harm: which strata of a space
        these have is drawn anew in each pass.
        """
        if self.transport.caustics is not None:
            return self.transport.caustics.wavelength(points.t)
        return wavelengths.shared(combine(points.key, TIME_AND_WAVELENGTH), *points.division)

    def _points(self, x: mi.Int32, y: mi.Int32, t: mi.UInt32) -> NRook | Sobol:
        """The ``t``-th sample of the pixels (x, y), in every space; it divides the spectrum as its photons do."""
        points = self.plan.points(x, y, t)
        if self.transport.caustics is not None:
            points.division = self.transport.caustics.division(t)
        return points

    def sample(
        self, x: mi.Int32, y: mi.Int32, t: mi.UInt32, sampler: mi.Sampler | None = None
    ) -> tuple[list[mi.Float], mi.Float, mi.Point2f]:
        """The ``t``-th sample of the pixels (x, y), or one that is drawn from ``sampler``: ``(values, luminance,
        position)``, ``values`` being what the film stores for a sample of weight 1.
        """
        points = self._points(x, y, t) if sampler is None else SamplerPoints(sampler)
        ray, weight, position = self.camera_ray(x, y, points)
        L, hit, *others = self.transport(ray, points, True)
        L *= weight
        # A direction at grazing incidence can overflow; one such sample must not blacken its pixel.
        L = dr.select(dr.all(dr.isfinite(L)), L, 0)
        alpha = dr.select(hit, mi.Float(1), 0)
        values = self.channels.values(self.scene, self.sensor.sampler(), ray, L, alpha, *others)
        return values, luminance(L, ray.wavelengths), position

    def spread(self, values: list[mi.Float], position: mi.Point2f) -> list[tuple[mi.Float, mi.Float]]:
        """``(weight, value)`` for each pixel within the filter's reach, row by row, and each value."""
        reach = self.plan.reach
        if self.rfilter.is_box_filter():
            return [(mi.Float(1), v) for v in values]
        offsets = range(-reach, reach + 1)
        across = [self.rfilter.eval(k + 0.5 - position.x) for k in offsets]
        down = [self.rfilter.eval(k + 0.5 - position.y) for k in offsets]
        return [(wx * wy, v) for wy in down for wx in across for v in values]

    def take(self, x: mi.Int32, y: mi.Int32, start: Estimate, end: mi.UInt32, quiet: Quiet | None = None) -> Estimate:
        """Continues from ``start`` until the pixels (x, y) have ``end`` samples, one lane a pixel, or are ``quiet``
        after a pass. All arguments are evaluated arrays, so that one kernel serves every item; so is what it returns.
        """
        caustics = self.transport.caustics
        if caustics is None:
            start = self._take(x, y, start, end, quiet)
            dr.eval(start)
            return start
        for which in self.sets(self.plan, start.count, end):
            caustics.draw(*which)
            _, number, n = which
            until = dr.minimum(end, dr.opaque(mi.UInt32, (number + 1) * caustics.maps(n)))
            start = self._take(x, y, start, dr.maximum(start.count, until), quiet)
            dr.eval(start)
        return start

    def sets(self, plan: Plan, count: mi.UInt32, end: mi.UInt32) -> Iterator[tuple[int, int, int]]:
        """Seed, number and samples of a pass of the sets of photons that pixels need which go on by ``plan`` from
        ``count`` to ``end``: each is for as many samples of all pixels as it has maps.
        """
        caustics = self.transport.caustics
        if caustics is None:
            return
        n = plan.n
        maps = caustics.maps(n)
        lacking = count < end
        least, most = dr.min(dr.select(lacking, count, end)), dr.max(end)
        for number in range(int(least[0]) // maps, -(-int(most[0]) // maps)):
            first, after = (dr.opaque(mi.UInt32, v * maps) for v in (number, number + 1))
            if dr.any((count < dr.minimum(end, after)) & (end > first)):
                yield plan.photon_seed, number, n

    def _take(self, x: mi.Int32, y: mi.Int32, start: Estimate, end: mi.UInt32, quiet: Quiet | None) -> Estimate:
        n = self.plan.n
        sampler = self.sampler and self._forked(self.sampler, dr.width(x), int(dr.max(end - start.count)[0]))

        # Which sample is next is no part of the state that Mitsuba's samplers give to a symbolic loop, but for the one
        # that does not count.
        evaluated = sampler is not None and sampler.class_name() != "IndependentSampler"

        def unfinished(estimate: Estimate) -> mi.Bool:
            active = estimate.count < end
            if quiet is not None:
                ended = (estimate.count % n == 0) & quiet(estimate.total, estimate.squares, estimate.count)
                active &= ~ended
            return active

        def step(
            estimate: Estimate, active: mi.Bool, sampler: mi.Sampler | None
        ) -> tuple[Estimate, mi.Bool, mi.Sampler | None]:
            t = estimate.count
            values, Y, position = self.sample(x, y, t, sampler)
            sums = [s + w * v for s, (w, v) in zip(estimate.sums, self.spread(values, position))]
            Y = dr.clip(dr.select(dr.abs(Y) > DARKEST, Y, 0), -BRIGHTEST, BRIGHTEST)
            in_pass = estimate.in_pass + Y
            if sampler is not None:
                sampler.advance()
                if evaluated:
                    sampler.schedule_state()  # else the kernel of each sample would count up to it
            last = (t + 1) % n == 0
            estimate = Estimate(
                sums,
                estimate.total + Y,
                estimate.squares + dr.square(Y),
                estimate.pass_squares + dr.select(last, dr.square(in_pass / n), 0),
                dr.select(last, 0, in_pass),
                t + 1,
            )
            return estimate, unfinished(estimate), sampler

        estimate, *_ = dr.while_loop(
            (start, unfinished(start), sampler),
            lambda estimate, active, sampler: active,
            step,
            labels=("estimate", "active", "sampler"),
            mode="evaluated" if evaluated else None,
            max_iterations=-1,
        )
        return estimate

    def _forked(self, sampler: mi.Sampler, lanes: int, samples: int) -> mi.Sampler:
        """A sampler for so many pixels, seeded anew, of whose patterns exactly so many samples are taken: Mitsuba's
        permutations are not even in their beginnings alone.
        """
        sampler = sampler.fork()
        sampler.set_sample_count(samples)
        self.seeded += 1
        sampler.seed(combine(hash32(int(self.plan.seed[0])), self.seeded), lanes)
        return sampler
