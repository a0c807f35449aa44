"""Spherical light sources, of which the part above the receiver's horizon is sampled by projected solid angle.

Section 4.2.2.1 of the thesis samples a sphere by solid angle. With sampling by projected solid angle, the direct light
of a diffuse surface that sees the whole of a uniform sphere has no variance (Ureña and Georgiev 2018; Peters and
Dachsbacher 2019).
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi

from ..compat import SPHERE, shape_transform
from .emitter_methods import Emitter
from .spherical_cap import pdf_projected_cap, sample_projected_cap
from .strategy import Index, LightSample, OtherLights, Receiver, direction_sample, weighted


class SphereLights(OtherLights):
    """Samples spheres that emit outwards equally everywhere; ``emitters`` are all for which :meth:`can_sample`."""

    samples_below_horizon = False

    def __init__(self, emitters: Sequence[mi.Emitter]) -> None:
        self.spheres = [sphere_of(emitter) for emitter in emitters]
        if self.spheres and dr.is_jit_v(mi.Float):  # a table that an array of numbers can index
            centers, radii = zip(*self.spheres)
            self.table = mi.Point3f(*map(dr.concat, zip(*centers))), dr.concat(radii)
            dr.make_opaque(self.table)

    @staticmethod
    def can_sample(emitter: Emitter) -> bool:
        """Tells whether ``emitter`` is a sphere that emits outwards, with the same radiance everywhere."""
        shape = emitter.get_shape()
        if shape is None or shape.class_name() != SPHERE or shape.has_flipped_normals():
            return False
        # Radiance that varies over the sphere would need the texture coordinates. DeltaDirection: "directionalarea".
        excluded = mi.EmitterFlags.SpatiallyVarying, mi.EmitterFlags.DeltaDirection
        return not any(mi.has_flag(emitter.flags(), flag) for flag in excluded)

    def sphere(self, k: Index, active: mi.Bool = True) -> tuple[mi.Point3f, mi.Float]:
        """Returns the centre and the radius of the spherical light source number ``k``."""
        return self.spheres[k] if isinstance(k, int) else dr.gather(tuple, self.table, k, active)

    def sample(self, k: Index, emitter: Emitter, receiver: Receiver, u: mi.Point2f, active: mi.Bool) -> LightSample:
        """Returns a sample of the part of the sphere above the horizon of ``receiver``."""
        return weighted(emitter, receiver, direction_to_sphere(receiver, *self.sphere(k), u), active)

    def pdf(self, k: Index, receiver: Receiver, ds: mi.DirectionSample3f, active: mi.Bool) -> mi.Float:
        """Returns the density per solid angle of :meth:`sample` for ``ds``, which meets the sphere; 0 below the
        horizon, and for a receiver inside the sphere.
        """
        center, radius = self.sphere(k, active)
        to_center = center - receiver.si.p
        inv_d2 = dr.rcp(dr.squared_norm(to_center))
        cos_n = dr.dot(receiver.n, to_center) * dr.sqrt(inv_d2)
        y_axis = dr.cross(receiver.n, to_center)
        y = dr.dot(ds.d, y_axis) * dr.rsqrt(dr.maximum(dr.squared_norm(y_axis), 1e-30))
        return pdf_projected_cap(cos_n, dr.square(radius) * inv_d2, y, dr.dot(receiver.n, ds.d))

    def reparameterised(
        self, k: Index, receiver: Receiver, d: mi.Vector3f, met: mi.SurfaceInteraction3f, active: mi.Bool
    ) -> tuple[mi.DirectionSample3f, mi.Float]:
        """Returns ``(ds, jacobian)`` as :meth:`.OtherLights.reparameterised`; ``met`` is not used.

        The outline of the sphere, seen from the receiver, bounds a disk. A direction to the sphere corresponds to a
        point of the disk, which is projected onto the unit sphere around the receiver: along the surface normal if the
        whole sphere is above the horizon, as in :mod:`.spherical_cap`, because equal areas of the disk then give equal
        irradiance; else along the axis to the centre. A map to points of the sphere itself would have an unbounded
        Jacobian near its outline.
        """
        center, radius = self.sphere(k, active)
        to_center = center - receiver.si.p
        inv_d2 = dr.rcp(dr.squared_norm(to_center))
        axis = to_center * dr.sqrt(inv_d2)
        s2 = dr.minimum(dr.square(radius) * inv_d2, 1 - 1e-6)
        s, cos_max = dr.sqrt(s2), dr.sqrt(1 - s2)
        cos_n = dr.dot(axis, receiver.n)
        # Direction of the projection.
        lift = dr.select((cos_n > 0) & (dr.square(cos_n) > s2), mi.Vector3f(receiver.n), axis)
        with dr.suspend_grad():  # the point of the disk is constant: only the disk moves
            height = (dr.dot(axis, d) - cos_max) / dr.dot(axis, lift)
            in_disk = (d - height * lift - cos_max * axis) / s
        in_disk -= axis * dr.dot(axis, in_disk)
        foot = cos_max * axis + s * in_disk
        b = dr.dot(foot, lift)
        height = dr.sqrt(dr.square(b) + s2 * dr.maximum(1 - dr.squared_norm(in_disk), 0)) - b
        moved = dr.replace_grad(d, foot + height * lift)
        ds = direction_sample(receiver, moved)
        ds.n = -moved
        return ds, s2 * dr.dot(axis, lift) / dr.dot(moved, lift)


def sphere_of(emitter: Emitter) -> tuple[mi.Point3f, mi.Float]:
    """Returns ``(center, radius)`` of the sphere that is the shape of ``emitter``."""
    to_world = shape_transform(emitter.get_shape())
    return to_world @ mi.Point3f(0), dr.norm(to_world @ mi.Vector3f(1, 0, 0))


def direction_to_sphere(
    receiver: Receiver, center: mi.Point3f, radius: mi.Float, u: mi.Point2f
) -> mi.DirectionSample3f:
    """Returns a sample of a sphere above the horizon of ``receiver``, by projected solid angle. Its density is 0 if the
    receiver is inside the sphere, or the sphere below the horizon.
    """
    n = receiver.n
    to_center = center - receiver.si.p
    d2 = dr.squared_norm(to_center)
    axis = to_center * dr.rsqrt(d2)
    # The frame has y perpendicular to n and to the axis. Where n and the axis differ only by rounding, any y
    # perpendicular to n is right.
    across = dr.cross(n, axis)
    across -= n * dr.dot(n, across)
    sin_n = dr.norm(across)
    y = dr.select(sin_n > 1e-7, dr.normalize(across), mi.coordinate_system(n)[1])
    local, pdf = sample_projected_cap(dr.dot(n, axis), sin_n, dr.square(radius) / d2, u)
    d = dr.cross(y, n) * local.x + y * local.y + n * local.z
    # The nearer root of |t d - to_center| = radius, computed without cancellation for a distant source.
    b = dr.dot(d, to_center)
    chord = dr.safe_sqrt(dr.square(radius) - dr.squared_norm(to_center - b * d))
    ds = direction_sample(receiver, d)
    ds.dist = b - chord
    ds.p = receiver.si.p + d * ds.dist
    ds.n = dr.normalize(ds.p - center)
    ds.pdf = pdf
    return ds
