"""Methods that sample the emitters of a scene, without errors of Mitsuba 3.9.

A method of an array of emitters is compiled for all emitters of the process. So one emitter that raises an error, such
as an ``area`` on a curve, would end the call for all others. :class:`EmitterMethods` calls the methods of the emitters
of one scene only.

An ``area`` with a texture samples texture coordinates, and looks for the point of the shape with these coordinates. So
it loses light where coordinates are outside the unit square or belong to several points. Then :class:`EmitterMethods`
samples the shape.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, TypeAlias

import drjit as dr
import mitsuba as mi

from ..compat import AREA, MESH_ATTRIBUTE, SPHERE, UNIQUE_UV, mesh_positions, samples_elsewhere

#: One emitter, or a Dr.Jit array of emitters.
Emitter: TypeAlias = "mi.Emitter | mi.EmitterPtr"

#: Maximum number of triangles of a mesh whose texture coordinates are examined.
MAX_TRIANGLES = 256

#: Fraction of light that an emitter with tilted normals must lose to cause a warning.
MIN_TILT_LOSS = 0.01


def point_sampler(emitter: mi.Emitter) -> str:
    """Tells what samples the points of ``emitter``: its "texture", if it reaches all of them, or its "shape"; or ""
    where Mitsuba cannot sample the shape, or evaluates the radiance only where a ray meets it (``mesh_attribute``).

    The shape of an emitter on ``ellipsoidsmesh`` is None (Mitsuba 3.9).
    """
    shape = emitter.get_shape()
    if shape is None or not has_area(shape):
        return ""
    parameters = mi.traverse(emitter)
    if any(node.class_name() == MESH_ATTRIBUTE for node in parameters.hierarchy):
        return ""
    by_texture = mi.has_flag(emitter.flags(), mi.EmitterFlags.SpatiallyVarying) and _has_unique_uv(shape)
    return "texture" if by_texture and not samples_elsewhere(parameters, "radiance.") else "shape"


def has_area(shape: mi.Shape) -> bool:
    """Tells whether Mitsuba knows the area of ``shape``. Of other shapes, Mitsuba 3.9 cannot sample points."""
    try:
        return bool(dr.all(shape.surface_area() > 0))
    except RuntimeError:
        return False


def _has_unique_uv(shape: mi.Shape) -> bool:
    """Tells whether each point of ``shape`` has its own texture coordinates, in the unit square; False for a mesh of
    more than :data:`MAX_TRIANGLES` triangles.
    """
    if shape.class_name() in UNIQUE_UV:
        return True
    parameters = mi.traverse(shape)
    if "vertex_texcoords" not in parameters or shape.primitive_count() > MAX_TRIANGLES:
        return False
    import numpy as np  # slow to import, and seldom needed

    uv, faces = (np.array(dr.detach(parameters[name])) for name in ("vertex_texcoords", "faces"))
    if not len(uv) or uv.min() < 0 or uv.max() > 1:
        return False
    corners = uv.reshape(-1, 2)[faces.reshape(-1, 3)].astype(float)
    edges = np.roll(corners, -1, axis=1) - corners
    # Triangles do not overlap if an edge of one separates them; [i, j, e, c]: height of corner c of j over edge e of i.
    heights = np.einsum("ied,jcd->ijec", np.stack([-edges[..., 1], edges[..., 0]], axis=-1), corners)
    low, high = heights.min(-1), heights.max(-1)
    own = np.arange(len(corners))
    gap = np.maximum(low - high[own, own][:, None], low[own, own][:, None] - high).max(-1)
    overlap = np.maximum(gap, gap.T) < -1e-6 * np.abs(edges).max()
    return bool(np.array_equal(overlap, own == own[:, None]))


def warn_of_tilted_normals(emitters: Iterable[mi.Emitter]) -> None:
    """Warns of emitters on meshes whose vertex normals are tilted: Mitsuba 3.9 computes the density of a sampled point
    by them instead of the triangle's normal, so that light sampling loses light.
    """
    losses = {name_of(e): tilt_loss(e.get_shape()) for e in emitters if e.get_shape() is not None}
    if tilted := {name: loss for name, loss in losses.items() if loss > MIN_TILT_LOSS}:
        names = ", ".join(f"{name!r} (about {loss:.0%})" for name, loss in tilted.items())
        mi.Log(
            mi.LogLevel.Warn,
            f"prosim: {names} may light too little: the vertex normals of these emitters are tilted against their "
            "triangles. Load the mesh with face_normals, or remove the vertex normals from its file.",
        )


def tilt_loss(shape: mi.Shape) -> float:
    """Returns 1 - cos of the angle between the normal of a triangle and the mean normal of its corners, averaged over
    the area of the mesh; 0 for other shapes, and without vertex normals.
    """
    import numpy as np

    parameters, positions = mi.traverse(shape), mesh_positions(shape)
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


def name_of(emitter: mi.Emitter) -> str:
    """Returns the id by which messages name ``emitter``: that of its shape, if it has one."""
    return str((emitter.get_shape() or emitter).id())


def sample_shape(shape: mi.Shape, it: mi.Interaction3f, sample: mi.Point2f, active: mi.Bool) -> mi.DirectionSample3f:
    """Returns ``shape.sample_direction`` with texture coordinates, which Mitsuba 3.9 leaves out for a sphere."""
    ds = shape.sample_direction(it, sample, active)
    if shape.class_name() == SPHERE:
        ds.uv = shape.ray_intersect(mi.Ray3f(it.p, ds.d), +mi.RayFlags.All, active).uv
    return ds


class EmitterMethods:
    """Samples the ``emitters`` of a scene, given one of them or a Dr.Jit array.

    Other emitters, and emitters without a :func:`point_sampler`, have samples and densities of 0.
    """

    def __init__(self, emitters: Iterable[mi.Emitter]) -> None:
        #: The object that samples each emitter, which is the emitter or its shape; and the :func:`point_sampler`.
        self.samplers: dict[mi.Emitter, tuple[mi.Emitter | mi.Shape, str]] = {}
        for one in emitters:
            by, varies = point_sampler(one), mi.has_flag(one.flags(), mi.EmitterFlags.SpatiallyVarying)
            if by or not mi.has_flag(one.flags(), mi.EmitterFlags.Surface):
                by_shape = by == "shape" and varies and one.class_name() == AREA
                self.samplers[one] = one.get_shape() if by_shape else one, by

    def _call(self, emitter: Emitter, function: Callable[..., Any], otherwise: Any, *args: Any) -> Any:
        """Returns ``function(emitter, sampler, *args)`` for the emitter of each lane, or ``otherwise``."""

        def call(one: mi.Emitter, *args: Any) -> Any:
            return function(one, self.samplers[one][0], *args) if one in self.samplers else otherwise

        single = not dr.is_jit_v(mi.Float) or isinstance(emitter, mi.Emitter)
        return call(emitter, *args) if single else dr.dispatch(emitter, call, *args)

    def sample_direction(
        self, emitter: Emitter, it: mi.Interaction3f, sample: mi.Point2f, active: mi.Bool
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """Returns ``(ds, weight)`` as ``mi.Emitter.sample_direction``."""

        def drawn(
            one: mi.Emitter, sampler: Any, it: mi.Interaction3f, sample: mi.Point2f, active: mi.Bool
        ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
            if sampler is one:
                return one.sample_direction(it, sample, active)
            ds = sample_shape(sampler, it, sample, active)
            ds.emitter = mi.EmitterPtr(one) if dr.is_jit_v(mi.Float) else one
            lit = active & (dr.dot(ds.d, ds.n) < 0) & (ds.pdf > 0)
            return ds, dr.select(lit, one.eval_direction(it, ds, lit) / dr.select(lit, ds.pdf, 1), 0)

        return self._call(emitter, drawn, (no_sample(mi.DirectionSample3f), mi.Spectrum(0)), it, sample, active)

    def pdf_direction(
        self, emitter: Emitter, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Bool
    ) -> mi.Float:
        """Returns the density per solid angle of :meth:`sample_direction`."""

        def density(
            one: mi.Emitter, sampler: Any, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Bool
        ) -> mi.Float:
            pdf = sampler.pdf_direction(it, ds, active)
            return pdf if sampler is one else dr.select(dr.dot(ds.d, ds.n) < 0, pdf, 0)

        return self._call(emitter, density, mi.Float(0), it, ds, active)

    def sample_position(self, emitter: Emitter, sample: mi.Point2f, active: mi.Bool) -> mi.PositionSample3f:
        """Returns a point of the surface of ``emitter`` at time 0."""

        def drawn(one: mi.Emitter, sampler: Any, sample: mi.Point2f, active: mi.Bool) -> mi.PositionSample3f:
            ps = sampler.sample_position(0.0, sample, active)
            return ps[0] if sampler is one else ps

        return self._call(emitter, drawn, no_sample(mi.PositionSample3f), sample, active)

    def pdf_position(
        self, emitter: Emitter, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Bool
    ) -> mi.Float:
        """Returns the density per area of :meth:`sample_position` at ``ds``; 0 for an emitter without a shape."""

        def density(
            one: mi.Emitter, sampler: Any, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Bool
        ) -> mi.Float:
            by = self.samplers[one][1]
            if by == "texture":  # the texture samples points and directions alike
                return one.pdf_direction(it, ds, active) * dr.abs_dot(ds.n, ds.d) / dr.square(ds.dist)
            return one.get_shape().pdf_position(ds, active) if by else mi.Float(0)

        return self._call(emitter, density, mi.Float(0), it, ds, active)
