"""Extended source: prosim_area."""

from __future__ import annotations

from contextlib import suppress

import drjit as dr
import mitsuba as mi

from ..compat import SPHERE, object_transform
from ..light.emitter_methods import has_area, has_points, no_sample, sample_point, sample_shape
from ..light.source import Source
from ..registry import plugin


@plugin("emitter", "prosim_area")
class Area(Source):
    r"""
    .. _emitter-prosim_area:

    Extended source (:monosp:`prosim_area`)
    ---------------------------------------

    .. pluginparameters::

     * - radiance
       - |spectrum| or |texture|
       - Emitted radiance on the axis, >= 0, in power per unit area and unit solid angle. (Default: 1)
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
       - Whether ``radiance`` is the irradiance E on a surface that faces the source at *any* distance, as in renderers
         of 1992. (Default: false)

    The extended sources of section 5.2 of the thesis. The emitter is attached to a shape, and the outer side of the
    shape emits. The shape is a sphere in the thesis; here it may be any shape of Mitsuba. Each point of the source has
    the angular distribution about the same axis, so a receiver near the edge of a cone sees only a part of the source.
    With only a radiance, this is Mitsuba's :ref:`area <emitter-area>`.

    A sphere is sampled over the solid angle that it subtends (thesis, section 4.2.2.1). Other shapes are sampled by
    their own method, independent of a texture, so a bitmap with few bright points has less noise in :monosp:`area`.
    Mitsuba cannot sample curves, ellipsoids, :monosp:`sdfgrid` and the texture :monosp:`mesh_attribute`: only rays that
    meet such a source find its light, so that a ray tree loses its light on diffuse surfaces, with a warning, and
    particle tracing raises an error. For an unoccluded, uniform sphere of radius r at distance d, wholly above the
    horizon, the irradiance is exactly :math:`\pi L (r/d)^2 \cos \theta`.

    On a mesh whose vertex normals are tilted against its triangles, light sampling loses light, as with Mitsuba's
    :monosp:`area`: a warning names the shape.

    An unattenuated source has the radiance :math:`4 E d^2 / A` for a receiver at distance d of its centre, where A is
    the area of the shape (:math:`E d^2 / \pi r^2` for a sphere). As the radiance depends on the receiver, such a source
    has no power: particle tracing (:monosp:`ptracer`) raises an error. If a ray has passed through a surface without
    effect (a mask, the boundary of a medium), this surface is the receiver.

    The derivatives with respect to ``direction`` and ``angle`` are those inside the beam: Mitsuba's integrators do not
    differentiate the discontinuity at the edge of the beam. Those of an unattenuated mesh by its vertices lack the
    change of its distance and of its area.

    .. tabs::
        .. code-tab:: xml

            <shape type="sphere">
                <point name="center" x="0" y="5" z="0"/>
                <float name="radius" value="0.5"/>
                <emitter type="prosim_area">
                    <rgb name="radiance" value="20, 18, 15"/>
                    <string name="distribution" value="cone"/>
                    <vector name="direction" x="0" y="-1" z="0"/>
                    <float name="angle" value="30"/>
                </emitter>
            </shape>

        .. code-tab:: python

            'type': 'sphere',
            'center': [0, 5, 0],
            'radius': 0.5,
            'emitter': {
                'type': 'prosim_area',
                'radiance': {
                    'type': 'rgb',
                    'value': [20, 18, 15]
                },
                'distribution': 'cone',
                'direction': [0, -1, 0],
                'angle': 30
            }
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props, "radiance", "that of the shape")
        varies = self.emission.is_spatially_varying()
        self.m_flags = mi.EmitterFlags.Surface | (mi.EmitterFlags.SpatiallyVarying if varies else 0)
        self._has_points: bool | None = None

    def parameters_changed(self, keys: list[str]) -> None:
        self._has_points = None  # Mitsuba calls this also when the shape has changed
        super().parameters_changed(keys)

    def can_be_sampled(self) -> bool:
        """Tells whether the emitter has a shape, and :func:`.has_points`; it does not examine the shape in each trace,
        where a garbage collection would be fatal (:mod:`..alone`).
        """
        if self._has_points is None and self.get_shape() is not None:
            self._has_points = has_points(self)
        return bool(self._has_points)

    def emitted(
        self, si: mi.SurfaceInteraction3f, d: mi.Vector3f, receiver: mi.Point3f, active: mi.Bool
    ) -> mi.Spectrum:
        """Returns the radiance from the point ``si`` in the direction ``d``, in world coordinates; that of an
        ``unattenuated`` source grows with the squared distance of ``receiver`` from the centre of the shape.
        """
        value = self.emission.eval(si, active) * self.relative_intensity(d)
        if self.unattenuated and (shape := self.get_shape()) is not None:
            if not has_area(shape):
                allowed = "a shape whose area Mitsuba knows: no curve, ellipsoids or sdfgrid"
                raise RuntimeError(f"{self.id()} (prosim_area): an unattenuated source needs {allowed}.")
            center = mi.Point3f(shape.bbox().center())  # without derivatives
            with suppress(KeyError):  # a mesh has no transform
                if dr.grad_enabled(to_world := object_transform(shape)):
                    center = to_world @ (dr.detach(to_world).inverse() @ center)
            value *= 4 * dr.squared_norm(receiver - center) / shape.surface_area()
        return dr.select(active, mi.depolarizer(value), mi.Spectrum(0))

    def eval(self, si: mi.SurfaceInteraction3f, active: mi.Bool = True) -> mi.Spectrum:
        """Returns the radiance at the point ``si`` in the direction ``si.wi``; 0 on the inner side of the shape."""
        active = active & (si.wi.z > 0) & si.is_valid()
        d = si.to_world(si.wi)  # to the receiver, which is at the distance si.t
        return self.emitted(si, d, si.p + d * dr.select(active, si.t, 0), active)

    def eval_direction(self, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Bool = True) -> mi.Spectrum:
        si = mi.SurfaceInteraction3f(ds, it.wavelengths)
        si.wi = si.to_local(-ds.d)  # a texture in Python may depend on the direction
        return self.emitted(si, -ds.d, it.p, active & (dr.dot(ds.d, ds.n) < 0))

    def sample_direction(
        self, it: mi.Interaction3f, sample: mi.Point2f, active: mi.Bool = True
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """Samples a point of the light source, as seen from ``it``; returns ``(ds, weight)``, where ``weight`` is
        radiance / ``ds.pdf``, per solid angle. Both are 0 if the point faces away, or nothing can sample it.
        """
        # Dr.Jit traces every emitter that exists, also an emitter without a shape.
        if not self.can_be_sampled():
            return no_sample(mi.DirectionSample3f), mi.Spectrum(0)
        varies = mi.has_flag(self.m_flags, mi.EmitterFlags.SpatiallyVarying)
        ds = sample_shape(self.get_shape(), it, sample, active, varies)
        ds.pdf = self.pdf_shape(it, ds.pdf)
        active = active & (dr.dot(ds.d, ds.n) < 0) & (ds.pdf > 0)
        ds.pdf = dr.select(active, ds.pdf, 0)
        ds.emitter = mi.EmitterPtr(self) if dr.is_jit_v(mi.Float) else self
        return ds, self.eval_direction(it, ds, active) / dr.select(active, ds.pdf, 1)

    def pdf_direction(self, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Bool = True) -> mi.Float:
        if not self.can_be_sampled():
            return mi.Float(0)
        active = active & (dr.dot(ds.d, ds.n) < 0)
        return dr.select(active, self.pdf_shape(it, self.get_shape().pdf_direction(it, ds, active)), mi.Float(0))

    def pdf_shape(self, it: mi.Interaction3f, pdf: mi.Float) -> mi.Float:
        """Corrects ``pdf``, Mitsuba's density of `Shape.sample_direction`, for a small or distant sphere.

        Mitsuba's density for a sphere of radius r at the distance d has an error of 1 % at r/d = 0.001, because 1 - cos
        of the half-angle loses digits; here it is sin² / (1 + cos), where sin² = (r/d)² is below 0.9.
        """
        shape = self.get_shape()
        if shape.class_name() != SPHERE or shape.has_flipped_normals():
            return pdf
        r2 = shape.surface_area() / (4 * dr.pi)
        # The point of ``ds`` is not used: a direction that moves with the sphere has none (:mod:`..light.strategy`).
        center = object_transform(shape) @ mi.Point3f(0)
        sin2 = r2 / dr.maximum(dr.squared_norm(center - it.p), 1e-30)
        cap = (1 + dr.safe_sqrt(1 - sin2)) / (dr.two_pi * dr.maximum(sin2, 1e-30))
        return dr.select((sin2 < 0.9) & (pdf > 0), cap, pdf)

    def sample_position(
        self, time: mi.Float, sample: mi.Point2f, active: mi.Bool = True
    ) -> tuple[mi.PositionSample3f, mi.Float]:
        """Samples a point; returns it, and 1 divided by its density per area, or 0 if nothing can sample the points."""
        if not self.can_be_sampled():
            return no_sample(mi.PositionSample3f), mi.Float(0)
        ps = sample_point(self.get_shape(), time, sample, active)
        return ps, dr.select(active & (ps.pdf > 0), 1 / dr.maximum(ps.pdf, 1e-30), mi.Float(0))

    def sample_ray(
        self, time: mi.Float, sample1: mi.Float, sample2: mi.Point2f, sample3: mi.Point2f, active: mi.Bool = True
    ) -> tuple[mi.Ray3f, mi.Spectrum]:
        """Samples an emitted ray; returns ``(ray, weight)``: the radiance times the cosine at the source, divided by
        the densities of the point, the direction and the wavelengths. Raises RuntimeError if the source is
        ``unattenuated``, or nothing can sample its points.
        """
        self._require_rays()
        ps, weight = self.sample_position(time, sample2, active)
        si = mi.SurfaceInteraction3f(ps, dr.zeros(mi.Interaction3f).wavelengths)
        si.time = time
        if self.uniform:
            d = si.to_world(mi.warp.square_to_cosine_hemisphere(sample3))
            weight *= dr.pi
        else:  # the beam may be much narrower than the hemisphere
            d, total = self.sample_beam(sample3)
            weight *= total * dr.maximum(dr.dot(d, ps.n), 0)
        si.wavelengths, spectrum = super().sample_wavelengths(si, sample1, active)
        return si.spawn_ray(d), mi.depolarizer(spectrum * weight)

    def sample_wavelengths(
        self, si: mi.SurfaceInteraction3f, sample: mi.Float, active: mi.Bool = True
    ) -> tuple[mi.Color0f, mi.Spectrum]:
        """Samples wavelengths; returns them, and the radiance in the direction ``si.wi``, divided by their density.
        Raises RuntimeError as :meth:`sample_ray`.
        """
        self._require_rays()
        wavelengths, weight = super().sample_wavelengths(si, sample, active)
        # Only the particle tracer calls this; its si.wi is the direction to the camera, in world coordinates.
        return wavelengths, weight * self.relative_intensity(si.wi)

    def _require_rays(self) -> None:
        """Raises RuntimeError if the source is ``unattenuated``, or if nothing can sample its points."""
        if self.unattenuated:
            raise RuntimeError(f"{self.id()} (prosim_area): with unattenuated, rays have no power; leave it out.")
        if self.get_shape() is not None and not self.can_be_sampled():
            raise RuntimeError(
                f"{self.id()} (prosim_area): Mitsuba cannot sample the points of this shape or texture (curves, "
                "ellipsoids, sdfgrid, mesh_attribute), so the source has no rays. Use another shape or texture."
            )

    def bbox(self) -> mi.ScalarBoundingBox3f:
        return self.get_shape().bbox()
