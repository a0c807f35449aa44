"""Methods that sample the emitters of a scene, without errors of Mitsuba 3.9.

A method of an array of emitters is compiled for all emitters of the process. So one emitter that raises an error, such
as an ``area`` on a curve, would end the call for all others. :class:`EmitterMethods` calls the methods of the emitters
of one scene only.

An ``area`` with a texture samples texture coordinates, and looks for the point of the shape with these coordinates. So
it may lose light, for example on a mesh, where coordinates may be outside the unit square or belong to several points.
There :class:`EmitterMethods` samples the shape.

An ``envmap`` with ``mis_compensation`` samples only its bright parts, because the rays of a path find the others. So
half of its samples here are uniform over all directions, as are those of such a sky of users.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from typing import Any, TypeAlias

import drjit as dr
import mitsuba as mi

from .. import compat
from ..masks import but_not

#: One emitter, or a Dr.Jit array of emitters.
Emitter: TypeAlias = "mi.Emitter | mi.EmitterPtr"

#: Square root of the number of directions in which an ``envmap`` is examined.
PROBES = 32

#: How many times its mean weight the sample of an infinite emitter may have; more is found too seldom.
RARE = 100

#: Fraction of light that an emitter with tilted normals must lose to cause a warning.
MIN_TILT_LOSS = 0.01


def has_points(emitter: mi.Emitter) -> bool:
    """Tells whether points of ``emitter`` can be sampled: not where Mitsuba cannot sample the shape, or evaluates the
    radiance only where a ray meets it (``mesh_attribute``).

    The shape of an emitter on ``ellipsoidsmesh`` is None (Mitsuba 3.9).
    """
    shape = emitter.get_shape()
    if shape is None or not has_area(shape):
        return False
    return all(node.class_name() != compat.MESH_ATTRIBUTE for node in compat.exposed(emitter).hierarchy)


def has_area(shape: mi.Shape) -> bool:
    """Tells whether Mitsuba knows the area of ``shape``. Of other shapes, Mitsuba 3.9 cannot sample points."""
    try:
        area = shape.surface_area()
    except RuntimeError:
        return False
    if dr.flag(dr.JitFlag.FreezingScope):  # while dr.freeze records a function, only literals can be read
        return area.state != dr.VarState.Literal
    return bool(dr.all(area > 0))


def warn_of_unsampled(emitters: Iterable[mi.Emitter]) -> None:
    """Warns of surfaces that emit in many directions, but have no points to sample (:func:`has_points`)."""
    surface, single = mi.EmitterFlags.Surface, mi.EmitterFlags.DeltaDirection
    many = [e for e in emitters if mi.has_flag(e.flags(), surface) and not mi.has_flag(e.flags(), single)]
    compat.warn_of(
        (e for e in many if not has_points(e)),
        "{} do not light diffuse surfaces, because Mitsuba cannot sample their shape or texture (curves, ellipsoids, "
        "sdfgrid, mesh_attribute). Use another shape or texture, or diffuse_bounces = -1.",
    )


def warn_of_wrong_light(emitters: Collection[mi.Emitter]) -> None:
    """Warns of emitters that Mitsuba 3.9 samples wrongly. On a mesh with tilted vertex normals, Mitsuba computes the
    density of a point by these normals instead of the triangle's normal. In a sky whose transform has a scale, Mitsuba
    does not normalise directions.
    """
    skies = (e for e in emitters if mi.has_flag(e.flags(), mi.EmitterFlags.Infinite))
    compat.warn_of(
        filter(scales, skies),
        "the light of {} is wrong, because its to_world has a scale, perhaps by a rotation whose axis is not of length "
        "1: Mitsuba samples other light than it shows. Remove the scale.",
    )
    losses = {e: tilt_loss(e.get_shape()) for e in emitters if e.get_shape() is not None}
    if tilted := {e: loss for e, loss in losses.items() if loss > MIN_TILT_LOSS}:
        names = ", ".join(f"{compat.names_of([e])} (about {loss:.0%})" for e, loss in tilted.items())
        compat.warn(
            f"{names} may light too little: the vertex normals of these emitters are tilted against their "
            "triangles. Load the mesh with face_normals, or remove the vertex normals from its file."
        )


def scales(emitter: mi.Emitter) -> bool:
    """Tells whether the transform of ``emitter`` is no rotation and no reflection; False if it has no transform."""
    import numpy as np

    m = compat.linear_part(emitter)
    return bool(m.any()) and not np.allclose(m @ m.T, np.eye(3), atol=1e-3)


def tilt_loss(shape: mi.Shape) -> float:
    """Returns 1 - cos of the angle between the normal of a triangle and the mean normal of its corners, averaged over
    the area of the mesh; 0 for other shapes, and without vertex normals.
    """
    import numpy as np

    parameters, positions = compat.exposed(shape), compat.mesh_positions(shape)
    if positions is None or "vertex_normals" not in parameters or not len(parameters["vertex_normals"]):
        return 0.0
    faces = np.array(parameters["faces"]).reshape(-1, 3)
    normals = np.array(dr.detach(parameters["vertex_normals"]), dtype=float).reshape(-1, 3)[faces].sum(axis=1)
    a, b, c = positions[faces].transpose(1, 0, 2)
    areas = np.cross(b - a, c - a)
    lengths = np.maximum(np.linalg.norm(normals, axis=1), 1e-30)
    total = max(float(np.linalg.norm(areas, axis=1).sum()), 1e-30)
    return 1 - float(np.abs(np.sum(areas * normals, axis=1) / lengths).sum()) / total


def no_sample(kind: type) -> Any:
    """Returns a sample of the class ``kind`` with density 0."""
    sample = dr.zeros(kind) if dr.is_jit_v(mi.Float) else kind()
    sample.pdf = mi.Float(0)
    return sample


def is_own_sphere(emitter: mi.Emitter, it: mi.Interaction3f | mi.SurfaceInteraction3f) -> mi.Bool | bool:
    """Tells whether ``it`` is on ``emitter``, a sphere that emits outwards, and so does not light its own points.

    Where rounding puts such a point outside the sphere, Mitsuba 3.9 samples the point itself.
    """
    shape = emitter.get_shape()
    if shape is None or shape.class_name() != compat.SPHERE or shape.has_flipped_normals() or compat.is_users(emitter):
        return False  # a user's emitter may also emit inwards
    if not isinstance(it, mi.SurfaceInteraction3f):
        return False
    return it.shape == (mi.ShapePtr(shape) if dr.is_jit_v(mi.Float) else shape)


def sample_shape(
    shape: mi.Shape, it: mi.Interaction3f, sample: mi.Point2f, active: mi.Bool, with_uv: bool = True
) -> mi.DirectionSample3f:
    """Returns ``shape.sample_direction`` with the outer normal and, if ``with_uv``, with the texture coordinates, which
    Mitsuba 3.9 leaves out for a sphere.
    """
    ds = shape.sample_direction(it, sample, active)
    if with_uv and shape.class_name() == compat.SPHERE:
        ds.uv = shape.ray_intersect(mi.Ray3f(it.p, ds.d), +mi.RayFlags.All, active).uv
    ds.n = compat.outer_normal(shape, ds.p, ds.n)
    return ds


def sample_point(shape: mi.Shape, time: mi.Float, sample: mi.Point2f, active: mi.Bool) -> mi.PositionSample3f:
    """Returns ``shape.sample_position`` with the outer normal."""
    ps = shape.sample_position(time, sample, active)
    ps.n = compat.outer_normal(shape, ps.p, ps.n)
    return ps


def omits_directions(emitter: mi.Emitter) -> bool:
    """Tells whether ``emitter``, an ``envmap`` or an infinite one of a user, does not sample all directions in which it
    shines (``mis_compensation``), or some so seldom that their samples have :data:`RARE` times its mean weight.
    """
    infinite = mi.has_flag(emitter.flags(), mi.EmitterFlags.Infinite) and not mi.has_flag(
        emitter.flags(), mi.EmitterFlags.DeltaDirection
    )
    if emitter.class_name() != compat.ENVMAP and not (infinite and compat.is_users(emitter)):
        return False

    def probe(i: mi.UInt32) -> tuple[mi.Float, mi.Float]:
        si, ds = dr.zeros(mi.SurfaceInteraction3f), no_sample(mi.DirectionSample3f)
        row = dr.floor(mi.Float(i) / PROBES)
        point = (mi.Point2f(mi.Float(i) - row * PROBES, row) + 0.5) / PROBES
        ds.d = mi.warp.square_to_uniform_sphere(point)
        si.wi = -ds.d
        if mi.is_spectral:
            si.wavelengths += 550
        radiance = dr.max(mi.unpolarized_spectrum(mi.Spectrum(emitter.eval(si, mi.Bool(True)))))
        return radiance, mi.Float(emitter.pdf_direction(si, ds, mi.Bool(True)))

    if dr.is_jit_v(mi.Float):
        radiance, pdf = probe(dr.arange(mi.UInt32, PROBES**2))
        return bool(dr.any((radiance > 0) & (pdf * (RARE * 4 * dr.pi) * dr.mean(radiance) < radiance)))
    values = [probe(i) for i in range(PROBES**2)]
    least = RARE * 4 * dr.pi * sum(radiance for radiance, _ in values) / len(values)
    return any(radiance > 0 and pdf * least < radiance for radiance, pdf in values)


def loses_light(area: mi.Emitter) -> bool:
    """Tells whether Mitsuba's ``area`` cannot sample its shape, or may not reach all points of its texture."""
    if not has_points(area) or compat.is_mirrored_cylinder(area.get_shape()):
        return True
    if not mi.has_flag(area.flags(), mi.EmitterFlags.SpatiallyVarying):
        return False
    return not compat.has_unique_uv(area.get_shape()) or compat.samples_elsewhere(compat.exposed(area), "radiance.")


