"""Shading: the radiance that one vertex of a ray tree or path adds to its camera ray: emission, the background, the
ambient term, photons, and direct light by samples of the light sources (thesis, sections 4.1, 5.2).
"""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi

from ..light.strategy import Index, LightSample, Receiver
from ..light.table import Lamp
from ..masks import but_not, dispatch, idle
from ..optics.nested import ambient_reflectance
from ..sampling.nrook import SamplerPoints
from ..sampling.sobol import Points
from ..sampling.spaces import NODE_SPACES
from . import lobes
from .absorption import UNBOUNDED, medium_before, medium_beyond, transmittance
from .next_ray import lobe_point
from .radiance import Radiance
from .ray import Ray, Vertex, mis, viewer_side
from .transport_context import Context
from .workarounds import first_hit, past_emitters


def shade(context: Context, ray: Ray, camera: mi.Ray3f, points: Points, active: mi.Bool) -> tuple[Radiance, Vertex]:
    """Returns ``(L, vertex)``: the radiance that the end point of ``ray`` adds to the camera ray, and its
    :class:`.Vertex`.

    Beyond the maximum level, only emission counts. There, and where ``ray`` meets no surface, the vertex is not active.
    ``camera`` is the camera ray, whose time and wavelengths all rays share.
    """
    settings, lights = context.settings, context.lights
    ray3, si = intersect(context, ray, camera, active)
    if settings.hide_emitters and not lights.all_delta:
        si = past_emitters(context.scene, ray3, si, active & ray.is_visible, context.attached)
    arriving, ray = ray, attenuated_at(ray, ray3, si, active)
    context.observe("ray", arriving, si=si, attenuated=ray.throughput, active=active)
    within_max_level = active if settings.max_level < 0 else active & (ray.level <= settings.max_level)
    L = context.no_light()
    # Emission also counts beyond the maximum level: by MIS, this ray shares the direct light of the vertex where it
    # begins.
    if not lights.all_delta:
        L = L.plus(*emission(context, ray, si, active))
    if settings.background is not None:
        escaped = but_not(within_max_level, active & si.is_valid())
        if settings.hide_emitters and context.scene.environment() is not None:
            escaped = escaped & ray.is_visible  # the other rays see the sky in its place
        radiance = dr.select(escaped, background_radiance(settings.background, ray3, si, escaped), 0)
        L = L.plus(radiance, context.layers.get("background"))
        context.observe("background", ray, value=radiance)
    surface = active & si.is_valid() & within_max_level
    if idle(surface):
        return L.scaled(ray.throughput), Vertex(si, None, surface, surface, surface, ray, Receiver(si, ray.n))
    vertex = vertex_at(context, ray, si, surface)
    if settings.ambient is not None and context.flags:  # else Dr.Jit has no BSDF to dispatch to
        ka = dispatch(vertex.bsdf, ambient_reflectance, si, surface)
        radiance = ka * settings.ambient.eval(si, surface)
        L = L.plus(radiance, context.layers.get("ambient"))
        context.observe("ambient", ray, value=radiance)
    L += direct_light(context, vertex, points)
    if context.caustics is not None:
        assert not isinstance(points, SamplerPoints)
        total = context.caustics.add_to(L.total, vertex, points.t)
        context.observe("photons", ray, value=total - L.total)
        L = Radiance(total, L.layers)
    return L.scaled(ray.throughput), vertex


def vertex_at(context: Context, ray: Ray, si: mi.SurfaceInteraction3f, active: mi.Bool) -> Vertex:
    """Returns the :class:`.Vertex` at ``si``, where ``ray`` ends; ``active`` tells in which lanes it met a surface.

    Where a mesh has normals of length 0, the shading frame is NaN, and it scatters nothing, as in Mitsuba's ``path``.
    """
    active = active & dr.isfinite(mi.Frame3f.cos_theta(si.wi))
    bsdf = si.bsdf()
    flags = bsdf.flags()
    smooth = active & mi.has_flag(flags, mi.BSDFFlags.Smooth)
    both_sides = smooth & lobes.has_any(flags, *lobes.BOTH_SIDES) if context.both_sides else False
    receiver = Receiver(si, viewer_side(si), both_sides)
    vertex = Vertex(si, bsdf, active, context.scattering.inseparable(bsdf, active), smooth, ray, receiver)
    if context.lights.sampler is not None:
        receiver.importance = context.lights.sampler.total(receiver, smooth)
    return vertex


def intersect(
    context: Context, ray: Ray, camera: mi.Ray3f, active: mi.Bool
) -> tuple[mi.Ray3f, mi.SurfaceInteraction3f]:
    """Returns ``ray`` as a ``mi.Ray3f`` with the time and the wavelengths of ``camera``, and its surface
    interaction.
    """
    ray3 = mi.Ray3f(ray.o, ray.d, camera.time, camera.wavelengths)
    ray3.maxt = dr.select(ray.level == 0, camera.maxt, ray3.maxt)  # up to the camera's far_clip
    hit = first_hit(context.scene, ray3, ray.level == 0, active)
    return ray3, hit.compute_surface_interaction(ray3, mi.RayFlags.All, active)


