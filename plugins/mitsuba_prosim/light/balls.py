"""Spheres that emit: sampled over the projected solid angle of their part above the horizon (section 4.2.2.1).

A diffuse surface that sees the whole of a uniform sphere so has no variance (Ureña and Georgiev 2018; Peters and
Dachsbacher 2019).
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi

from ..compat import shape_transform
from .motion import with_ball
from .sample import LightSample, direction_sample, weighed
from .spherical_cap import pdf_projected_cap, sample_projected_cap

#: Four times the unit of rounding in single precision.
SINGLE = 2.0**-22


class Balls:
    """Emitters whose shape is a sphere, seen from outside; ``emitters``: all of them, in the order of their numbers."""

    #: Whether all of a source is sampled: only what is above the horizon.
    whole_sphere = False
    #: Whether it can tell beforehand that a ray meets none of its sources.
    can_foresee = True

    def __init__(self, emitters: Sequence[mi.Emitter]) -> None:
        self.balls = [ball(emitter) for emitter in emitters]
        if self.balls and dr.is_jit_v(mi.Float):
            self.centers = mi.Point3f(*(dr.concat([mi.Float(c[axis]) for c, _ in self.balls]) for axis in range(3)))
            self.radii = dr.concat([mi.Float(r) for _, r in self.balls])
            dr.make_opaque(self.centers, self.radii)

    @staticmethod
    def takes(emitter: mi.Emitter | mi.EmitterPtr) -> bool:
        """Whether ``emitter`` is a sphere that emits outwards, the same everywhere."""
        shape = emitter.get_shape()
        if shape is None or shape.class_name() != "Sphere" or shape.has_flipped_normals():
            return False
        # What varies over the sphere would need the texture coordinates.
        return not mi.has_flag(emitter.flags(), mi.EmitterFlags.SpatiallyVarying)

    def ball(self, number: int | mi.UInt32, active: mi.Bool = True) -> tuple[mi.Point3f, mi.Float]:
        """Center and radius of the source ``number``, a Python integer or a Dr.Jit array."""
        if isinstance(number, int):
            return self.balls[number]
        return dr.gather(mi.Point3f, self.centers, number, active), dr.gather(mi.Float, self.radii, number, active)

    def sample(
        self,
        number: int | mi.UInt32,
        emitter: mi.Emitter | mi.EmitterPtr,
        si: mi.SurfaceInteraction3f,
        n: mi.Normal3f,
        sample: mi.Point2f,
        active: mi.Bool,
    ) -> LightSample:
        """A point of the source ``number``, which is ``emitter``, seen from ``si``.

        ``n``: unit normal on the viewer's side, above whose horizon points are taken; ``sample``: a point in [0, 1)².
        """
        center, radius = self.ball(number)
        return weighed(emitter, si, direction_to_ball(si, center, radius, n, sample), active)

    def pdf(
        self,
        number: int | mi.UInt32,
        si: mi.SurfaceInteraction3f,
        n: mi.Normal3f,
        ds: mi.DirectionSample3f,
        active: mi.Bool,
    ) -> mi.Float:
        """Density per solid angle with which :meth:`sample` takes the direction ``ds``."""
        return pdf_of_ball(si, *self.ball(number, active), n, ds.d)

    def carried(
        self,
        number: int | mi.UInt32,
        si: mi.SurfaceInteraction3f,
        n: mi.Normal3f,
        d: mi.Vector3f,
        met: mi.SurfaceInteraction3f | None,
        active: mi.Bool,
    ) -> tuple[mi.DirectionSample3f, mi.Float]:
        """The direction ``d`` from ``si`` to a point of the source ``number``, carried along: see :mod:`.motion`.

        Returns a ``mi.DirectionSample3f`` and the Jacobian, both with derivatives.
        """
        d, jacobian = with_ball(si.p, n, *self.ball(number, active), d)
        ds = direction_sample(si, d)
        ds.n = -d
        return ds, jacobian

    def follows_shape(self, number: int | mi.UInt32) -> bool:
        """Whether :meth:`carried` needs to know the point of the surface."""
        return False

    def may_meet(self, number: int | mi.UInt32, o: mi.Point3f, d: mi.Vector3f) -> mi.Bool:
        """Whether the ray (o, d) meets the source ``number``, as far as nothing is in the way."""
        center, radius = self.ball(number)
        to_center = center - o
        b = dr.dot(to_center, d)
        # With a margin for rounding: the renderer's own test compares squares of the distance, in single precision.
        distance2 = dr.squared_norm(to_center) + dr.squared_norm(center)
        near = dr.squared_norm(to_center - b * d) <= dr.square(1.001 * radius) + SINGLE * distance2
        return near & (b > -radius)


def ball(emitter: mi.Emitter | mi.EmitterPtr) -> tuple[mi.Point3f, mi.Float]:
    """``(center, radius)`` of the sphere that emits: ``mi.Point3f``, ``mi.Float``."""
    to_world = shape_transform(emitter.get_shape())
    return to_world @ mi.Point3f(0), dr.norm(to_world @ mi.Vector3f(1, 0, 0))


def pdf_of_ball(
    si: mi.SurfaceInteraction3f, center: mi.Point3f, radius: mi.Float, n: mi.Normal3f, d: mi.Vector3f
) -> mi.Float:
    """Density per solid angle with which :func:`direction_to_ball` takes the direction ``d``."""
    to_center = center - si.p
    inv_d2 = dr.rcp(dr.squared_norm(to_center))
    cos_n = dr.dot(n, to_center) * dr.sqrt(inv_d2)
    return pdf_projected_cap(cos_n, dr.square(radius) * inv_d2, dr.dot(n, d))


def direction_to_ball(
    si: mi.SurfaceInteraction3f, center: mi.Point3f, radius: mi.Float, n: mi.Normal3f, sample: mi.Point2f
) -> mi.DirectionSample3f:
    """``mi.DirectionSample3f`` from ``si`` to a sphere, by projected solid angle above the horizon of ``n``."""
    to_center = center - si.p
    d2 = dr.squared_norm(to_center)
    axis = to_center * dr.rsqrt(d2)
    # With y across n and the axis. Where these two are one but for rounding, any y across n will do.
    across = dr.cross(n, axis)
    across -= n * dr.dot(n, across)
    sin_n = dr.norm(across)
    y = dr.select(sin_n > 1e-7, dr.normalize(across), mi.coordinate_system(n)[1])
    local, pdf = sample_projected_cap(dr.dot(n, axis), sin_n, dr.square(radius) / d2, sample)
    d = dr.cross(y, n) * local.x + y * local.y + n * local.z
    # Nearer root of |t d - to_center| = radius, without cancellation for a distant source.
    b = dr.dot(d, to_center)
    chord = dr.safe_sqrt(dr.square(radius) - dr.squared_norm(to_center - b * d))
    ds = direction_sample(si, d)
    ds.dist = b - chord
    ds.p = si.p + d * ds.dist
    ds.n = dr.normalize(ds.p - center)
    ds.pdf = pdf
    return ds
