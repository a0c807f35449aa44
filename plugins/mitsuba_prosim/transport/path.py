"""Kajiya's paths: each surface continues one ray, by a specular or a diffuse lobe (thesis, section 4.2.3)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from ..sampling.sobol import Points
from . import lobes
from .next_ray import next_ray, roulette
from .ray import Ray, Vertex
from .transport_context import CHOICE, REFRACTED, ROULETTE, Context


@dataclass
class Counters:
    """Counters of a path."""

    #: Number of diffuse reflections so far. None where this number is unlimited: a variable that no iteration changes
    #: makes Dr.Jit trace the loop twice.
    bounces: mi.UInt32 | None
    #: Product of the ratios of the indices of refraction at the surfaces that the path crossed so far.
    eta: mi.Float


def start(context: Context, ray: Ray) -> Counters:
    """Returns the counters of a path that begins with the camera's ``ray``."""
    return Counters(mi.UInt32(0) if context.settings.diffuse_bounces >= 0 else None, mi.Float(1))


def proceed(
    context: Context, vertex: Vertex, points: Points, active: mi.Bool, counters: Counters
) -> tuple[Ray, mi.Bool, Counters]:
    """Samples the ray that continues the path after ``vertex``, and returns ``(ray, active, counters)``.

    The returned ``active`` has the lanes whose path continues after Russian roulette, which begins at level
    ``rr_depth``; the returned ``counters`` count this ray too. The argument ``active`` is unused: it gives this
    function the signature of :func:`.tree.proceed`.
    """
    bounces, node = counters.bounces, vertex.ray.node
    if bounces is None:
        ray, continues, eta = next_ray(context, mi.BSDFContext(), vertex, points, vertex.active)
    else:
        ray, continues, eta, bounces = specular_or_diffuse(context, vertex, points, bounces)
    ray.node = node + 1
    eta *= counters.eta
    # The factor eta² makes up for the scaling of radiance inside glass, which is not a loss of light.
    survival = dr.minimum(dr.max(ray.throughput) * dr.square(eta), 0.95)
    survival = dr.select(ray.level >= context.settings.rr_depth, survival, 1)
    ray, continues = roulette(ray, continues, survival, points.choice(context.space(node, ROULETTE)))
    return ray, continues, Counters(bounces, eta)


def specular_or_diffuse(
    context: Context, vertex: Vertex, points: Points, bounces: mi.UInt32
) -> tuple[Ray, mi.Bool, mi.Float, mi.UInt32]:
    """Returns ``(ray, active, eta, bounces)`` of a specular or a diffuse ray that leaves ``vertex``.

    A specular and a diffuse ray are sampled; one of the two is chosen with a probability proportional to its
    throughput, and its throughput is divided by this probability. After ``diffuse_bounces`` diffuse reflections the ray
    is always specular. ``bounces`` is the number of diffuse reflections of the path, ``eta`` the ratio of the indices
    of refraction that the ray crosses.
    """
    specular, reflects, eta = next_ray(context, lobes.only(lobes.SPECULAR), vertex, points, vertex.active)
    may_scatter = vertex.active & (bounces < context.settings.diffuse_bounces)
    diffuse, scatters, _ = next_ray(context, lobes.only(lobes.DIFFUSE), vertex, points, may_scatter)
    diffuse = replace(diffuse, light_found=mi.Bool(True))  # by light sampling and photons
    specular_weight = dr.select(reflects, dr.max(specular.throughput), 0)
    diffuse_weight = dr.select(scatters, dr.max(diffuse.throughput), 0)
    total = specular_weight + diffuse_weight
    p_diffuse = dr.select(total > 0, diffuse_weight / dr.select(total > 0, total, 1), 0)
    # With the workarounds, the space CHOICE already chose a lobe. A path uses the space REFRACTED for nothing else.
    # Without the workarounds, no BSDF has a diffuse lobe and two specular lobes: the number in CHOICE is still unused.
    choice = REFRACTED if context.scattering.needs_workarounds else CHOICE
    takes_diffuse = points.choice(context.space(vertex.ray.node, choice)) < p_diffuse
    diffuse_state, specular_state = (diffuse, scatters, mi.Float(1), bounces + 1), (specular, reflects, eta, bounces)
    ray, active, eta, bounces = dr.select(takes_diffuse, diffuse_state, specular_state)
    ray.throughput *= dr.rcp(dr.detach(dr.select(takes_diffuse, p_diffuse, 1 - p_diffuse)))
    return ray, active, eta, bounces
