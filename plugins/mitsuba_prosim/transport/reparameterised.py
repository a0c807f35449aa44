"""Samples of light with derivatives by the place of its sources, and of what they light."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi

from ..light.sample import LightSample
from ..light.table import Lamp, Lights


def carried_ray(
    scene: mi.Scene, lights: Lights, si: mi.SurfaceInteraction3f, n: mi.Normal3f, d: mi.Vector3f, active: mi.Bool
) -> tuple[mi.Vector3f, mi.Float]:
    """The direction ``d`` of a ray from ``si``, carried along with the source that it meets (elsewhere it is fixed),
    and the Jacobian of that map; both with derivatives. ``n``: normal on the viewer's side.
    """
    if lights.only_points:
        return d, mi.Float(1)
    met = meet_and_stay(scene, si.spawn_ray(d), active)
    return lights.carried(si, n, d, met, active & met.is_valid() & met.shape.is_emitter())


def carried_sample(
    scene: mi.Scene,
    lights: Lights,
    lamp: Lamp,
    si: mi.SurfaceInteraction3f,
    n: mi.Normal3f,
    both_sides: mi.Bool | bool,
    sample: LightSample,
    active: mi.Bool,
    estimates: mi.Float | None = None,
) -> LightSample:
    """The light ``sample`` of ``lamp``, carried along with it, if that is a surface; parameters as in
    :meth:`.table.Lamp.sample` and :meth:`.table.Lights.pdf`.
    """
    emitter = mi.EmitterPtr(lamp.emitter)
    active = active & (sample.pdf > 0) & mi.has_flag(emitter.flags(), mi.EmitterFlags.Surface)
    met = None
    follows = lamp.strategy.follows_shape(lamp.number)
    if follows is not False:
        to_point = si.spawn_ray_to(sample.p)  # ends just before the point
        met = meet_and_stay(scene, mi.Ray3f(to_point(to_point.maxt), to_point.d), active & follows)
        active = dr.select(follows, active & met.is_valid() & (met.shape.emitter() == emitter), active)
    ds, jacobian = lamp.strategy.carried(lamp.number, si, n, dr.detach(sample.d), met, active)
    ds.emitter = emitter
    radiance = emitter.eval_direction(si, ds, active)
    weight = radiance * (dr.relative_grad(jacobian) / dr.detach(dr.select(active, sample.pdf, 1)))
    return replace(
        sample,
        d=attached(sample.d, ds.d, active),
        weight=attached(sample.weight, weight, active),
        pdf=attached(sample.pdf, lights.pdf(si, n, both_sides, ds, active, estimates), active),
    )


def meet_and_stay(scene: mi.Scene, ray: mi.Ray3f, active: mi.Bool) -> mi.SurfaceInteraction3f:
    """The point that ``ray`` meets, as one of its surface, wherever that goes."""
    return scene.ray_intersect(dr.detach(ray), int(mi.RayFlags.All) | int(mi.RayFlags.FollowShape), False, active)


def attached(value: Any, same: Any, active: mi.Bool) -> Any:
    """``value``, with the derivatives of ``same`` where ``active``, else its own."""
    return dr.select(active, dr.replace_grad(value, same), value)
