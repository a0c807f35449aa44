"""Reparameterisation: derivatives of a direction towards a light source when the source or the receiver moves (Loubet,
Holzschuch and Jakob 2019).

If sampled directions were constants, the derivatives would miss the light that enters and leaves at the edge of a
moving light source. So the derivatives of a sampled direction follow a point of the source, and the Jacobian of the map
from directions to points of the source scales the solid angle of the sample. Any map with a known Jacobian is correct;
all samples of a source, by light sampling or BSDF sampling, use the same, so that MIS weights can be differentiated.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..compat import eval_direction
from .strategy import Receiver
from .table import Lamp, Lights


def reparameterised_ray(
    lights: Lights, receiver: Receiver, d: mi.Vector3f, active: mi.Bool
) -> tuple[mi.Vector3f, mi.Float]:
    """Returns ``(d, jacobian)`` with derivatives that follow the lamp, if any, which the ray from ``receiver`` hits."""
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
    """Returns the sample ``(ds, weight)`` of ``lamp``, with derivatives of the direction, the density and the weight;
    unchanged if the lamp is no surface, or a ray does not find the sampled point.
    """
    emitter, si = mi.EmitterPtr(lamp.emitter), receiver.si
    active = active & (ds.pdf > 0) & mi.has_flag(emitter.flags(), mi.EmitterFlags.Surface)
    to_point = si.spawn_ray_to(ds.p)  # ends just before the point
    met = meet(lights.scene, mi.Ray3f(to_point(to_point.maxt), to_point.d), active)
    active = active & met.is_valid() & (met.shape.emitter() == emitter)
    moved, jacobian = lamp.reparameterised(receiver, dr.detach(ds.d), met, active)
    moved.emitter = emitter
    radiance = eval_direction(emitter, si, moved, active)
    moved_weight = radiance * (dr.relative_grad(jacobian) / dr.detach(dr.select(active, ds.pdf, 1)))
    result = mi.DirectionSample3f(ds)
    result.d = with_derivatives(ds.d, moved.d, active)
    result.pdf = with_derivatives(ds.pdf, lights.pdf(receiver, moved, active), active)
    return result, with_derivatives(weight, moved_weight, active)


def meet(scene: mi.Scene, ray: mi.Ray3f, active: mi.Bool) -> mi.SurfaceInteraction3f:
    """Returns the surface point that ``ray`` hits; its derivatives follow the surface."""
    return scene.ray_intersect(dr.detach(ray), int(mi.RayFlags.All) | int(mi.RayFlags.FollowShape), False, active)


def with_derivatives(value: Any, same: Any, active: mi.Bool) -> Any:
    """Returns ``value``, in ``active`` lanes with the derivatives of ``same``."""
    return dr.select(active, dr.replace_grad(value, same), value)
