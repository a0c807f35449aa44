"""The rays that go on from a node, through its lobes (section 4.1)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi

from ..masks import but_not, idle
from ..sampling.sobol import Points
from . import lobes, scattering, workarounds
from .context import CHOICE, REFRACTED, Stage
from .media import beyond
from .merging import with_reach
from .ray import Node, Ray, viewer_side
from .reparameterised import carried_ray
from .workarounds import belongs_to, is_whole


def follow(
    stage: Stage, lobe: mi.BSDFContext, k: int, ray: Ray, node: Node, points: Points, active: mi.Bool
) -> tuple[Ray, mi.Bool, mi.Float]:
    """Draws the ray that goes on from ``node`` through the lobes of the ``mi.BSDFContext`` ``lobe``.

    Returns the ray, the lanes that follow it and the ratio of the indices that it crosses. ``k``: its space in the
    node.
    """
    if idle(active):
        return ray, active, mi.Float(1)
    settings, lights, si, bsdf = stage.settings, stage.facts.lights, node.si, node.bsdf
    space = stage.space(ray.node, CHOICE)
    # Only whole BSDFs choose among lobes often enough for strata to pay, and glass that disperses.
    stratified = lobes.is_everything(lobe) or stage.facts.disperses
    choice = points(space, active).x if stratified else points.choice(space)
    choice = scattering.evenly(points, space, choice) if stage.facts.disperses else choice
    sample = points(stage.space(ray.node, k), active)
    counts, whole = None if ray.counts is None else mi.Bool(True), mi.Bool(False)
    with dr.suspend_grad(when=stage.attached):
        bs, weight = sample_lobe(stage, lobe, ray, si, bsdf, choice, sample, active)
        # thindielectric samples another lobe than it is asked for: that has a turn of its own.
        belongs = (bs.sampled_type & lobe.type_mask) != 0
        if stage.facts.indivisible:
            whole = active & is_whole(bsdf, active)
            bs, weight, belongs = sample_whole(stage, lobe, si, bsdf, choice, sample, whole, (bs, weight, belongs))
            counts = but_not(counts, but_not(whole, lobes.has_any(bs.sampled_type, "Delta", "Null")))
        d = si.to_world(bs.wo)
    ideal = lobes.has_any(bs.sampled_type, "Delta", "Null")
    o, pdf = si.spawn_ray(d).o, bs.pdf
    if stage.attached:
        drawn = but_not(active, ideal)
        moved, jacobian = carried_ray(stage.scene, lights, si, viewer_side(si), d, drawn)
        f, pdf = workarounds.eval_pdf(lobe, si, bsdf, si.to_local(moved), drawn, stage.facts.careful)
        if stage.facts.indivisible:
            f_whole, pdf_whole = bsdf.eval_pdf(lobes.everything(), si, si.to_local(moved), but_not(whole, ideal))
            f, pdf = dr.select(whole, f_whole, f), dr.select(whole, pdf_whole, pdf)
        weight = f * dr.relative_grad(jacobian) / dr.detach(dr.select(pdf > 0, pdf, 1))
        if stage.facts.ideal:
            forced, ideal_weight = sample_lobe(stage, lobe, ray, si, bsdf, choice, sample, active & ideal)
            if stage.facts.indivisible:
                forced, ideal_weight, _ = sample_whole(
                    stage, lobe, si, bsdf, choice, sample, whole & ideal, (forced, ideal_weight, belongs)
                )
            moved = dr.select(ideal, si.to_world(forced.wo), moved)
            weight = dr.select(ideal, ideal_weight, weight)
        o, d, pdf = dr.replace_grad(o, si.p), dr.replace_grad(d, moved), dr.replace_grad(bs.pdf, pdf)
    throughput = ray.throughput * weight
    active = active & belongs & (bs.pdf > 0) & (dr.max(throughput) > settings.cutoff)
    if settings.max_level >= 0 and lights.can_foresee:
        # The rays below the deepest level can only end in a source.
        active = active & ((ray.level < settings.max_level) | lights.may_meet(dr.detach(o), dr.detach(d)))
    following = replace(
        ray,
        o=o,
        d=d,
        throughput=throughput,
        level=ray.level + 1,
        node=ray.node * 2 + (k == REFRACTED),
        pdf=pdf,
        shares=but_not(mi.Bool(True), ideal),
        counts=counts,
        n=viewer_side(si),
        estimates=node.estimates,
    )
    if stage.merging is not None:
        following = with_reach(stage, ray, node, following, bs, weight, whole)
    if ray.gathered is not None:
        following.gathered = ray.gathered | but_not(whole, ideal)
        following.counts = but_not(following.counts, following.gathered)
    if stage.facts.absorbs:
        following.medium = beyond(si, ray.medium, dr.detach(d), active)
        following.gap = dr.dot(o - si.p, d)
    if stage.facts.both_sides:
        following.both_sides = lobes.has_any(bsdf.flags(), *lobes.BOTH_SIDES)
    return following, active, bs.eta


def sample_lobe(
    stage: Stage,
    lobe: mi.BSDFContext,
    ray: Ray,
    si: mi.SurfaceInteraction3f,
    bsdf: mi.BSDF | mi.BSDFPtr,
    choice: mi.Float,
    sample: mi.Point2f,
    active: mi.Bool,
) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
    """A sample of ``lobe``, in glass that disperses of a wavelength that ``ray`` still carries."""
    if stage.facts.disperses or stage.facts.careful:
        throughput = ray.throughput if stage.facts.disperses else None
        return scattering.sample(lobe, si, bsdf, choice, sample, throughput, active)
    return bsdf.sample(lobe, si, choice, sample, active)


def sample_whole(
    stage: Stage,
    lobe: mi.BSDFContext,
    si: mi.SurfaceInteraction3f,
    bsdf: mi.BSDF | mi.BSDFPtr,
    choice: mi.Float,
    sample: mi.Point2f,
    whole: mi.Bool,
    others: tuple[Any, ...],
) -> tuple[Any, ...]:
    """``(bs, weight, belongs)``: ``others`` but for the lanes ``whole``, where all lobes of ``bsdf`` are sampled, and
    ``belongs`` says whether the sample counts for ``lobe``.
    """
    if idle(whole):
        return others
    bs, weight = workarounds.sample_all(lobes.everything(), si, bsdf, choice, sample, whole, stage.facts.careful)
    return tuple(dr.select(whole, a, b) for a, b in zip((bs, weight, belongs_to(lobe, si.wi, bs)), others))
