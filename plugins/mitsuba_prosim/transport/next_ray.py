"""The ray that leaves a vertex through one of its lobes (section 4.1)."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi

from ..masks import but_not, idle
from ..sampling.sobol import Points
from . import lobes
from .context import CHOICE, REFRACTED, Context
from .media import beyond
from .ray import Ray, Vertex, viewer_side
from .reparameterised import carried_ray


def next_ray(
    context: Context, lobe: mi.BSDFContext, k: int, vertex: Vertex, points: Points, active: mi.Bool
) -> tuple[Ray, mi.Bool, mi.Float]:
    """Samples the ray that leaves ``vertex`` through ``lobe``: the ray, its lanes, and the ratio of the indices of
    refraction that it crosses. ``k``: the vertex's space for its direction.
    """
    ray, si, bsdf, facts = vertex.ray, vertex.si, vertex.bsdf, context.facts
    if idle(active):
        return ray, active, mi.Float(1)
    choice, point = choice_and_point(context, lobe, k, ray, points, active)
    whole = facts.scattering.whole(bsdf, active)

    def sample(active: mi.Bool) -> tuple[mi.BSDFSample3f, mi.Spectrum, mi.Bool]:
        return facts.scattering.sample(lobe, si, bsdf, choice, point, ray.throughput, active, whole)

    with dr.suspend_grad(when=context.attached):
        bs, weight, belongs = sample(active)
        d = si.to_world(bs.wo)
    ideal = lobes.has_any(bs.sampled_type, *lobes.IDEAL)
    o, pdf = si.spawn_ray(d).o, bs.pdf
    if context.attached:
        moved, weight, pdf_attached = weight_with_derivatives(context, lobe, vertex, d, but_not(active, ideal), whole)
        if facts.ideal:
            forced, ideal_weight, _ = sample(active & ideal)
            moved = dr.select(ideal, si.to_world(forced.wo), moved)
            weight = dr.select(ideal, ideal_weight, weight)
        o, d, pdf = dr.replace_grad(o, si.p), dr.replace_grad(d, moved), dr.replace_grad(pdf, pdf_attached)
    throughput = ray.throughput * weight
    active = active & belongs & (bs.pdf > 0) & (dr.max(throughput) > context.settings.cutoff)
    if context.settings.max_level >= 0 and facts.lights.can_foresee:
        # The rays below the deepest level can only end in a source.
        may_meet = facts.lights.may_meet(dr.detach(o), dr.detach(d))
        active = active & ((ray.level < context.settings.max_level) | may_meet)
    following = replace(
        ray,
        o=o,
        d=d,
        throughput=throughput,
        level=ray.level + 1,
        node=ray.node * 2 + (k == REFRACTED),
        pdf=pdf,
        shares=but_not(mi.Bool(True), ideal),
        n=viewer_side(si),
        estimates=vertex.estimates,
    )
    with_flags(context, vertex, following, ideal, whole)
    if context.photon_mis is not None:
        following.etendue = context.photon_mis.next(vertex, following, bs, weight, whole)
    if facts.absorbs:
        following.medium = beyond(si, ray.medium, dr.detach(d), active)
        following.gap = dr.dot(o - si.p, d)
    return following, active, bs.eta


def choice_and_point(
    context: Context, lobe: mi.BSDFContext, k: int, ray: Ray, points: Points, active: mi.Bool
) -> tuple[mi.Float, mi.Point2f]:
    """The number that chooses among lobes or wavelengths, and the point that chooses the direction."""
    space, scattering = context.space(ray.node, CHOICE), context.facts.scattering
    # Strata pay only where all lobes are sampled together, and with dispersion.
    stratified = lobes.is_everything(lobe) or scattering.disperses
    choice = points(space, active).x if stratified else points.choice(space)
    return scattering.choice(points, space, choice), points(context.space(ray.node, k), active)


def weight_with_derivatives(
    context: Context, lobe: mi.BSDFContext, vertex: Vertex, d: mi.Vector3f, active: mi.Bool, whole: mi.Bool
) -> tuple[mi.Vector3f, mi.Spectrum, mi.Float]:
    """``(d, weight, pdf)`` of a smooth lobe, evaluated again with derivatives: the direction moves with the source that
    it meets.
    """
    si = vertex.si
    moved, jacobian = carried_ray(context.scene, context.facts.lights, si, viewer_side(si), d, active)
    f, pdf = context.facts.scattering.eval_pdf(lobe, si, vertex.bsdf, si.to_local(moved), active, whole)
    return moved, f * dr.relative_grad(jacobian) / dr.detach(dr.select(pdf > 0, pdf, 1)), pdf


def with_flags(context: Context, vertex: Vertex, following: Ray, ideal: mi.Bool, whole: mi.Bool) -> None:
    """Sets which emission ``following`` counts; see :class:`.Ray`. ``ideal``: the lanes of ideal lobes."""
    ray = vertex.ray
    if ray.counts is not None:
        following.counts = mi.Bool(True)
        if context.facts.scattering.inseparable:
            following.counts = but_not(following.counts, but_not(whole, ideal))
    if ray.gathered is not None:
        following.gathered = ray.gathered | but_not(whole, ideal)
        following.counts = but_not(following.counts, following.gathered)
    if context.facts.both_sides:
        following.both_sides = lobes.has_any(vertex.bsdf.flags(), *lobes.BOTH_SIDES)
