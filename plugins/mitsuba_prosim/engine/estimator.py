"""Takes samples of pixels: samples camera rays, and computes the film's values for the rays (thesis, section 5.3.2)."""

from __future__ import annotations

from itertools import product

import drjit as dr
import mitsuba as mi

from ..compat import double
from ..sampling import wavelengths
from ..sampling.hash import combine
from ..sampling.nrook import NRook
from ..sampling.sobol import Sobol
from ..sampling.spaces import LENS, PIXEL, TIME_AND_WAVELENGTH
from ..transport.transport import RadianceEstimator
from .accumulators import BRIGHTEST, DARKEST, Accumulators
from .camera import ray_sampler
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
        reconstruction filter; absolute values below :data:`.DARKEST` become 0. ``luminance`` is the luminance
        of the sample's radiance. A radiance that is infinite or NaN becomes 0. ``position`` is the position of the
        sample, relative to the pixel's upper left corner, in [0, 1)².
        """
        points = plan.points(x, y, t)
        # The t-th sample has the same wavelengths as its photons, even if ``points`` has another index: a shared one.
        if self.transport.caustics is not None:
            points.division = t, self.transport.caustics.n
        ray, weight, position = self.camera_ray(x, y, points)
        L, alpha, others = self.transport(ray, points, True)
        L *= weight
        # A direction at grazing incidence can overflow. One such sample must not make its pixel black.
        finite = dr.all(dr.isfinite(L))
        L = dr.select(finite, L, 0)
        if self.transport.has_layers:
            layers = [dr.select(finite, layer * weight, 0) for layer in others]
            others = [value for layer in layers for value in self.channels.rgb(layer, ray.wavelengths)]
        values = self.channels.values(L, ray.wavelengths, alpha)
        aovs = aov_values(self.channels.aovs, self.scene, self.sensor.sampler(), ray, True)
        values = [dr.select(dr.abs(v) < DARKEST, 0, v) for v in (*values, *others, *aovs)]
        return values, luminance(L, ray.wavelengths), position

    def weights(self, position: mi.Point2f) -> list[mi.Float]:
        """Returns the filter weights of a sample at ``position``, for its own pixel and for the pixels around it.

        The weights are ordered row by row. ``position`` is relative to the upper left corner of the sample's pixel. For
        a box filter, the only weight is 1, that of the sample's own pixel.
        """
        if self.rfilter.is_box_filter():
            return [mi.Float(1)]
        offsets = range(-self.reach, self.reach + 1)
        across = [self.rfilter.eval(k + 0.5 - position.x) for k in offsets]
        down = [self.rfilter.eval(k + 0.5 - position.y) for k in offsets]
        return [wx * wy for wy in down for wx in across]

    def accumulate(self, plan: Plan, x: mi.Int32, y: mi.Int32, start: Accumulators, end: mi.UInt32) -> Accumulators:
        """Adds samples to the sums ``start`` of the pixels (x, y), and returns the new sums.

        A pixel gets samples until it has ``end`` samples, or until it has converged at the end of a pass by the
        criterion of the adaptive-sampling policy. A pixel to which this applies at once gets no sample. Each lane is
        one pixel.
        """
        n, policy, Double = plan.n, plan.policy, double()
        brightest = BRIGHTEST if Double is mi.Float else BRIGHTEST**2

        # ``end`` is not a part of the loop's state: Dr.Jit traces a loop twice if the body leaves a state variable
        # unchanged.
        def unfinished(sums: Accumulators) -> mi.Bool:
            """Returns the mask of the pixels that have fewer than ``end`` samples, and have not converged.

            A pixel can converge only when it has a whole number of passes, each with ``n`` samples.
            """
            converged = policy.converged(sums.total, sums.squares, sums.count)
            return (sums.count < end) & ~((sums.count % n == 0) & converged)

        def step(sums: Accumulators, active: mi.Bool) -> tuple[Accumulators, mi.Bool]:
            """Adds one sample to the sums of each pixel; returns the new sums and the mask :func:`unfinished`.

            The loop itself keeps the sums of pixels that are not ``active``. The luminance of a sample is limited to
            ``brightest``; the film's sums are not limited.
            """
            t = sums.count
            values, Y, position = self.sample(plan, x, y, t)
            filtered = [s + w * v for s, (w, v) in zip(sums.sums, product(self.weights(position), values))]
            Y = Double(dr.clip(Y, -brightest, brightest))
            in_pass = sums.in_pass + Y
            last = (t + 1) % n == 0
            sums = Accumulators(
                filtered,
                sums.total + Y,
                sums.squares + dr.square(Y),
                sums.pass_squares + dr.select(last, dr.square(in_pass / n), 0),
                dr.select(last, 0, in_pass),
                t + 1,
            )
            return sums, unfinished(sums)

        active = unfinished(start)
        # The order of a kernel's constants depends on what was traced before if the kernel has something to compute
        # before the loop. Then the second pass with a wide filter would compile another kernel.
        dr.eval(active)
        return dr.while_loop(
            (start, active), lambda sums, active: active, step, labels=("sums", "active"), max_iterations=-1
        )[0]
