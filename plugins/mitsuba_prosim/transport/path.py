"""Kajiya's paths: at each surface, one ray continues the path, through a specular or a diffuse lobe (thesis, section
4.2.3).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from ..sampling.sobol import Points
from ..sampling.spaces import CHOICE, REFRACTED, ROULETTE
from . import lobes
from .next_ray import next_ray, roulette
from .ray import Ray, Vertex
from .transport_context import Context


@dataclass
class Counters:
    """A path's number of diffuse reflections, and the product of the relative indices that it crossed."""

    #: Number of diffuse reflections so far. None where this number is unlimited: a variable that no iteration changes
    #: makes Dr.Jit trace the loop twice.
    bounces: mi.UInt32 | None
    #: Product of the relative indices of refraction at the surfaces that the path crossed so far.
    eta: mi.Float


def start(context: Context, ray: Ray) -> Counters:
    """Returns the :class:`Counters` at the start of a path; ``ray`` is unused (:func:`.tree.start` needs it)."""
    return Counters(mi.UInt32(0) if context.settings.diffuse_bounces >= 0 else None, mi.Float(1))


def proceed(
    context: Context, vertex: Vertex, points: Points, active: mi.Bool, counters: Counters
) -> tuple[Ray, mi.Bool, Counters]:
    """Samples the ray that continues the path after ``vertex``; returns ``(ray, active, counters)``.

    If the number of diffuse reflections is unlimited, the ray is sampled from all lobes together; else it leaves
    through a specular or a diffuse lobe. Russian roulette begins at level ``rr_depth``: the probability of survival is
    the greatest component of the throughput, times eta², but at most 0.95. ``active`` is unused (:func:`.tree.proceed`
    needs it).
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
    """Returns ``(ray, active, eta, bounces)`` for one ray that leaves ``vertex`` through a specular or a diffuse lobe.

    The function samples one ray of each, and chooses in proportion to the greatest component of its throughput, which
    is then divided by the probability of the choice. After ``diffuse_bounces`` diffuse reflections, counted by
    ``bounces``, all rays are specular. ``eta`` is that of :func:`.next_ray`.
    """
    specular, reflects, eta = next_ray(context, lobes.only(lobes.SPECULAR), vertex, points, vertex.active)
    may_scatter = vertex.active & (bounces < context.settings.diffuse_bounces)
    diffuse, scatters, _ = next_ray(context, lobes.only(lobes.DIFFUSE), vertex, points, may_scatter)
    diffuse = replace(diffuse, light_found=mi.Bool(True))  # by light sampling and photons at ``vertex``
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
