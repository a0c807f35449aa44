"""Direct light: the sources, sampled at a vertex (sections 4.1, 5.2)."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..light.reparameterisation import reparameterised_sample
from ..light.strategy import Receiver
from ..light.table import Lamp
from ..masks import but_not
from ..sampling.nrook import SamplerPoints
from ..sampling.sobol import Points
from . import lobes
from .absorption import beyond, transmittance
from .next_ray import lobe_numbers
from .radiance import Radiance
from .ray import Vertex, mis
from .transport_context import NODE_SPACES, Context


def direct_light(context: Context, vertex: Vertex, points: Points) -> Radiance:
    """Light from the sources through the whole BRDF: every source by one point and one shadow ray (section 4.1), or
    one chosen lamp. Where photons were gathered before, through the diffuse lobes alone.
    """
    lights, layers, ray, active = context.lights, context.layers, vertex.ray, vertex.smooth
    space = context.space(ray.node, NODE_SPACES)
    other_pdf = None
    if context.photon_mis is not None:
        of_photons = active if ray.gathered_photons is None else but_not(active, ray.gathered_photons)
        other_pdf = context.photon_mis.light_pdf(vertex, of_photons)
    if lights.sampler is None:
        L = lights.for_each(
            lambda lamp, L: L + lamp_light(context, vertex, points, lamp, points(space + lamp.k, active), other_pdf),
            layers.none(),
            active,
            attached=context.attached,
        )
    else:
        assert vertex.importance is not None
        point = points(space, active)
        k, probability, rest = lights.sampler.choose(vertex.receiver, vertex.importance, point.x, active)
        L = lamp_light(context, vertex, points, lights.lamp(k), mi.Point2f(rest, point.y), other_pdf, probability)
    if lights.sky is not None and context.light_lobes is not None:
        value = sky_light(context, vertex, points, space + lights.lamps)
        L = L.plus(value, layers.of(ray, "diffuse", lambda: lights.lamps))
    return L


def lamp_light(
    context: Context,
    vertex: Vertex,
    points: Points,
    lamp: Lamp,
    point: mi.Point2f,
    other_pdf: Any = None,
    probability: mi.Float | None = None,
) -> Radiance:
    """Light from the ``point`` in [0, 1)² of ``lamp``, which was chosen with this ``probability``. ``other_pdf``: see
    :meth:`.PhotonMIS.light_pdf`.
    """
    si, bsdf, ray, active, gathered = vertex.si, vertex.bsdf, vertex.ray, vertex.smooth, vertex.ray.gathered_photons
    ds, weight = lamp.sample(vertex.receiver, point, active)
    pdf = ds.pdf
    if probability is not None:
        pdf, weight = pdf * probability, weight / probability
    if context.attached:
        ds.pdf, sample = pdf, (ds, weight)
        scene, lights = context.scene, context.lights
        ds, weight = reparameterised_sample(scene, lights, lamp, vertex.receiver, sample, active, vertex.importance)
        pdf = ds.pdf
    lit = active & (pdf > 0)
    wo, mis_active = si.to_local(ds.d), lit
    f = mi.Spectrum(0) if context.light_lobes is None else bsdf.eval(context.light_lobes, si, wo, lit)
    if gathered is not None:
        f = dr.select(gathered, bsdf.eval(lobes.diffuse(), si, wo, lit & gathered), f)
        mis_active = but_not(lit, gathered)
    diffuse = f
    for lobe in context.mis_lobes:
        f_lobe, pdf_lobe = eval_lobe(context, lobe, vertex, wo, points, mis_active)
        if other_pdf is not None:
            pdf_lobe = other_pdf(ds, f_lobe, pdf_lobe, but_not(mis_active, ds.delta))
        f = f + f_lobe * dr.select(ds.delta, 1, mis(pdf, pdf_lobe))
    f = context.scattering.or_all_lobes(f, si, bsdf, wo, lit, vertex.inseparable)
    layers, glossy = context.layers, context.layers.of(ray, "glossy", lambda: lamp.k)
    if not layers.splits_lobes:
        (value,) = unless_in_shadow(context, vertex, ds.p, [f * weight], lit)
        return layers.none().plus(value, glossy)
    if not context.mis_lobes:
        diffuse = bsdf.eval(lobes.diffuse(), si, wo, lit)
    diffuse = dr.select(vertex.inseparable, f, diffuse)
    value, diffuse = unless_in_shadow(context, vertex, ds.p, [f * weight, diffuse * weight], lit)
    return layers.none().plus(value, glossy).moved(diffuse, glossy, layers.of(ray, "diffuse"))


def eval_lobe(
    context: Context, lobe: mi.BSDFContext, vertex: Vertex, wo: mi.Vector3f, points: Points, active: mi.Bool
) -> tuple[mi.Spectrum, mi.Float]:
    """Value of ``lobe`` times the cosine for ``wo``, and its density. Samples its ray, too, if the context says so."""
    if not context.samples_with_light or isinstance(points, SamplerPoints):  # those are taken in order
        return context.scattering.eval_pdf(lobe, vertex.si, vertex.bsdf, wo, active)
    choice, point = lobe_numbers(context, lobe, vertex, points, vertex.active)
    f, pdf, *drawn = vertex.bsdf.eval_pdf_sample(lobe, vertex.si, wo, choice, point, vertex.active)
    vertex.drawn[lobe.type_mask] = tuple(drawn)
    return dr.select(active, f, 0), dr.select(active, pdf, 0)


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
    return unless_in_shadow(context, vertex, ds.p, [f * weight], lit)[0]


def unless_in_shadow(
    context: Context, vertex: Vertex, p: mi.Point3f, values: list[mi.Spectrum], active: mi.Bool
) -> list[mi.Spectrum]:
    """The ``values`` times the transmittance, where nothing is between ``vertex`` and the point ``p``; else 0. The
    first contains the others.
    """
    si = vertex.si
    if context.settings.shadows:
        active = active & (dr.max(dr.abs(values[0])) > 0)
        active = but_not(active, context.scene.ray_test(si.spawn_ray_to(p), active))
    if context.absorbs:
        d = p - si.p
        left = transmittance(beyond(si, vertex.ray.medium, d, active), si.wavelengths, dr.norm(d), active)
        values = [value * left for value in values]
    return [dr.select(active, value, 0) for value in values]
