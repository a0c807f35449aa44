"""Strategies by which a surface samples a light source.

Mitsuba's method ``sample_direction`` can sample any emitter; a constant sky is sampled by projected solid angle, and so
is the part of a sphere above the receiver's horizon. Section 4.2.2.1 of the thesis samples a sphere by solid angle.
With sampling by projected solid angle, the direct light of a diffuse surface that sees the whole of a uniform sphere
has no variance (Ureña and Georgiev 2018; Peters and Dachsbacher 2019).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import drjit as dr
import mitsuba as mi

from ..compat import CONSTANT, SPHERE, eval_direction, object_transform
from .emitter_methods import Emitter, EmitterMethods, no_sample
from .spherical_cap import pdf_projected_cap, sample_projected_cap

#: The number of a lamp: an integer, or a Dr.Jit array.
Index: TypeAlias = "int | mi.UInt32"
#: A point of a light source with its density ``ds.pdf`` per solid angle, and its radiance divided by this density.
LightSample: TypeAlias = "tuple[mi.DirectionSample3f, mi.Spectrum]"


@dataclass
class Receiver:
    """The point at which direct light is computed (``LightSampleContext`` of pbrt)."""

    si: mi.SurfaceInteraction3f | mi.Interaction3f
    #: Unit normal on the viewer's side.
    n: mi.Normal3f
    #: Mask of the points that also receive light from below the horizon, such as points on rough glass; False if there
    #: are none.
    both_sides: mi.Bool | bool = False
    #: Total importance of the lamps at this point (:meth:`.LightSampler.total`); None where it is unknown.
    importance: mi.Float | None = None


def weighted(emitter: Emitter, receiver: Receiver, ds: mi.DirectionSample3f, active: mi.Bool) -> LightSample:
    """Returns the sample ``ds`` of ``emitter`` with its weight; density and weight are 0 in inactive lanes."""
    visible = active & (ds.pdf > 0)
    ds.emitter = mi.EmitterPtr(emitter) if dr.is_jit_v(mi.Float) else emitter
    weight = eval_direction(emitter, receiver.si, ds, visible) / dr.select(visible, ds.pdf, 1)
    ds.pdf = dr.select(visible, ds.pdf, 0)
    return ds, dr.select(visible, weight, 0)


def direction_sample(receiver: Receiver, d: mi.Vector3f) -> mi.DirectionSample3f:
    """Returns a sample with the direction ``d`` and the time of ``receiver``, and nothing else."""
    ds = no_sample(mi.DirectionSample3f)
    ds.d, ds.time, ds.delta = d, receiver.si.time, mi.Bool(False)
    return ds


class OtherLights:
    """Samples ``emitters``, the first of which has the number 0, by their own method ``sample_direction``."""

    #: Whether the strategy samples the whole source, including the part below the horizon.
    samples_below_horizon = True

    def __init__(self, emitters: Sequence[mi.Emitter]) -> None:
        self.methods = EmitterMethods(emitters)

    @staticmethod
    def can_sample(emitter: Emitter) -> bool:
        """Tells whether this strategy can sample ``emitter``."""
        return True

    def sample(self, k: Index, emitter: Emitter, receiver: Receiver, u: mi.Point2f, active: mi.Bool) -> LightSample:
        """Returns a sample of ``emitter``, which has the number ``k``, for ``receiver``, by ``u`` in [0, 1)²."""
        ds, weight = self.methods.sample_direction(emitter, receiver.si, u, active)
        ds.delta = mi.Bool(ds.delta)
        return ds, weight

    def pdf(self, k: Index, receiver: Receiver, ds: mi.DirectionSample3f, active: mi.Bool) -> mi.Float:
        """Returns the density per solid angle with which :meth:`sample` samples the direction ``ds``."""
        return self.methods.pdf_direction(ds.emitter, receiver.si, ds, active)

    def reparameterised(
        self, k: Index, receiver: Receiver, d: mi.Vector3f, met: mi.SurfaceInteraction3f, active: mi.Bool
    ) -> tuple[mi.DirectionSample3f, mi.Float]:
        """Returns ``(ds, jacobian)``, both with derivatives: a direction that moves with the light source ``k``.

        The value of ``ds.d`` is the direction ``d``, which leads to the point ``met`` of the source. The derivatives of
        ``met`` follow its shape (``mi.RayFlags.FollowShape``). ``jacobian`` is proportional to the solid angle of a
        small part of the source around ``met``, seen from ``receiver`` (:meth:`.Lights.reparameterised_ray`).
        """
        to_point = met.p - receiver.si.p
        d2 = dr.squared_norm(to_point)
        moved = to_point * dr.rsqrt(d2)
        jacobian = dr.abs_dot(met.n, moved) / d2 * dr.norm(dr.cross(met.dp_du, met.dp_dv))
        ds = direction_sample(receiver, dr.replace_grad(d, moved))
        ds.p, ds.n, ds.uv, ds.dist = met.p, met.n, met.uv, dr.norm(to_point)
        return ds, jacobian


class ConstantSky(OtherLights):
    """Samples ``constant``, a sphere of radius ``distance`` around the scene, by projected solid angle."""

    samples_below_horizon = False

    def __init__(self, distance: float) -> None:
        self.distance = distance

    @staticmethod
    def can_sample(emitter: Emitter) -> bool:
        """Tells whether ``emitter`` is a constant sky."""
        return emitter.class_name() == CONSTANT

    def sample(self, k: Index, emitter: Emitter, receiver: Receiver, u: mi.Point2f, active: mi.Bool) -> LightSample:
        """Returns a cosine-weighted sample of the sky above the horizon of ``receiver``."""
        local = mi.warp.square_to_cosine_hemisphere(u)
        ds = direction_sample(receiver, mi.Frame3f(receiver.n).to_world(local))
        ds.dist = mi.Float(self.distance)
        ds.p, ds.n = receiver.si.p + ds.d * self.distance, -ds.d
        ds.pdf = mi.warp.square_to_cosine_hemisphere_pdf(local)
        return weighted(emitter, receiver, ds, active)


class SphereLights(OtherLights):
    """Samples spheres that emit outwards equally everywhere; ``emitters`` are all for which :meth:`can_sample`."""

    samples_below_horizon = False

    def __init__(self, emitters: Sequence[mi.Emitter]) -> None:
        self.spheres = [sphere_of(emitter) for emitter in emitters]
        if self.spheres and dr.is_jit_v(mi.Float):  # a table that an array of numbers can index
            centers, radii = zip(*self.spheres)
            self.table = mi.Point3f(*map(concat, zip(*centers))), concat(radii)
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


def concat(arrays: Sequence[mi.Float]) -> mi.Float:
    """Returns ``dr.concat(arrays)``, computed 64 at a time: the kernel has code for each array, and compiling that for
    thousands of arrays would take minutes.
    """
    while len(arrays) > 1:
        parts: list[mi.Float] = []
        for first in range(0, len(arrays), 64):
            parts.append(dr.concat(arrays[first : first + 64]))
            dr.eval(parts[-1])
        arrays = parts
    return arrays[0]


def sphere_of(emitter: Emitter) -> tuple[mi.Point3f, mi.Float]:
    """Returns ``(center, radius)`` of the sphere that is the shape of ``emitter``."""
    to_world = object_transform(emitter.get_shape())
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
