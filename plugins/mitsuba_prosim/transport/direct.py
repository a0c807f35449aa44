"""Direct light: the sources, sampled at a vertex (sections 4.1, 5.2)."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi

from ..light.table import Lamp
from ..masks import but_not
from ..sampling.sobol import Points
from . import lobes
from .context import NODE_SPACES, Context
from .media import beyond, transmittance
from .ray import Ray, mis, viewer_side
from .reparameterised import carried_sample


def direct_light(
    context: Context,
    ray: Ray,
    si: mi.SurfaceInteraction3f,
    bsdf: mi.BSDF | mi.BSDFPtr,
    points: Points,
    active: mi.Bool,
    scattered: mi.Bool | bool = False,
) -> tuple[mi.Spectrum, mi.Float | None]:
    """Light from the sources through the whole BRDF, and the sum of the lamps' estimates (:attr:`.Ray.estimates`).

    Every source is sampled by one point and one shadow ray (section 4.1); where paths choose, one lamp alone.

    ``scattered``: the lanes that are lit through the diffuse lobes alone.
    """
    lights, alone = context.facts.lights, context.facts.alone
    flags = bsdf.flags()
    active = active & mi.has_flag(flags, mi.BSDFFlags.Smooth)
    n = viewer_side(si)
    both_sides = active & lobes.has_any(flags, *lobes.BOTH_SIDES) if context.facts.both_sides else False
    first_space = context.space(ray.node, NODE_SPACES)
    scattering, photon_mis = context.facts.scattering, context.photon_mis
    whole = scattering.whole(bsdf, active)
    others = None if photon_mis is None else photon_mis.light_pdf(ray, si, bsdf, but_not(active, scattered))

    estimates = None if lights.sampler is None else lights.sampler.total(si.p, n, both_sides, active)

    def light(lamp: Lamp, point: mi.Point2f, probability: mi.Float | float = 1) -> mi.Spectrum:
        sample = lamp.sample(si, n, both_sides, point, active)
        if estimates is not None:
            sample = replace(sample, pdf=sample.pdf * probability, weight=sample.weight / probability)
        if context.attached:
            sample = carried_sample(context.scene, lights, lamp, si, n, both_sides, sample, active, estimates)
        lit = active & (sample.pdf > 0)
        wo = si.to_local(sample.d)
        f = bsdf.eval(alone, si, wo, lit) if alone is not None else mi.Spectrum(0)
        glossy = lit
        if scattered is not False:
            f = dr.select(scattered, bsdf.eval(lobes.diffuse(), si, wo, lit & scattered), f)
            glossy = but_not(lit, scattered)
        for lobe in context.facts.partners:
            f_lobe, pdf_lobe = scattering.eval_pdf(lobe, si, bsdf, wo, glossy)
            if others is not None:
                pdf_lobe = others(sample.ds, f_lobe, pdf_lobe, but_not(glossy, sample.delta))
            f += f_lobe * dr.select(sample.delta, 1, mis(sample.pdf, pdf_lobe))
        f = scattering.or_whole(f, si, bsdf, wo, lit, whole)
        return unless_in_shadow(context, ray, si, sample.p, f * sample.weight, lit)

    if lights.sampler is None or estimates is None:
        L = lights.for_each(
            lambda lamp, L: L + light(lamp, points(first_space + lamp.k, active)),
            mi.Spectrum(0),
            active,
            attached=context.attached,
        )
    else:
        point = points(first_space, active)
        k, probability, rest = lights.sampler.choose(si.p, n, both_sides, estimates, point.x, active)
        L = light(lights.lamp(k), mi.Point2f(rest, point.y), probability)
    if lights.sky is not None and alone is not None:
        # The rays that are drawn from the other lobes meet the sky by themselves.
        active = active & (lobes.has_any(flags, *lobes.DIFFUSE) | whole)
        if context.facts.both_sides:
            both_sides &= active & (lobes.has_any(flags, "DiffuseTransmission") | whole)
        sample = lights.sample_sky(si, n, both_sides, points(first_space + lights.lamps, active), active)
        lit, wo = active & (sample.pdf > 0), si.to_local(sample.d)
        f = scattering.or_whole(bsdf.eval(alone, si, wo, lit), si, bsdf, wo, lit, whole)
        L += unless_in_shadow(context, ray, si, sample.p, f * sample.weight, lit)
    return L, estimates


def unless_in_shadow(
    context: Context, ray: Ray, si: mi.SurfaceInteraction3f, p: mi.Point3f, L: mi.Spectrum, active: mi.Bool
) -> mi.Spectrum:
    """``L``, less what is absorbed, where nothing is between ``si``, met by ``ray``, and the point ``p``; else 0."""
    if context.settings.shadows:
        active = active & (dr.max(dr.abs(L)) > 0)
        active = but_not(active, context.scene.ray_test(si.spawn_ray_to(p), active))
    if context.facts.absorbs:
        d = p - si.p
        L = L * transmittance(beyond(si, ray.medium, d, active), si.wavelengths, dr.norm(d), active)
    return dr.select(active, L, 0)
