"""Reparameterisation: derivatives of a direction towards a source that moves, or whose receiver moves
(Loubet et al. 2019).

The direction that was sampled is fixed while an image is made. If it were fixed in the derivatives too, the light that
enters and leaves at the edge of a moving source would be lost. Therefore it follows a point of the source, and the
solid angle that it represents is scaled by the Jacobian of that map. Any map is right that keeps to the source and
whose Jacobian is known. All samples of a source have the same map, whichever strategy drew them, so that MIS weights
can be differentiated along it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi

from ..compat import eval_direction

if TYPE_CHECKING:
    from .strategy import Receiver
    from .table import Lamp, Lights


def reparameterised_ray(
    lights: Lights, receiver: Receiver, d: mi.Vector3f, active: mi.Bool
) -> tuple[mi.Vector3f, mi.Float]:
    """``(d, jacobian)``, both with derivatives: the direction ``d`` of a ray from ``receiver``, which moves with the
    source that it meets, and is fixed elsewhere.
    """
    if lights.all_delta or not lights.lamps:
        return d, mi.Float(1)
    met = meet(lights.scene, receiver.si.spawn_ray(d), active)
    active = active & met.is_valid() & met.shape.is_emitter()
    k = lights.number_of(met.shape.emitter(), active)
    active &= k < lights.lamps
    ds, jacobian = lights.lamp(k).reparameterised(receiver, d, met, active)
    return dr.select(active, ds.d, d), dr.select(active, jacobian, 1)


def reparameterised_sample(
    lights: Lights, lamp: Lamp, receiver: Receiver, ds: mi.DirectionSample3f, weight: mi.Spectrum, active: mi.Bool
) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
    """The sample ``(ds, weight)`` of ``lamp``, with the derivatives of direction, density and weight if the lamp is
    a surface.
    """
    emitter, si = mi.EmitterPtr(lamp.emitter), receiver.si
    active = active & (ds.pdf > 0) & mi.has_flag(emitter.flags(), mi.EmitterFlags.Surface)
    met, follows = None, lamp.follows_shape
    if follows is not False:
        to_point = si.spawn_ray_to(ds.p)  # ends just before the point
        met = meet(lights.scene, mi.Ray3f(to_point(to_point.maxt), to_point.d), active & follows)
        active = dr.select(follows, active & met.is_valid() & (met.shape.emitter() == emitter), active)
    moved, jacobian = lamp.reparameterised(receiver, dr.detach(ds.d), met, active)
    moved.emitter = emitter
    radiance = eval_direction(emitter, si, moved, active)
    moved_weight = radiance * (dr.relative_grad(jacobian) / dr.detach(dr.select(active, ds.pdf, 1)))
    result = mi.DirectionSample3f(ds)
    result.d = with_derivatives(ds.d, moved.d, active)
    result.pdf = with_derivatives(ds.pdf, lights.pdf(receiver, moved, active), active)
    return result, with_derivatives(weight, moved_weight, active)


def meet(scene: mi.Scene, ray: mi.Ray3f, active: mi.Bool) -> mi.SurfaceInteraction3f:
    """The point that ``ray`` meets, which moves with its surface."""
    return scene.ray_intersect(dr.detach(ray), int(mi.RayFlags.All) | int(mi.RayFlags.FollowShape), False, active)


def with_derivatives(value: Any, same: Any, active: mi.Bool) -> Any:
    """``value``, with the derivatives of ``same`` where ``active``, else its own."""
    return dr.select(active, dr.replace_grad(value, same), value)


def with_sphere(
    receiver: Receiver, center: mi.Point3f, radius: mi.Float, d: mi.Vector3f
) -> tuple[mi.Vector3f, mi.Float]:
    """``(d, jacobian)``, both with derivatives: the direction ``d`` from ``receiver``, which moves with a sphere that
    it meets.

    The direction is that of a point of the disk within the sphere's outline for the receiver, lifted to
    the unit sphere: along the normal where the whole sphere is above the horizon, so that a diffuse surface gains and
    loses no light between the parts of the sphere (the map of :mod:`.spherical_cap`), else along the sphere's axis. A
    point of the sphere itself would be right too, except near its outline, where the Jacobian varies without bound.
    """
    n = receiver.n
    to_center = center - receiver.si.p
    inv_d2 = dr.rcp(dr.squared_norm(to_center))
    axis = to_center * dr.sqrt(inv_d2)
    s2 = dr.minimum(dr.square(radius) * inv_d2, 1 - 1e-6)
    s, cos_max = dr.sqrt(s2), dr.sqrt(1 - s2)
    cos_n = dr.dot(axis, n)
    lift = dr.select((cos_n > 0) & (dr.square(cos_n) > s2), mi.Vector3f(n), axis)
    with dr.suspend_grad():
        height = (dr.dot(axis, d) - cos_max) / dr.dot(axis, lift)
        in_disk = (d - height * lift - cos_max * axis) / s
    in_disk -= axis * dr.dot(axis, in_disk)
    foot = cos_max * axis + s * in_disk
    b = dr.dot(foot, lift)
    height = dr.sqrt(dr.square(b) + s2 * dr.maximum(1 - dr.squared_norm(in_disk), 0)) - b
    moved = dr.replace_grad(d, foot + height * lift)
    return moved, s2 * dr.dot(axis, lift) / dr.dot(moved, lift)


def with_surface(o: mi.Point3f, met: mi.SurfaceInteraction3f) -> tuple[mi.Vector3f, mi.Float]:
    """``(d, jacobian)``, both with derivatives: the direction from ``o`` to the point ``met``, which moves with its
    surface.

    ``met`` is a ``mi.SurfaceInteraction3f`` that was made with ``mi.RayFlags.FollowShape``.
    """
    to_point = met.p - o
    d2 = dr.squared_norm(to_point)
    d = to_point * dr.rsqrt(d2)
    return d, dr.abs_dot(met.n, d) / d2 * dr.norm(dr.cross(met.dp_du, met.dp_dv))