def attenuated_at(ray: Ray, ray3: mi.Ray3f, si: mi.SurfaceInteraction3f, active: mi.Bool) -> Ray:
    """Returns ``ray``, given also as ``ray3``, after the absorption in the medium before ``si``, over the distance
    :data:`.UNBOUNDED` where it meets no surface. A camera ray gets its medium (:func:`.medium_before`).
    """
    met = active & si.is_valid()
    medium = medium_before(si, ray.medium, ray.d, met & (ray.level == 0))
    t = ray.offset + dr.dot(si.p - ray.o, ray.d)  # si.t would begin at the last hidden light source
    transmitted = transmittance(medium, ray3.wavelengths, dr.select(met, t, UNBOUNDED), active)
    return replace(ray, throughput=ray.throughput * transmitted, medium=medium)


def emission(context: Context, ray: Ray, si: mi.SurfaceInteraction3f, active: mi.Bool) -> tuple[mi.Spectrum, Index]:
    """Returns ``(radiance, number)``: the radiance of the light source that ``ray`` meets at ``si``, or 0, times its
    MIS weight against light sampling at the ray's origin and photons; and the number of the light source.

    The weight is 1 for light that no other strategy finds, such as light that a glossy lobe receives from a constant
    sky. The radiance is 0 where the light is already found (:attr:`.Ray.light_found`), or hidden from the camera.
    """
    lights = context.lights
    emitter = si.emitter(context.scene)
    active = but_not(active, ray.light_found)
    if context.settings.hide_emitters:
        active = but_not(active, ray.is_visible)
    if idle(active) or emitter is None:
        return mi.Spectrum(0), 0
    L = emitter.eval(si, active)
    uses_mis = active & (ray.pdf > 0)
    if lights.sky is not None:  # light sampling never takes the constant sky for lobes whose rays count emission
        uses_mis &= si.is_valid()
    origin = mi.Interaction3f(0.0, si.time, si.wavelengths, ray.o, ray.n)  # a finite t makes the interaction valid
    ds = mi.DirectionSample3f(context.scene, si, origin)
    if context.attached:  # the derivative of the point is unbounded at a sphere's silhouette
        ds.d = dr.replace_grad(ds.d, ray.d)
    receiver = Receiver(origin, ray.n, False if ray.both_sides is None else ray.both_sides, ray.importance)
    pdf = lights.pdf(receiver, ds, uses_mis)
    weight = dr.select(uses_mis, mis(ray.pdf, pdf), 1)
    if context.photon_mis is not None:
        weight *= context.photon_mis.emission_weight(ray, origin, ds, active & (ray.pdf == 0))
    value, number = dr.select(active, L * weight, 0), lights.number_of(emitter, active)
    context.observe("emission", ray, value=value, lamp=number, radiance=L, density=pdf, weight=weight, active=active)
    return value, number


def background_radiance(
    background: mi.Texture, ray: mi.Ray3f, si: mi.SurfaceInteraction3f, active: mi.Bool
) -> mi.UnpolarizedSpectrum:
    """Returns the radiance of the texture ``background`` in the direction of ``ray``, whose surface interaction ``si``
    is invalid.

    The texture is looked up by latitude and longitude as in Mitsuba's ``envmap``: u is 0 in the direction -z and 0.5 in
    the direction +z; v is 0 in the direction +y and 1 in the direction -y.
    """
    si = mi.SurfaceInteraction3f(si)  # the caller still needs its own uv
    u = dr.atan2(ray.d.x, -ray.d.z) * dr.inv_two_pi
    si.uv = mi.Point2f(u - dr.floor(u), dr.safe_acos(ray.d.y) * dr.inv_pi)
    return background.eval(si, active)


# ---------------------------------------------------------------- direct light


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
    return context.lights.reparameterised_sample(lamp, vertex.receiver, ds, weight, vertex.smooth)


def lamp_light(
    context: Context, vertex: Vertex, points: Points, k: Index, sample: LightSample, mis_lobes: lobes.Lobes
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
    ``radiance``, which ``vertex`` would scatter from ``p``, is not 0, or may have derivatives.
    """
    si = vertex.si
    if context.settings.shadows:
        if not context.attached:
            active = but_not(active, dr.max(dr.abs(radiance)) <= 0)  # NaN is light, too: it must not vanish silently
        active = but_not(active, context.scene.ray_test(si.spawn_ray_to(p), active))
    d = p - si.p
    return active, transmittance(medium_beyond(si, vertex.ray.medium, d, active), si.wavelengths, dr.norm(d), active)
