"""Sampling of the next ray: the ray that leaves a vertex through one lobe (thesis, section 4.1)."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi

from ..light.reparameterisation import reparameterised_ray
from ..masks import but_not, idle
from ..sampling.sobol import Points
from ..sampling.spaces import CHOICE, REFRACTED
from . import lobes
from .absorption import medium_beyond
from .lobes import LobePoint
from .ray import Ray, Vertex
from .transport_context import Context, direction_space


def next_ray(
    context: Context, lobe: mi.BSDFContext, vertex: Vertex, points: Points, active: mi.Bool
) -> tuple[Ray, mi.Bool, mi.Float]:
    """Samples the ray that leaves ``vertex`` through ``lobe``, and returns ``(ray, active, eta)``.

    The returned ``active`` is false, too, where the sample belongs to another lobe, or the throughput is at most the
    integrator's ``cutoff`` in all channels. ``eta`` is the relative index of refraction in the direction of the ray, 1
    for a reflection. In scalar variants, the arriving ray is returned if ``active`` is false.
    """
    ray, si, space = vertex.ray, vertex.si, direction_space(lobe)
    if idle(active):
        return ray, active, mi.Float(1)
    bs, weight, d, belongs = sample_direction(context, lobe, vertex, points, active)
    ideal = lobes.has_any(bs.sampled_type, *lobes.IDEAL)
    o, throughput = si.spawn_ray(dr.detach(d)).o, ray.throughput * weight
    if context.attached:  # the small offset of the origin has no derivative
        o = dr.replace_grad(o, si.p)
    active = active & belongs & (bs.pdf > 0) & (dr.max(throughput) > context.settings.cutoff)
    result = replace(ray, o=o, d=d, throughput=throughput, pdf=dr.select(ideal, 0, bs.pdf))
    # The number of the node in a ray tree; a path replaces this number.
    result.level, result.node = ray.level + 1, ray.node * 2 + (space == REFRACTED)
    result.n, result.importance = vertex.receiver.n, vertex.receiver.importance
    result.medium, result.offset = medium_beyond(si, ray.medium, dr.detach(d), active), dr.dot(o - si.p, d)
    by_all_lobes = but_not(vertex.inseparable, ideal)  # light sampling and photons found the light of all lobes
    result.light_found = by_all_lobes if context.caustics is None else ray.light_found | by_all_lobes
    if ray.passed is not None:
        result.passed = ray.passed & lobes.has_any(bs.sampled_type, "Null")
    if context.both_sides:
        result.both_sides = lobes.has_any(vertex.bsdf.flags(), *lobes.BOTH_SIDES)
    if context.photon_mis is not None:
        result = context.photon_mis.next(vertex, result, bs, weight)
    context.observe("scatter", ray, after=result, bs=bs, active=active)
    return result, active, bs.eta


def sample_direction(
    context: Context, lobe: mi.BSDFContext, vertex: Vertex, points: Points, active: mi.Bool
) -> tuple[mi.BSDFSample3f, mi.Spectrum, mi.Vector3f, mi.Bool]:
    """Returns ``(bs, weight, d, belongs)``: the sample of ``lobe`` that light sampling has already drawn
    (``vertex.drawn``), or a new one, its direction in world coordinates, and whether it is a sample of ``lobe``.

    If derivatives are wanted, the direction of a smooth lobe follows the light source that the ray meets, and the
    derivatives of the density and the weight include this motion. The direction of an ideal lobe has the derivatives
    that the BSDF computes.
    """
    si, scattering, throughput = vertex.si, context.scattering, vertex.ray.throughput
    if lobe.type_mask in vertex.drawn:
        bs, weight = vertex.drawn[lobe.type_mask]
        return bs, weight, si.to_world(bs.wo), (bs.sampled_type & lobe.type_mask) != 0
    u = lobe_point(context, lobe, vertex, points, active)
    with dr.suspend_grad(when=context.attached):
        bs, weight, belongs = scattering.sample(lobe, vertex, u, active, throughput)
        d = si.to_world(bs.wo)
    if not context.attached:
        return bs, weight, d, belongs
    ideal = lobes.has_any(bs.sampled_type, *lobes.IDEAL)
    smooth = but_not(active, ideal)
    moved, jacobian = reparameterised_ray(context.lights, vertex.receiver, d, smooth)
    wo = si.to_local(moved)
    f, pdf = scattering.eval_pdf(lobe, vertex, wo, smooth)
    weight = f * dr.relative_grad(jacobian) / dr.detach(dr.select(pdf > 0, pdf, 1))
    if lobes.has_any(context.flags, *lobes.IDEAL):  # sampled again, now with derivatives
        ideal_bs, ideal_weight, _ = scattering.sample(lobe, vertex, u, active & ideal, throughput)
        moved = dr.select(ideal, si.to_world(ideal_bs.wo), moved)
        weight = dr.select(ideal, ideal_weight, weight)
    bs.pdf = dr.replace_grad(bs.pdf, pdf)
    return bs, weight, dr.replace_grad(d, moved), belongs


def roulette(ray: Ray, active: mi.Bool, survival: mi.Float, sample: mi.Float) -> tuple[Ray, mi.Bool]:
    """Returns ``(ray, active)`` after Russian roulette (Arvo and Kirk 1990): a ray survives with the probability
    ``survival``, by which its throughput is divided; ``sample`` is in [0, 1).
    """
    survival = dr.detach(survival)
    survives = sample < survival
    throughput = dr.select(survives, ray.throughput / dr.clip(survival, 1e-8, 1), 0)
    return replace(ray, throughput=throughput), active & survives


def lobe_point(context: Context, lobe: mi.BSDFContext, vertex: Vertex, points: Points, active: mi.Bool) -> LobePoint:
    """Returns the random numbers that choose one of the lobes in ``lobe``, or a wavelength at dispersive glass, and
    sample the direction of the ray from ``vertex``.
    """
    space = context.space(vertex.ray.node, CHOICE)
    # A stratified choice reduces the variance only with dispersion, or where all lobes are sampled together.
    stratified = lobe.type_mask == mi.BSDFContext().type_mask or context.scattering.disperses
    choice = points(space, active).x if stratified else points.choice(space)
    point = points(context.space(vertex.ray.node, direction_space(lobe)), active)
    return context.scattering.lobe_choice(points, space, choice), point
