"""Kajiya's paths: at each surface one ray goes on, also from a diffuse component (section 4.2.3)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from ..sampling.sobol import Points
from . import lobes
from .context import CHOICE, DIFFUSE, REFLECTED, REFRACTED, ROULETTE, Context
from .loop import walk
from .next_ray import next_ray
from .ray import Ray, Vertex
from .vertex import shade


@dataclass
class State:
    """Where a path is. ``sampler``: what the points are drawn from, if that has a state."""

    L: mi.Spectrum
    hit: mi.Bool
    ray: Ray
    active: mi.Bool
    #: Diffuse reflections so far; None where they are not counted, as Dr.Jit follows a loop twice in which something
    #: stays as it is.
    bounces: mi.UInt32 | None
    #: Product of the ratios of the indices crossed so far.
    eta: mi.Float
    sampler: mi.Sampler | None


def radiance(
    context: Context, camera: mi.Ray3f, points: Points, active: mi.Bool, sampler: mi.Sampler = None
) -> tuple[mi.Spectrum, mi.Bool]:
    """Radiance of the camera ray ``camera`` (``mi.Ray3f``) by one path: ``(L, hit)``; see :class:`.Transport`."""
    settings = context.settings

    def step(state: State) -> State:
        scattered = False if context.photons is None or state.bounces is None else state.bounces > 0
        if state.ray.gathered is not None:
            scattered |= state.ray.gathered
        L, vertex = shade(context, state.ray, camera, points, state.active, scattered)
        ray = vertex.ray
        hit = state.hit | (ray.level == 0) & vertex.surface
        surface, bounces = vertex.surface, state.bounces
        if settings.max_level >= 0:
            surface = surface & (ray.level <= settings.max_level)
        if bounces is None:
            following, going, passed = next_ray(context, lobes.everything(), DIFFUSE, vertex, points, surface)
        else:
            following, going, passed, bounces = one_of_two(context, vertex, points, surface, bounces)
        following.node = ray.node + 1
        if context.photons is not None and bounces is not None:
            # What a ray meets after a diffuse reflection was gathered there.
            following.counts = following.counts & (bounces == 0)
        # Radiance within glass is scaled by the square of its index, which is lost again at the way out.
        eta = state.eta * passed
        following, going = roulette(context, following, going, eta, points.choice(context.space(ray.node, ROULETTE)))
        return State(state.L + L, hit, following, going, bounces, eta, state.sampler)

    bounces = mi.UInt32(0) if settings.diffuse_bounces >= 0 else None
    state = State(mi.Spectrum(0), mi.Bool(False), context.first(camera), mi.Bool(active), bounces, mi.Float(1), sampler)
    return walk(context, step, state, camera)


def one_of_two(
    context: Context, vertex: Vertex, points: Points, surface: mi.Bool, bounces: mi.UInt32
) -> tuple[Ray, mi.Bool, mi.Float, mi.UInt32]:
    """Draws a specular and, up to ``diffuse_bounces``, a diffuse ray, and follows one of the two."""
    following, going, passed = next_ray(context, lobes.specular(), REFLECTED, vertex, points, surface)
    scattered, scatters, _ = next_ray(
        context, lobes.diffuse(), DIFFUSE, vertex, points, surface & (bounces < context.settings.diffuse_bounces)
    )
    # The sources were sampled in full for the diffuse component: what this ray meets is no source.
    scattered = replace(scattered, counts=mi.Bool(False))
    a = dr.select(going, dr.max(following.throughput), 0)
    b = dr.select(scatters, dr.max(scattered.throughput), 0)
    p = dr.select(a + b > 0, b / dr.select(a + b > 0, a + b, 1), 0)
    # What chooses among lobes by itself has used the number of the choice; none is drawn from the refracted lobe here.
    chosen = context.facts.scattering.mixes or context.facts.scattering.inseparable
    choose = points.choice(context.space(vertex.ray.node, REFRACTED if chosen else CHOICE)) < p
    following = dr.select(choose, scattered, following)
    following.throughput *= dr.rcp(dr.detach(dr.select(choose, p, 1 - p)))
    return (
        following,
        dr.select(choose, scatters, going),
        dr.select(choose, 1, passed),
        dr.select(choose, bounces + 1, bounces),
    )


def roulette(context: Context, ray: Ray, active: mi.Bool, eta: mi.Float, sample: mi.Float) -> tuple[Ray, mi.Bool]:
    """The ray and its lanes after Russian roulette, from level ``rr_depth`` on."""
    survival = dr.detach(dr.minimum(dr.max(ray.throughput) * dr.square(eta), 0.95))
    plays = ray.level >= context.settings.rr_depth
    throughput = dr.select(plays, ray.throughput / dr.maximum(survival, 1e-8), ray.throughput)
    return replace(ray, throughput=throughput), active & dr.select(plays, sample < survival, True)
