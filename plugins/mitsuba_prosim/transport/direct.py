"""Direct light at a vertex of a ray tree or path, by samples of the light sources (thesis, sections 4.1, 5.2)."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi

from ..light.reparameterisation import reparameterised_sample
from ..light.strategy import Index, LightSample
from ..light.table import Lamp
from ..masks import but_not
from ..sampling.nrook import SamplerPoints
from ..sampling.sobol import Points
from ..sampling.spaces import NODE_SPACES
from . import lobes
from .absorption import medium_beyond, transmittance
from .next_ray import lobe_point
from .radiance import Radiance
from .ray import Vertex, mis
from .transport_context import Context


def direct_light(context: Context, vertex: Vertex, points: Points) -> Radiance:
    """Returns the direct light that the surface at ``vertex`` scatters back along the ray that arrived there.

    At a vertex of a ray tree, every lamp gets one sample and one shadow ray (thesis, section 4.1); at a vertex of a
    path, one lamp that is chosen at random. A constant sky is sampled only for the lobes ``context.light_lobes``, whose
    rays do not find it. If photons carry the direct light of the other lobes (:attr:`.Ray.light_found`), only diffuse
    lobes scatter it, and all lobes of an inseparable BSDF.
    """
    lights, ray, active = context.lights, vertex.ray, vertex.smooth
    space = context.space(ray.node, NODE_SPACES)  # random numbers of the first light source; the others follow

    def add(lamp: Lamp, L: Radiance) -> Radiance:
        sample = sample_lamp(context, vertex, lamp, points(space + lamp.k, active))
        return L + lamp_light(context, vertex, points, lamp.k, sample, context.mis_lobes)

    if lights.sampler is None:
        L = lights.for_each(add, context.no_light(), active, context.attached)
    else:
        point = points(space, active)
        k, probability, rest = lights.sampler.choose(vertex.receiver, point.x, active)
        sample = sample_lamp(context, vertex, lights.lamp(k), mi.Point2f(rest, point.y), probability)
        L = lamp_light(context, vertex, points, k, sample, context.mis_lobes)
    if lights.sky is not None and context.light_lobes is not None:
        # Lobes whose rays count emission get the radiance of the sky from these rays.
        sample = sample_sky(context, vertex, points, space + lights.lamps)
        L += lamp_light(context, vertex, points, lights.lamps, sample, ())
    return L


def sample_lamp(
    context: Context, vertex: Vertex, lamp: Lamp, point: mi.Point2f, probability: mi.Float | None = None
) -> LightSample:
    """Returns ``(ds, weight)``: a sample of ``lamp`` by the random ``point`` in [0, 1)², with derivatives if
    ``context.attached``. ``probability`` is that of choosing ``lamp``; None if every lamp is sampled.
    """
    ds, weight = lamp.sample(vertex.receiver, point, vertex.smooth)
    if probability is not None:
        ds.pdf, weight = ds.pdf * probability, weight / probability
    if not context.attached:
        return ds, weight
    return reparameterised_sample(context.lights, lamp, vertex.receiver, ds, weight, vertex.smooth)


def lamp_light(
    context: Context,
    vertex: Vertex,
    points: Points,
    k: Index,
    sample: LightSample,
    mis_lobes: tuple[mi.BSDFContext, ...],
) -> Radiance:
    """Returns the radiance that ``vertex`` scatters from one ``sample`` of light source number ``k``; 0 if the sampled
    point is hidden.

    The lobes ``mis_lobes`` get MIS weights, because their rays find the same light; the weight is 1 for a point light
    or a single direction. The lobes ``context.light_lobes`` get none, nor does an inseparable BSDF. If photons carry
    the light of the other lobes (:attr:`.Ray.light_found`), only diffuse lobes contribute.
    """
    ds, weight = sample
    si, ray, scattering = vertex.si, vertex.ray, context.scattering
    gathered = None if context.caustics is None else ray.light_found
    lit = vertex.smooth & (ds.pdf > 0)
    wo, mis_active = si.to_local(ds.d), lit if gathered is None else but_not(lit, gathered)
    f = mi.Spectrum(0) if context.light_lobes is None else scattering.eval(context.light_lobes, vertex, wo, lit)
    if gathered is not None and not context.mis_lobes:  # else ``light_lobes`` are diffuse
        f = dr.select(gathered, scattering.eval(lobes.only(lobes.DIFFUSE), vertex, wo, lit & gathered), f)
    diffuse, terms = f, [(context.light_lobes, f, mi.Float(0), mi.Float(1))]
    for lobe in mis_lobes:
        f_lobe, pdf_lobe = eval_lobe(context, lobe, vertex, wo, points, mis_active)
        weight_lobe = dr.select(ds.delta, 1, mis(ds.pdf, pdf_lobe))
        f = f + f_lobe * weight_lobe
        terms.append((lobe, f_lobe, pdf_lobe, weight_lobe))
    f = dr.select(vertex.inseparable, diffuse, f)  # ``diffuse`` has the light of all lobes there
    lit, transmitted = visibility(context, vertex, ds.p, f * weight, lit)
    value = dr.select(lit, f * weight * transmitted, 0)
    context.observe("lamp", ray, vertex=vertex, lamp=k, sample=sample, terms=terms, f=f, visible=lit, value=value)
    return context.no_light().plus(value, k)


def eval_lobe(
    context: Context, lobe: mi.BSDFContext, vertex: Vertex, wo: mi.Vector3f, points: Points, active: mi.Bool
) -> tuple[mi.Spectrum, mi.Float]:
    """Returns the BSDF value of ``lobe`` times the cosine for the direction ``wo``, and the density with which ``lobe``
    samples ``wo``; both are 0 in lanes that are not ``active``.

    If ``context.samples_with_light``, the same call of the BSDF stores a sample of the next ray in ``vertex.drawn``, so
    that textures are evaluated only once. A :class:`.SamplerPoints`, which draws in a fixed order, is excepted.
    """
    if not context.samples_with_light or isinstance(points, SamplerPoints):
        return context.scattering.eval_pdf(lobe, vertex, wo, active)
    u = lobe_point(context, lobe, vertex, points, vertex.active)
    f, pdf, *drawn = vertex.bsdf.eval_pdf_sample(lobe, vertex.si, wo, *u, vertex.active)
    vertex.drawn[lobe.type_mask] = tuple(drawn)
    return dr.select(active, f, 0), dr.select(active, pdf, 0)


def sample_sky(context: Context, vertex: Vertex, points: Points, space: mi.UInt32) -> LightSample:
    """Returns ``(ds, weight)``: a direction sample of the constant sky for the lobes whose direct light comes from
    light sampling alone: the diffuse lobes, and all lobes of an inseparable BSDF; below the horizon where they transmit
    light. ``ds.pdf`` is 0 where the BSDF at ``vertex`` has no such lobe.
    """
    assert context.lights.sky is not None
    flags, receiver = vertex.bsdf.flags(), vertex.receiver
    active = vertex.smooth & (lobes.has_any(flags, *lobes.DIFFUSE) | vertex.inseparable)
    both_sides = active & (lobes.has_any(flags, "DiffuseTransmission") | vertex.inseparable)
    receiver = replace(receiver, both_sides=receiver.both_sides & both_sides)
    return context.lights.sky.sample(receiver, points(space, active), active)


def visibility(
    context: Context, vertex: Vertex, p: mi.Point3f, radiance: mi.Spectrum, active: mi.Bool
) -> tuple[mi.Bool, mi.UnpolarizedSpectrum | float]:
    """Returns ``(active, transmitted)``: the active lanes in which the point ``p`` is visible from ``vertex`` (always
    if the integrator casts no ``shadows``), and the transmittance in between. A shadow ray is traced only where
    ``radiance``, which ``vertex`` would scatter from ``p``, is not 0.
    """
    si = vertex.si
    if context.settings.shadows:
        active = active & (dr.max(dr.abs(radiance)) > 0)
        active = but_not(active, context.scene.ray_test(si.spawn_ray_to(p), active))
    d = p - si.p
    return active, transmittance(medium_beyond(si, vertex.ray.medium, d, active), si.wavelengths, dr.norm(d), active)
