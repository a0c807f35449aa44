"""Direct light: the sources, sampled at a vertex (sections 4.1, 5.2)."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..light.reparameterisation import reparameterised_sample
from ..light.strategy import Receiver
from ..light.table import Lamp
from ..masks import but_not
from ..sampling.sobol import Points
from . import lobes
from .context import NODE_SPACES, Context
from .media import beyond, transmittance
from .ray import Vertex, mis


def direct_light(context: Context, vertex: Vertex, points: Points) -> mi.Spectrum:
    """Light from the sources through the whole BRDF: every source by one point and one shadow ray (section 4.1), or
    one chosen lamp. Where photons were gathered before, through the diffuse lobes alone.
    """
    lights, receiver, active, gathered = context.lights, vertex.receiver, vertex.smooth, vertex.ray.gathered_photons
    first_space = context.space(vertex.ray.node, NODE_SPACES)
    other_pdf = None
    if context.photon_mis is not None:
        of_photons = active if gathered is None else but_not(active, gathered)
        other_pdf = context.photon_mis.light_pdf(vertex, of_photons)

    def light(lamp: Lamp, point: mi.Point2f, probability: mi.Float | None = None) -> mi.Spectrum:
        ds, weight = lamp.sample(receiver, point, active)
        pdf = ds.pdf
        if probability is not None:
            pdf, weight = pdf * probability, weight / probability
        if context.attached:
            ds.pdf, sample = pdf, (ds, weight)
            ds, weight = reparameterised_sample(
                context.scene, lights, lamp, receiver, sample, active, vertex.importance
            )
            pdf = ds.pdf
        lit = active & (pdf > 0)
        wo, mis_active = vertex.si.to_local(ds.d), lit
        f = mi.Spectrum(0)
        if context.light_lobes is not None:
            f = vertex.bsdf.eval(context.light_lobes, vertex.si, wo, lit)
        if gathered is not None:
            f = dr.select(gathered, vertex.bsdf.eval(lobes.diffuse(), vertex.si, wo, lit & gathered), f)
            mis_active = but_not(lit, gathered)
        for lobe in context.mis_lobes:
            f_lobe, pdf_lobe = context.scattering.eval_pdf(lobe, vertex.si, vertex.bsdf, wo, mis_active)
            if other_pdf is not None:
                pdf_lobe = other_pdf(ds, f_lobe, pdf_lobe, but_not(mis_active, ds.delta))
            f += f_lobe * dr.select(ds.delta, 1, mis(pdf, pdf_lobe))
        f = context.scattering.or_all_lobes(f, vertex.si, vertex.bsdf, wo, lit, vertex.inseparable)
        return unless_in_shadow(context, vertex, ds.p, f * weight, lit)

    if lights.sampler is None:
        L = lights.for_each(
            lambda lamp, L: L + light(lamp, points(first_space + lamp.k, active)),
            mi.Spectrum(0),
            active,
            attached=context.attached,
        )
    else:
        assert vertex.importance is not None
        point = points(first_space, active)
        k, probability, rest = lights.sampler.choose(receiver, vertex.importance, point.x, active)
        L = light(lights.lamp(k), mi.Point2f(rest, point.y), probability)
    if lights.sky is not None and context.light_lobes is not None:
        L += sky_light(context, vertex, points, first_space + lights.lamps)
    return L


def sky_light(context: Context, vertex: Vertex, points: Points, space: mi.UInt32) -> mi.Spectrum:
    """Light from a constant sky through the lobes without a ray of their own: the other lobes' rays meet the sky.
    ``space``: of the pattern.
    """
    assert context.lights.sky is not None
    si, bsdf, scattering = vertex.si, vertex.bsdf, context.scattering
    flags = bsdf.flags()
    active = vertex.smooth & (lobes.has_any(flags, *lobes.DIFFUSE) | vertex.inseparable)
    receiver = vertex.receiver
    if context.both_sides:
        both_sides = receiver.both_sides & active & (lobes.has_any(flags, "DiffuseTransmission") | vertex.inseparable)
        receiver = Receiver(si, receiver.n, both_sides)
    ds, weight = context.lights.sky.sample(receiver, points(space, active), active)
    lit, wo = active & (ds.pdf > 0), si.to_local(ds.d)
    f = scattering.or_all_lobes(bsdf.eval(context.light_lobes, si, wo, lit), si, bsdf, wo, lit, vertex.inseparable)
    return unless_in_shadow(context, vertex, ds.p, f * weight, lit)


def unless_in_shadow(context: Context, vertex: Vertex, p: mi.Point3f, L: mi.Spectrum, active: mi.Bool) -> mi.Spectrum:
    """``L``, less what is absorbed, where nothing is between ``vertex`` and the point ``p``; else 0."""
    si = vertex.si
    if context.settings.shadows:
        active = active & (dr.max(dr.abs(L)) > 0)
        active = but_not(active, context.scene.ray_test(si.spawn_ray_to(p), active))
    if context.absorbs:
        d = p - si.p
        L = L * transmittance(beyond(si, vertex.ray.medium, d, active), si.wavelengths, dr.norm(d), active)
    return dr.select(active, L, 0)
