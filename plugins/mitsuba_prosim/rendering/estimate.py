"""Samples of pixels, summed: what an image grows from (section 5.3.2)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

from ..sampling.nrook import NRook
from ..transport.stage import LENS, PIXEL, TIME_AND_WAVELENGTH
from ..transport.transport import Transport
from .error import error_between_passes, standard_error
from .film import Channels
from .plan import Plan

if TYPE_CHECKING:
    from .camera import RaySampler

#: A sample counts as no brighter than this in what is said of the error: the squares of N² samples stay finite.
BRIGHTEST = 1e16


@dataclass
class Estimate:
    """Sums over the samples of each pixel: Dr.Jit arrays with one entry a pixel."""

    #: The film's values, weighted by its filter, for every pixel within the filter's reach, row by row, channel by
    #: channel.
    sums: list[mi.Float]
    #: Sums of the luminance, of its square, and of the square of its mean over each pass.
    total: mi.Float
    squares: mi.Float
    pass_squares: mi.Float
    #: Number of samples.
    count: mi.UInt32

    def add(self, more: Estimate, where: mi.UInt32) -> None:
        """Adds ``more``, whose entries are those with the indices ``where`` here, each at most once."""
        mine, theirs = ([*e.sums, e.total, e.squares, e.pass_squares, e.count] for e in (self, more))
        for total, part in zip(mine, theirs):
            dr.scatter_add(total, part, where, mode=dr.ReduceMode.NoConflicts)

    def error(self, n: int) -> mi.Float:
        """Standard error of the mean luminance: between passes (of ``n`` samples) where there are two or more, all
        whole.
        """
        count = mi.Float(self.count)
        passes = count / n
        between = error_between_passes(self.total / n, self.pass_squares, passes)
        whole = (self.count > n) & (self.count % n == 0)
        return dr.select(whole, between, standard_error(self.total, self.squares, count))


class Estimator:
    """Takes samples: from the camera through the scene to the film's values."""

    def __init__(
        self, plan: Plan, scene: mi.Scene, sensor: mi.Sensor, transport: Transport, channels: Channels
    ) -> None:
        self.plan, self.scene, self.sensor, self.transport, self.channels = plan, scene, sensor, transport, channels
        #: What :func:`.camera.ray_sampler` returns, to be set where the sensor is :func:`.camera.uncropped`.
        self.rays: RaySampler | None = None
        width, height = (int(v) for v in sensor.film().size())
        self.rfilter = sensor.film().rfilter()
        self.inverse_size = mi.Vector2f(dr.opaque(mi.Float, 1 / width), dr.opaque(mi.Float, 1 / height))

    def camera_ray(self, x: mi.Int32, y: mi.Int32, points: NRook) -> tuple[mi.Ray3f, mi.Spectrum, mi.Point2f]:
        """Camera ray through pixel (x, y): ``(ray, weight, position)``, the position being that within the pixel."""
        position = points(PIXEL)
        lens = points(LENS) if self.sensor.needs_aperture_sample() else mi.Point2f(0.5)
        moving = self.sensor.shutter_open_time() > 0
        other = points(TIME_AND_WAVELENGTH) if moving or mi.is_spectral else mi.Point2f(0.5)
        time = mi.Float(self.sensor.shutter_open())
        if moving:
            time += other.x * self.sensor.shutter_open_time()
        on_film = (mi.Point2f(mi.Float(x), mi.Float(y)) + position) * self.inverse_size
        assert self.rays is not None
        ray, weight = self.rays(time, other.y, on_film, lens)
        return ray, weight, position

    def sample(
        self, x: mi.Int32, y: mi.Int32, r: mi.UInt32, i: mi.UInt32
    ) -> tuple[list[mi.Float], mi.Float, mi.Point2f]:
        """Sample ``i`` of pass ``r`` in the pixels (x, y): ``(values, luminance, position)``, ``values`` being what the
        film stores for a sample of weight 1.
        """
        points = self.plan.points(x, y, r, i)
        ray, weight, position = self.camera_ray(x, y, points)
        L, hit = self.transport(ray, points, True)
        L *= weight
        # A direction at grazing incidence can overflow; one such sample must not blacken its pixel.
        L = dr.select(dr.all(dr.isfinite(L)), L, 0)
        values = self.channels.values(self.scene, self.sensor.sampler(), ray, L, dr.select(hit, mi.Float(1), 0))
        return values, mi.luminance(L, ray.wavelengths), position

    def spread(self, values: list[mi.Float], position: mi.Point2f) -> list[tuple[mi.Float, mi.Float]]:
        """``(weight, value)`` for each pixel within the filter's reach, row by row, and each value."""
        reach = self.plan.reach
        if self.rfilter.is_box_filter():
            return [(mi.Float(1), v) for v in values]
        offsets = range(-reach, reach + 1)
        across = [self.rfilter.eval(k + 0.5 - position.x) for k in offsets]
        down = [self.rfilter.eval(k + 0.5 - position.y) for k in offsets]
        return [(wx * wy, v) for wy in down for wx in across for v in values]

    def take(
        self,
        x: mi.Int32,
        y: mi.Int32,
        begin: int,
        end: int,
        quiet: Callable[[mi.Float, mi.Float, mi.UInt32], mi.Bool] | None = None,
    ) -> Estimate:
        """Takes the samples ``begin`` .. ``end`` - 1 (integers) of the pixels (x, y), one lane a pixel.

        ``quiet(total, squares, t)``, if given, says after each pass which pixels end, ``t`` being the number of
        samples.
        """
        n, reach = self.plan.n, self.plan.reach
        end = dr.opaque(mi.UInt32, end)

        def step(
            t: mi.UInt32, estimate: Estimate, in_pass: mi.Float, active: mi.Bool
        ) -> tuple[mi.UInt32, Estimate, mi.Float, mi.Bool]:
            r = t // n
            i = t - r * n
            values, luminance, position = self.sample(x, y, r, i)
            sums = [s + w * v for s, (w, v) in zip(estimate.sums, self.spread(values, position))]
            luminance = dr.clip(luminance, -BRIGHTEST, BRIGHTEST)
            total, squares = estimate.total + luminance, estimate.squares + dr.square(luminance)
            in_pass = in_pass + luminance
            last = i + 1 == n
            pass_squares = estimate.pass_squares + dr.select(last, dr.square(in_pass / n), 0)
            in_pass = dr.select(last, 0, in_pass)
            t += 1
            active = t < end
            if quiet is not None:
                active &= ~(last & quiet(total, squares, t))
            return t, Estimate(sums, total, squares, pass_squares, t), in_pass, active

        begin = dr.opaque(mi.UInt32, begin)
        zeros = [mi.Float(0) for _ in range(len(self.channels.names) * (2 * reach + 1) ** 2)]
        state = (
            mi.UInt32(begin),
            Estimate(zeros, mi.Float(0), mi.Float(0), mi.Float(0), mi.UInt32(begin)),
            mi.Float(0),
            dr.full(mi.Bool, True, dr.width(x)),
        )
        _, estimate, _, _ = dr.while_loop(
            state,
            lambda t, estimate, in_pass, active: active,
            step,
            labels=("t", "estimate", "in_pass", "active"),
            max_iterations=-1,
        )
        estimate.count = estimate.count - begin
        return estimate
