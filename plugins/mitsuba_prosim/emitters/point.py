"""Point source: prosim_point."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..compat import box_of_point
from ..light.source import Source
from ..parameters import expose, reject, vector
from ..registry import plugin


@plugin("emitter", "prosim_point")
class Point(Source):
    r"""
    .. _emitter-prosim_point:

    Point source (:monosp:`prosim_point`)
    -------------------------------------

    .. pluginparameters::

     * - position
       - |point|
       - Position of the source in world coordinates. (Default: the origin)
       - |exposed|

     * - intensity
       - |spectrum|
       - Radiant intensity on the axis, >= 0, in power per unit solid angle. (Default: 1)
       - |exposed|, |differentiable|

     * - distribution
       - |string|
       - :monosp:`uniform` (the same in every direction), :monosp:`cone` (the same within ``angle`` of ``direction``,
         else 0) or :monosp:`spot` (:math:`\cos^n \beta` at the angle :math:`\beta` from ``direction``).
         (Default: :monosp:`uniform`)

     * - direction
       - |vector|
       - Axis of a cone or spot, in world coordinates and of any length. (Default: 0, -1, 0)
       - |exposed|, |differentiable|, |discontinuous|

     * - angle
       - |float|
       - Half-opening of a cone in degrees, > 0 and <= 180; or the angle at which a spot is cut off, <= 90. (Default:
         required for a cone, 90 for a spot)
       - |exposed|, |differentiable|, |discontinuous|

     * - exponent
       - |float|
       - Concentration n >= 0 of a spot. (Default: required)
       - |exposed|, |differentiable|

     * - unattenuated
       - |bool|
       - Whether ``intensity`` is the irradiance on a surface that faces the source at *any* distance, as in renderers
         of 1992. (Default: false)

    The point sources of section 5.2 of the thesis. With only an intensity, this is Mitsuba's
    :ref:`point <emitter-point>`. A small sphere of radius r and radiance L has the intensity :math:`\pi r^2 L`. The
    derivatives with respect to ``direction`` and ``angle`` are those inside the beam: Mitsuba's integrators do not
    differentiate the discontinuity at the edge of the beam. An unattenuated source does not conserve energy and has no
    power: particle tracing (:monosp:`ptracer`) raises an error.

    .. tabs::
        .. code-tab:: xml

            <emitter type="prosim_point">
                <point name="position" x="0" y="5" z="0"/>
                <rgb name="intensity" value="20, 18, 15"/>
                <string name="distribution" value="spot"/>
                <vector name="direction" x="0" y="-1" z="0"/>
                <float name="exponent" value="8"/>
                <float name="angle" value="30"/>
            </emitter>

        .. code-tab:: python

            'type': 'prosim_point',
            'position': [0, 5, 0],
            'intensity': {
                'type': 'rgb',
                'value': [20, 18, 15]
            },
            'distribution': 'spot',
            'direction': [0, -1, 0],
            'exponent': 8,
            'angle': 30
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props, "intensity", '"position" and "direction"')
        self.position = mi.Point3f(vector(props, "position", (0, 0, 0), "finite coordinates"))
        if self.emission.is_spatially_varying():
            raise reject(props, "intensity", "a texture", "a colour, a spectrum or a number")
        dr.make_opaque(self.position)
        self.m_flags = mi.EmitterFlags.DeltaPosition
        self.m_needs_sample_2 = False

    def traverse(self, callback: mi.TraversalCallback) -> None:
        super().traverse(callback)
        expose(callback, mi.ParamFlags.NonDifferentiable, position=self.position)

    def sample_ray(
        self, time: mi.Float, sample1: mi.Float, sample2: mi.Point2f, sample3: mi.Point2f, active: mi.Bool = True
    ) -> tuple[mi.Ray3f, mi.Spectrum]:
        """Samples an emitted ray; returns ``(ray, weight)``; ``weight`` is intensity / densities of direction and
        wavelengths. Raises RuntimeError if the source is ``unattenuated``.
        """
        if self.unattenuated:
            raise RuntimeError(f"{self.id()} (prosim_point): with unattenuated, rays have no power; leave it out.")
        d, total = self.sample_beam(sample3)
        wavelengths, weight = self.sample_wavelengths(dr.zeros(mi.SurfaceInteraction3f), sample1, active)
        return mi.Ray3f(self.position, d, time, wavelengths), mi.depolarizer(weight * total)

    def sample_direction(
        self, it: mi.Interaction3f, sample: mi.Point2f, active: mi.Bool = True
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """Returns ``(ds, weight)``: the direction from ``it`` to the source, and :meth:`eval_direction`."""
        ds = mi.DirectionSample3f(self.sample_position(it.time, sample, active)[0])
        ds.emitter = mi.EmitterPtr(self) if dr.is_jit_v(mi.Float) else self
        ds.d = ds.p - it.p
        ds.dist = dr.norm(ds.d)
        ds.d /= dr.maximum(ds.dist, 1e-30)
        return ds, self.eval_direction(it, ds, active)

    def pdf_direction(self, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Bool = True) -> mi.Float:
        return mi.Float(0)

    def eval_direction(self, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Bool = True) -> mi.Spectrum:
        """Returns the irradiance at ``it``, on a surface that faces the source: the intensity, divided by the squared
        distance unless the source is ``unattenuated``.
        """
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.wavelengths = it.wavelengths
        value = self.emission.eval(si, active) * self.relative_intensity(-ds.d)
        if not self.unattenuated:
            value /= dr.maximum(dr.squared_norm(ds.p - it.p), 1e-30)
        return mi.depolarizer(value)

    def sample_position(
        self, time: mi.Float, sample: mi.Point2f, active: mi.Bool = True
    ) -> tuple[mi.PositionSample3f, mi.Float]:
        ps = mi.PositionSample3f()
        ps.p, ps.n, ps.uv = self.position, mi.Normal3f(0), mi.Point2f(0)
        ps.time = time
        ps.pdf = mi.Float(1)
        ps.delta = mi.Bool(True)
        return ps, mi.Float(1)

    def eval(self, si: mi.SurfaceInteraction3f, active: mi.Bool = True) -> mi.Spectrum:
        return mi.Spectrum(0)

    def bbox(self) -> mi.ScalarBoundingBox3f:
        return box_of_point(mi.ScalarPoint3f(*(dr.slice(self.position[i], 0) for i in range(3))))

    def parameters(self) -> dict[str, Any]:
        return {"position": self.position, **super().parameters()}
