"""Direct light: samples of the light sources, taken at a vertex (thesis, sections 4.1, 5.2)."""

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
from . import lobes
from .absorption import medium_beyond, transmittance
from .next_ray import lobe_point
from .radiance import Radiance
from .ray import Vertex, mis
from .transport_context import NODE_SPACES, Context


def direct_light(context: Context, vertex: Vertex, points: Points) -> Radiance:
    """Returns the direct light that ``vertex`` scatters into its ray.

    In a ray tree, every light source gets one sample and one shadow ray (thesis, section 4.1). On a path, only one
    lamp, which is chosen at random, gets a sample and a shadow ray. Usually all lobes scatter direct light. After an
    earlier vertex of the path has gathered photons, only diffuse lobes scatter direct light.
    """
    lights, ray, active = context.lights, vertex.ray, vertex.smooth
    space = context.space(ray.node, NODE_SPACES)

    def add(lamp: Lamp, L: Radiance) -> Radiance:
        """Returns ``L`` plus the light of ``lamp`` that the vertex scatters."""
        sample = sample_lamp(context, vertex, lamp, points(space + lamp.k, active))
        return L + lamp_light(context, vertex, points, lamp.k, sample, context.mis_lobes)

    if lights.sampler is None:
        L = lights.for_each(add, context.layers.none(), active, attached=context.attached)
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
    """Returns ``(ds, weight)``: a sample of ``lamp`` by the ``point`` in [0, 1)², and the radiance divided by the
    density.

    ``ds`` and ``weight`` have derivatives if derivatives are wanted. ``probability`` is the probability with which the
    lamp was chosen; None where every lamp is sampled.
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
    """Returns the radiance that ``vertex`` scatters from one ``sample`` of the light source of number ``k``, by layers.

    The radiance includes the visibility of the sampled point, by a shadow ray. The ``mis_lobes`` have MIS weights,
    because their rays, and perhaps photons, find the same light. After an earlier vertex of the path has gathered
    photons, only diffuse lobes count.
    """
    (ds, weight), layers = sample, context.layers
    si, ray, scattering = vertex.si, vertex.ray, context.scattering
    gathered = None if context.caustics is None else ray.light_found
    lit = vertex.smooth & (ds.pdf > 0)
    wo, mis_active = si.to_local(ds.d), lit if gathered is None else but_not(lit, gathered)
    f = mi.Spectrum(0) if context.light_lobes is None else scattering.eval(context.light_lobes, vertex, wo, lit)
    if gathered is not None and not context.mis_lobes:  # else ``light_lobes`` are diffuse
        f = dr.select(gathered, scattering.eval(lobes.only(lobes.DIFFUSE), vertex, wo, lit & gathered), f)
    diffuse = f
    for lobe in mis_lobes:
        f_lobe, pdf_lobe = eval_lobe(context, lobe, vertex, wo, points, mis_active)
        weight_lobe = dr.select(ds.delta, 1, mis(ds.pdf, pdf_lobe))
        if context.photon_mis is not None:
            weight_lobe *= context.photon_mis.light_weight(vertex, ds, f_lobe, pdf_lobe, mis_active)
        f = f + f_lobe * weight_lobe
    f = dr.select(vertex.inseparable, diffuse, f)  # ``diffuse`` has the light of all lobes there
    glossy_layer = layers.of(ray, "glossy", k)
    if not layers.splits_lobes:
        (value,) = with_visibility(context, vertex, ds.p, [f * weight], lit)
        return layers.none().plus(value, glossy_layer)
    if not context.mis_lobes:  # then ``light_lobes`` are all lobes, not only the diffuse lobes
        diffuse = scattering.eval(lobes.only(lobes.DIFFUSE), vertex, wo, lit)
    value, diffuse = with_visibility(context, vertex, ds.p, [f * weight, diffuse * weight], lit)
    return layers.none().plus(value, glossy_layer).moved(diffuse, glossy_layer, layers.of(ray, "diffuse"))


def eval_lobe(
    context: Context, lobe: mi.BSDFContext, vertex: Vertex, wo: mi.Vector3f, points: Points, active: mi.Bool
) -> tuple[mi.Spectrum, mi.Float]:
    """Returns the value of ``lobe`` times the cosine for the direction ``wo``, and the density of ``wo``.

    If ``context.samples_with_light``, the same call of the BSDF also samples the next ray of the lobe, so that textures
    are evaluated only once. The sample of the next ray is stored in ``vertex.drawn``. With SamplerPoints the next ray
    is never sampled here, because a Mitsuba sampler must draw its numbers in a fixed order.
    """
    if not context.samples_with_light or isinstance(points, SamplerPoints):
        return context.scattering.eval_pdf(lobe, vertex, wo, active)
    u = lobe_point(context, lobe, vertex, points, vertex.active)
    f, pdf, *drawn = vertex.bsdf.eval_pdf_sample(lobe, vertex.si, wo, *u, vertex.active)
    vertex.drawn[lobe.type_mask] = tuple(drawn)
    return dr.select(active, f, 0), dr.select(active, pdf, 0)


def sample_sky(context: Context, vertex: Vertex, points: Points, space: mi.UInt32) -> LightSample:
    """Returns ``(ds, weight)``: a sample of the constant sky, for the lobes that get direct light only by light
    sampling.

    These are the diffuse lobes, and all lobes of an inseparable BSDF. ``ds.pdf`` is 0 where ``vertex`` has no such
    lobe. ``space`` is the number of a space of the sampling pattern.
    """
    assert context.lights.sky is not None
    flags, receiver = vertex.bsdf.flags(), vertex.receiver
    active = vertex.smooth & (lobes.has_any(flags, *lobes.DIFFUSE) | vertex.inseparable)
    both_sides = active & (lobes.has_any(flags, "DiffuseTransmission") | vertex.inseparable)
    receiver = replace(receiver, both_sides=receiver.both_sides & both_sides)
    return context.lights.sky.sample(receiver, points(space, active), active)


def with_visibility(
    context: Context, vertex: Vertex, p: mi.Point3f, radiances: list[mi.Spectrum], active: mi.Bool
) -> list[mi.Spectrum]:
    """Multiplies ``radiances`` by the visibility and the transmittance between ``vertex`` and the point ``p``.

    The first of the ``radiances`` is the total radiance: no shadow ray is traced where the total radiance is 0.
    """
    si = vertex.si
    if context.settings.shadows:
        active = active & (dr.max(dr.abs(radiances[0])) > 0)
        active = but_not(active, context.scene.ray_test(si.spawn_ray_to(p), active))
    d = p - si.p
    transmitted = transmittance(medium_beyond(si, vertex.ray.medium, d, active), si.wavelengths, dr.norm(d), active)
    return [dr.select(active, L * transmitted, 0) for L in radiances]
