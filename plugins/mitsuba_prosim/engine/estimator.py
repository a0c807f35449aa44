"""Takes samples of pixels: samples camera rays, and computes the film's values for the rays (thesis, section 5.3.2)."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compat import double
from ..sampling import wavelengths
from ..sampling.hash import combine
from ..sampling.nrook import NRook
from ..sampling.sobol import Sobol
from ..sampling.spaces import LENS, PIXEL, TIME_AND_WAVELENGTH
from ..transport.transport import RadianceEstimator
from .accumulators import BRIGHTEST, DARKEST, Accumulators
from .camera import ray_sampler, samples_of
from .channels import Channels, aov_values, luminance
from .plan import Plan


class Estimator:
    """Takes samples of ``scene`` for ``sensor``, whose film it prepares; ``transport`` estimates radiance."""

    def __init__(self, scene: mi.Scene, sensor: mi.Sensor, transport: RadianceEstimator, channels: Channels) -> None:
        self.scene, self.sensor, self.transport, self.channels = scene, sensor, transport, channels
        # The channel names may depend on the scene. A specfilm that is not prepared ends the process.
        sensor.film().prepare(self.channels.aov_names)
        self.rays = ray_sampler(sensor)
        self.rfilter = sensor.film().rfilter()
        self.reach = self.rfilter.border_size()
        self.inverse_size = mi.Vector2f(*(dr.opaque(mi.Float, 1 / int(size)) for size in sensor.film().size()))

    @property
    def sums_per_pixel(self) -> int:
        """Number of sums that a pixel stores: one for each channel and each pixel within the filter's radius."""
        return len(self.channels.names) * (2 * self.reach + 1) ** 2

    def camera_ray(self, x: mi.Int32, y: mi.Int32, points: NRook | Sobol) -> tuple[mi.Ray3f, mi.Spectrum, mi.Point2f]:
        """Returns ``(ray, weight, position)`` for a camera ray through the pixel (x, y).

        ``position`` is the point of the film through which the ray goes, relative to the pixel's upper left corner, in
        [0, 1)². ``points`` gives the random numbers of the sample (:meth:`.Plan.points`). The point on the
        lens is constant if the sensor has no aperture; the time is constant if the shutter interval is empty.
        """
        position = points(PIXEL)
        lens = points(LENS) if self.sensor.needs_aperture_sample() else mi.Point2f(0.5)
        time = mi.Float(self.sensor.shutter_open())
        if self.sensor.shutter_open_time() > 0:
            time += points(TIME_AND_WAVELENGTH).x * self.sensor.shutter_open_time()
        wavelength = self._wavelength(points) if mi.is_spectral else mi.Float(0.5)
        on_film = (mi.Point2f(mi.Float(x), mi.Float(y)) + position) * self.inverse_size
        with samples_of(self.sensor, x):
            ray, weight = self.rays(time, wavelength, on_film, lens)
        return ray, weight, position

    def _wavelength(self, points: NRook | Sobol) -> mi.Float:
        """Returns the number in [0, 1) by which the sensor samples wavelengths.

        With caustics, the ``t``-th samples of all pixels and the photons that they gather have the same wavelengths, so
        the number is the same for all pixels. Without caustics, different pixels have different numbers. Within a pass,
        the number for the wavelengths rises with the index of the sample (modulo 1). The number for the wavelengths is
        not correlated with the other dimensions of a sample, because the other dimensions are shuffled.
        """
        caustics = self.transport.caustics
        key = combine(points.key, TIME_AND_WAVELENGTH) if caustics is None else caustics.key
        return wavelengths.wavelength_number(key, *points.division)

    def sample(self, plan: Plan, x: mi.Int32, y: mi.Int32, t: mi.UInt32) -> tuple[list[mi.Float], mi.Float, mi.Point2f]:
        """Takes the ``t``-th sample of the pixels (x, y), and returns ``(values, luminance, position)``.

        ``values`` are the sample's values of the channels ``channels.names``, not yet multiplied by the weights of the
        reconstruction filter; absolute values below :data:`.DARKEST` become 0. ``luminance`` is the luminance of the
        sample's radiance, or the mean of the bands of a special film, which need not be visible. A sample whose
        radiance is infinite or NaN is black, and its ``luminance`` is NaN. ``position`` is the position of the sample,
        relative to the pixel's upper left corner, in [0, 1)².
        """
        points = plan.points(x, y, t)
        # The t-th sample has the same wavelengths as its photons, even if ``points`` has another index: a shared one.
        if self.transport.caustics is not None:
            points.division = t, self.transport.caustics.n
        ray, weight, position = self.camera_ray(x, y, points)
        # As Mitsuba scales them, by the number of samples of a noisy pixel: that of a single pixel is not known yet.
        ray.scale_differential(dr.opaque(mi.Float, plan.noisy_samples**-0.5))
        L, alpha, others = self.transport(ray, points, True)
        L *= weight
        # A direction at grazing incidence can overflow. One such sample must not make its pixel black.
        finite = dr.all(dr.isfinite(L))
        L = dr.select(finite, L, 0)
        if self.transport.has_layers:
            layers = [dr.select(finite, layer * weight, 0) for layer in others]
            others = [value for layer in layers for value in self.channels.rgb(layer, ray.wavelengths)]
        values = self.channels.values(L, ray.wavelengths, alpha)
        Y = self.channels.luminance(values) if self.channels.special else luminance(L, ray.wavelengths)
        aovs = aov_values(self.channels.aovs, self.scene, self.sensor.sampler(), ray, True)
        # The derivative stays: that by the colour of something black is not 0.
        values = [dr.replace_grad(dr.select(dr.abs(v) < DARKEST, 0, v), v) for v in (*values, *others, *aovs)]
        return values, dr.select(finite, Y, dr.nan), position

    def weights(self, position: mi.Point2f, row: int | mi.Int32) -> list[mi.Float]:
        """Returns the filter weights of a sample at ``position``, for the pixels of one row around its own pixel.

        ``position`` is relative to the upper left corner of the sample's pixel. ``row`` is relative to the row of this
        pixel. For a box filter, the only weight is 1, that of the sample's own pixel.
        """
        if self.rfilter.is_box_filter():
            return [mi.Float(1)]
        down = self.rfilter.eval(row + 0.5 - position.y)
        return [self.rfilter.eval(k + 0.5 - position.x) * down for k in range(-self.reach, self.reach + 1)]

    def shares(self) -> np.ndarray:
        """Returns the weights of a typical sample, whose sum is 1, for all pixels around its own. On each axis, the
        sample is a quarter of a pixel from the centre of its pixel: the mean distance of a random sample.
        """
        rows = dr.arange(mi.Int32, -self.reach, self.reach + 1)
        weights = np.array(dr.concat(self.weights(mi.Point2f(0.25), rows)))
        return weights / weights.sum()

    def accumulate(
        self, plan: Plan, x: mi.Int32, y: mi.Int32, start: Accumulators, end: mi.UInt32, samples: int
    ) -> Accumulators:
        """Adds samples to the sums ``start`` of the pixels (x, y), and returns the new sums.

        Each pixel gets samples until it has ``end`` samples, ``samples`` for all pixels together. In the first kernel,
        each lane takes one sample; adjacent lanes take samples of the same pixel, because similar rays are traced
        faster. In the second kernel, each lane adds the samples of one pixel in the order of their numbers, to the sums
        for one row of the pixels within the filter's reach: a kernel with the sums of all rows would take long to
        compile. The result has one entry per lane of the second kernel. The luminance of a sample is limited to
        :data:`BRIGHTEST`; the film's sums are not limited.
        """
        # Dr.Jit shares equal expressions within a scope. In a scope of its own, a kernel does not depend on what was
        # traced before; else the second work item could compile another one.
        dr.detail.new_scope(dr.backend_v(mi.Float))
        n, Double = plan.n, double()
        brightest = BRIGHTEST if Double is mi.Float else BRIGHTEST**2
        first, pixel, t = lanes(start.count, end, samples)
        x, y, seed = dr.gather(tuple, (x, y, plan.seed), pixel)
        values, Y, position = self.sample(replace(plan, seed=seed), x, y, t)
        if self.rfilter.is_box_filter():
            position = mi.Point2f(0.5)  # so that the positions, which nothing needs, are not stored
        taken = values, dr.select(dr.isnan(Y), Y, dr.clip(Y, -brightest, brightest)), position
        dr.eval(taken)

        rows = 2 * self.reach + 1
        lane = dr.arange(mi.UInt32, rows * len(end))
        pixel, row = lane // rows, lane % rows
        first, begin, end = dr.gather(tuple, (first, start.count, end), pixel)

        def step(sums: Accumulators) -> tuple[Accumulators]:
            """Adds one sample to the sums of each lane."""
            values, Y, position = dr.gather(tuple, taken, first + (sums.count - begin))
            weights = self.weights(position, mi.Int32(row) - self.reach)
            lost = dr.isnan(Y)
            Y = dr.select(lost, 0, Double(Y))
            in_pass = sums.in_pass + Y
            last = (sums.count + 1) % n == 0
            sums = Accumulators(
                [s + w * v for s, (w, v) in zip(sums.sums, product(weights, values))],
                sums.total + Y,
                sums.squares + dr.square(Y),
                sums.pass_squares + dr.select(last, dr.square(in_pass / n), 0),
                dr.select(last, 0, in_pass),
                sums.count + 1,
                sums.lost + dr.select(lost, mi.UInt32(1), 0),
            )
            return (sums,)

        of_row = start.film_sums(pixel, row, self.sums_per_pixel // rows)
        sums = Accumulators(of_row, *dr.gather(tuple, start.others, pixel))
        return dr.while_loop((sums,), lambda sums: sums.count < end, step, labels=("sums",), max_iterations=-1)[0]


def lanes(begin: mi.UInt32, end: mi.UInt32, samples: int) -> tuple[mi.UInt32, mi.UInt32, mi.UInt32]:
    """Assigns a lane to each sample of several pixels: to those from number ``begin`` to ``end`` - 1 of each pixel.

    ``samples`` is the number of all these samples. Returns ``(first, pixel, t)``: the first lane of each pixel, and the
    pixel and the number of the sample of each lane. A pixel's lanes are adjacent.
    """
    first = dr.prefix_sum(end) - dr.prefix_sum(begin)  # modulo 2^32, as are the sums
    total = dr.opaque(mi.UInt32, samples)  # a constant would be a part of the kernel
    pixel = dr.zeros(mi.UInt32, samples)
    dr.scatter_add(pixel, 1, first, first < total, mode=dr.ReduceMode.Direct)
    dr.eval(first, pixel)  # in one kernel
    pixel = dr.cumsum(pixel) - 1
    before, begins = dr.gather(tuple, (first, begin), pixel)
    return first, pixel, dr.arange(mi.UInt32, samples) - before + begins
