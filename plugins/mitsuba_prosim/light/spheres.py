"""Spheres that emit: sampled over the projected solid angle of their part above the horizon (section 4.2.2.1).

A diffuse surface that sees the whole of a uniform sphere so has no variance (Ureña and Georgiev 2018; Peters and
Dachsbacher 2019).
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi

from ..compat import SPHERE, shape_transform
from .reparameterisation import with_sphere
from .spherical_cap import pdf_projected_cap, sample_projected_cap
from .strategy import Emitter, Index, OtherLights, Receiver, direction_sample, weighted


class SphereLights(OtherLights):
    """Emitters that are spheres and emit outwards; ``emitters``: all of them, in the order of their numbers."""

    samples_below_horizon = False
    follows_shape = False

    def __init__(self, emitters: Sequence[mi.Emitter]) -> None:
        self.spheres = [sphere_of(emitter) for emitter in emitters]
        if self.spheres and dr.is_jit_v(mi.Float):
            centers, radii = zip(*self.spheres)
            self.table = mi.Point3f(*map(dr.concat, zip(*centers))), dr.concat(radii)
            dr.make_opaque(self.table)

    @staticmethod
    def takes(emitter: Emitter) -> bool:
        """Whether ``emitter`` is a sphere that emits outwards, the same everywhere."""
        shape = emitter.get_shape()
        if shape is None or shape.class_name() != SPHERE or shape.has_flipped_normals():
            return False
        # Radiance that varies over the sphere would need the texture coordinates.
        return not mi.has_flag(emitter.flags(), mi.EmitterFlags.SpatiallyVarying)

    def sphere(self, number: Index, active: mi.Bool = True) -> tuple[mi.Point3f, mi.Float]:
        """Center and radius of the source ``number``."""
        return self.spheres[number] if isinstance(number, int) else dr.gather(tuple, self.table, number, active)

    def sample(
        self, number: Index, emitter: Emitter, receiver: Receiver, sample: mi.Point2f, active: mi.Bool
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """``(ds, weight)``: a point of the source above the horizon of ``receiver``."""
        return weighted(emitter, receiver, direction_to_sphere(receiver, *self.sphere(number), sample), active)

    def pdf(self, number: Index, receiver: Receiver, ds: mi.DirectionSample3f, active: mi.Bool) -> mi.Float:
        """Density per solid angle with which :meth:`sample` takes the direction ``ds``."""
        center, radius = self.sphere(number, active)
        to_center = center - receiver.si.p
        inv_d2 = dr.rcp(dr.squared_norm(to_center))
        cos_n = dr.dot(receiver.n, to_center) * dr.sqrt(inv_d2)
        return pdf_projected_cap(cos_n, dr.square(radius) * inv_d2, dr.dot(receiver.n, ds.d))

    def reparameterised(
        self, number: Index, receiver: Receiver, d: mi.Vector3f, met: mi.SurfaceInteraction3f | None, active: mi.Bool
    ) -> tuple[mi.DirectionSample3f, mi.Float]:
        """``(ds, jacobian)``, both with derivatives: the direction ``d``, which moves with the source ``number``."""
        d, jacobian = with_sphere(receiver, *self.sphere(number, active), d)
        ds = direction_sample(receiver, d)
        ds.n = -d
        return ds, jacobian


def sphere_of(emitter: Emitter) -> tuple[mi.Point3f, mi.Float]:
    """``(center, radius)`` of the sphere that emits: ``mi.Point3f``, ``mi.Float``."""
    to_world = shape_transform(emitter.get_shape())
    return to_world @ mi.Point3f(0), dr.norm(to_world @ mi.Vector3f(1, 0, 0))


def direction_to_sphere(
    receiver: Receiver, center: mi.Point3f, radius: mi.Float, sample: mi.Point2f
) -> mi.DirectionSample3f:
    """``mi.DirectionSample3f`` from ``receiver`` to a sphere, by projected solid angle above the horizon."""
    n = receiver.n
    to_center = center - receiver.si.p
    d2 = dr.squared_norm(to_center)
    axis = to_center * dr.rsqrt(d2)
    # With y across n and the axis. Where these two differ only by rounding, any y across n will do.
    across = dr.cross(n, axis)
    across -= n * dr.dot(n, across)
    sin_n = dr.norm(across)
    y = dr.select(sin_n > 1e-7, dr.normalize(across), mi.coordinate_system(n)[1])
    local, pdf = sample_projected_cap(dr.dot(n, axis), sin_n, dr.square(radius) / d2, sample)
    d = dr.cross(y, n) * local.x + y * local.y + n * local.z
    # Nearer root of |t d - to_center| = radius, without cancellation for a distant source.
    b = dr.dot(d, to_center)
    chord = dr.safe_sqrt(dr.square(radius) - dr.squared_norm(to_center - b * d))
    ds = direction_sample(receiver, d)
    ds.dist = b - chord
    ds.p = receiver.si.p + d * ds.dist
    ds.n = dr.normalize(ds.p - center)
    ds.pdf = pdf
    return ds