def _is_sampled_by_shape(emitter: mi.Emitter) -> bool:
    if emitter.class_name() != compat.AREA:
        return False
    return not mi.has_flag(emitter.flags(), mi.EmitterFlags.SpatiallyVarying) or loses_light(emitter)


class EmitterMethods:
    """Samples the ``emitters`` of a scene, given one of them or a Dr.Jit array.

    Other emitters, and surfaces for which :func:`has_points` is false, have samples and densities of 0.
    """

    def __init__(self, emitters: Iterable[mi.Emitter]) -> None:
        #: The object that samples each emitter, which is the emitter or its shape.
        self.samplers: dict[mi.Emitter, mi.Emitter | mi.Shape] = {}
        for one in emitters:
            if not mi.has_flag(one.flags(), mi.EmitterFlags.Surface) or has_points(one):
                self.samplers[one] = one.get_shape() if _is_sampled_by_shape(one) else one
        #: The emitters that do not sample all their directions.
        self.partial = [one for one in self.samplers if omits_directions(one)]

    def _call(self, emitter: Emitter, function: Callable[..., Any], otherwise: Any, *args: Any) -> Any:
        """Returns ``function(emitter, sampler, *args)`` for the emitter of each lane, or ``otherwise``."""

        def call(one: mi.Emitter, *args: Any) -> Any:
            return function(one, self.samplers[one], *args) if one in self.samplers else otherwise

        single = not dr.is_jit_v(mi.Float) or isinstance(emitter, mi.Emitter)
        return call(emitter, *args) if single else dr.dispatch(emitter, call, *args)

    def sample_direction(
        self, emitter: Emitter, it: mi.Interaction3f, sample: mi.Point2f, active: mi.Bool
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """Returns ``(ds, weight)`` as ``mi.Emitter.sample_direction``."""

        def drawn(
            one: mi.Emitter, sampler: Any, it: mi.Interaction3f, sample: mi.Point2f, active: mi.Bool
        ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
            if one in self.partial:
                return self._mixed(one, it, sample, active)
            active = but_not(active, is_own_sphere(one, it))
            if sampler is one:
                ds, weight = one.sample_direction(it, sample, active)
                if one.class_name() == compat.SUNSKY and dr.grad_enabled(weight):
                    ds, weight = self._followed(one, it, ds, weight, active)
                return ds, dr.select(active, mi.Spectrum(weight), 0)
            varies = mi.has_flag(one.flags(), mi.EmitterFlags.SpatiallyVarying)
            ds = sample_shape(sampler, it, sample, active, varies)
            ds.emitter = mi.EmitterPtr(one) if dr.is_jit_v(mi.Float) else one
            lit = active & (dr.dot(ds.d, ds.n) < 0) & (ds.pdf > 0)
            return ds, dr.select(lit, mi.Spectrum(one.eval_direction(it, ds, lit)) / dr.select(lit, ds.pdf, 1), 0)

        return self._call(emitter, drawn, (no_sample(mi.DirectionSample3f), mi.Spectrum(0)), it, sample, active)

    def _mixed(
        self, one: mi.Emitter, it: mi.Interaction3f, sample: mi.Point2f, active: mi.Bool
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """Samples ``one``, which is infinitely far away, or a uniform direction, each with the probability 1/2."""
        own = sample.x < 0.5
        point = mi.Point2f(2 * sample.x - dr.select(own, mi.Float(0), 1), sample.y)
        ds, _ = one.sample_direction(it, point, active)
        ds.d = dr.select(own, ds.d, mi.warp.square_to_uniform_sphere(point))
        ds.p, ds.n = it.p + ds.d * ds.dist, -ds.d
        ds.pdf = self.pdf_direction(one, it, ds, active)
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.wi, si.wavelengths = -ds.d, it.wavelengths
        return ds, dr.select(active, one.eval(si, active) / ds.pdf, 0)

    @staticmethod
    def _followed(
        one: mi.Emitter, it: mi.Interaction3f, ds: mi.DirectionSample3f, weight: mi.Spectrum, active: mi.Bool
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """Returns the sample ``(ds, weight)`` of a ``sunsky`` with derivatives of a direction that turns with the sky,
        or in the sun with the sun. Mitsuba's lack the change of which part of the sky a random number samples.
        """
        sky, with_sun, ds = compat.exposed(one), mi.Vector3f(ds.d), dr.detach(ds)
        to_world, weight = compat.object_transform(one), dr.detach(weight)
        local = dr.detach(to_world).inverse() @ ds.d
        away = dr.norm(ds.d - dr.normalize(dr.detach(sky["sun_direction"])))
        width = dr.deg2rad(float(str(one).partition("Sun aperture = ")[2].split()[0]))
        in_sun = away < 2 * dr.sin(width / 4)
        ds.d = dr.replace_grad(ds.d, dr.select(in_sun, with_sun, to_world @ local))
        # At the horizon and the zenith, derivatives of Mitsuba's formulas are infinite.
        active = active & (ds.pdf > 0) & (dr.abs(local.z - 0.5) < 0.5 - 1e-6)
        at = mi.DirectionSample3f(ds)
        at.d = dr.select(active, ds.d, dr.detach(to_world) @ mi.Vector3f(0.6, 0, 0.8))
        weight = dr.replace_grad(weight, one.eval_direction(it, at, active) / dr.select(active, ds.pdf, 1))
        ds.pdf = dr.replace_grad(ds.pdf, one.pdf_direction(it, at, active))
        return ds, weight

    def pdf_direction(
        self, emitter: Emitter, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Bool
    ) -> mi.Float:
        """Returns the density per solid angle of :meth:`sample_direction`."""

        def density(
            one: mi.Emitter, sampler: Any, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Bool
        ) -> mi.Float:
            pdf = mi.Float(sampler.pdf_direction(it, ds, active))  # an emitter of a user may return a number of Python
            if one in self.partial:
                return 0.5 * (pdf + mi.warp.square_to_uniform_sphere_pdf(ds.d))
            return pdf if sampler is one else dr.select(dr.dot(ds.d, ds.n) < 0, pdf, 0)

        return self._call(emitter, density, mi.Float(0), it, ds, active)

    def sample_position(self, emitter: Emitter, sample: mi.Point2f, active: mi.Bool) -> mi.PositionSample3f:
        """Returns a point of the surface of ``emitter`` at time 0."""

        def drawn(one: mi.Emitter, sampler: Any, sample: mi.Point2f, active: mi.Bool) -> mi.PositionSample3f:
            if one.get_shape() is None:
                return no_sample(mi.PositionSample3f)
            if one.class_name() == compat.AREA or compat.is_users(one):
                return sample_point(one.get_shape(), 0.0, sample, active)
            return one.sample_position(0.0, sample, active)[0]

        return self._call(emitter, drawn, no_sample(mi.PositionSample3f), sample, active)

    def pdf_position(self, emitter: Emitter, ds: mi.DirectionSample3f, active: mi.Bool) -> mi.Float:
        """Returns the density per area of :meth:`sample_position` at ``ds``; 0 for an emitter without a shape."""

        def density(one: mi.Emitter, sampler: Any, ds: mi.DirectionSample3f, active: mi.Bool) -> mi.Float:
            return mi.Float(0) if one.get_shape() is None else one.get_shape().pdf_position(ds, active)

        return self._call(emitter, density, mi.Float(0), ds, active)
