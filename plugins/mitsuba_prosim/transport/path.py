"""Kajiya's paths: each surface continues one ray, also from a diffuse component (section 4.2.3)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from ..sampling.sobol import Points
from . import lobes
from .next_ray import next_ray
from .ray import Ray, Vertex
from .transport_context import CHOICE, REFRACTED, ROULETTE, Context


@dataclass
class Progress:
    """Counters of a path."""

    #: Number of diffuse reflections so far; None where it is unlimited, as Dr.Jit traces a loop twice in which a
    #: variable stays as it is.
    bounces: mi.UInt32 | None
    #: Product of the ratios of the indices crossed so far.
    eta: mi.Float


def start(context: Context, ray: Ray) -> Progress:
    """The progress of a path that begins with the camera's ``ray``."""
    return Progress(mi.UInt32(0) if context.settings.diffuse_bounces >= 0 else None, mi.Float(1))


def proceed(
    context: Context, vertex: Vertex, points: Points, active: mi.Bool, progress: Progress
) -> tuple[Ray, mi.Bool, Progress]:
    """``(ray, active, progress)``: the ray that continues the path after ``vertex``, and its lanes."""
    bounces, node = progress.bounces, vertex.ray.node
    if bounces is None:
        ray, going, eta = next_ray(context, lobes.all_lobes(), vertex, points, vertex.active)
    else:
        ray, going, eta, bounces = specular_or_diffuse(context, vertex, points, bounces)
    ray.node = node + 1
    # Radiance within glass is scaled by the square of its index, which is lost again at the way out.
    eta *= progress.eta
    ray, going = roulette(context, ray, going, eta, points.choice(context.space(node, ROULETTE)))
    return ray, going, Progress(bounces, eta)


def specular_or_diffuse(
    context: Context, vertex: Vertex, points: Points, bounces: mi.UInt32
) -> tuple[Ray, mi.Bool, mi.Float, mi.UInt32]:
    """``(ray, active, eta, bounces)``: a specular ray or, up to ``diffuse_bounces``, a diffuse one: both are sampled,
    and one is chosen by its throughput.
    """
    specular, reflects, eta = next_ray(context, lobes.specular(), vertex, points, vertex.active)
    more = vertex.active & (bounces < context.settings.diffuse_bounces)
    diffuse, scatters, _ = next_ray(context, lobes.diffuse(), vertex, points, more)
    # Light sampling, and photons, took all of the diffuse lobe: emission that this ray meets does not count.
    diffuse = replace(diffuse, sees_emission=mi.Bool(False))
    if diffuse.gathered_photons is not None:
        diffuse.gathered_photons = mi.Bool(True)
    a = dr.select(reflects, dr.max(specular.throughput), 0)
    b = dr.select(scatters, dr.max(diffuse.throughput), 0)
    p = dr.select(a + b > 0, b / dr.select(a + b > 0, a + b, 1), 0)
    # Code that chooses among lobes has already used the number of the choice; no ray is only refracted here.
    chosen = context.scattering.mixes or context.scattering.any_inseparable
    choose = points.choice(context.space(vertex.ray.node, REFRACTED if chosen else CHOICE)) < p
    of_diffuse, of_specular = (diffuse, scatters, mi.Float(1), bounces + 1), (specular, reflects, eta, bounces)
    ray, active, eta, bounces = dr.select(choose, of_diffuse, of_specular)
    ray.throughput *= dr.rcp(dr.detach(dr.select(choose, p, 1 - p)))
    return ray, active, eta, bounces


def roulette(context: Context, ray: Ray, active: mi.Bool, eta: mi.Float, sample: mi.Float) -> tuple[Ray, mi.Bool]:
    """The ray and its lanes after Russian roulette, from level ``rr_depth`` on."""
    survival = dr.detach(dr.minimum(dr.max(ray.throughput) * dr.square(eta), 0.95))
    plays = ray.level >= context.settings.rr_depth
    throughput = dr.select(plays, ray.throughput / dr.maximum(survival, 1e-8), ray.throughput)
    return replace(ray, throughput=throughput), active & dr.select(plays, sample < survival, True)
