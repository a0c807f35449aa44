"""Shading: the radiance that one vertex of a ray tree or path adds to its camera ray."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi

from ..light.strategy import Index, Receiver
from ..masks import but_not, dispatch, idle
from ..optics.nested import ambient_reflectance
from ..sampling.nrook import SamplerPoints
from ..sampling.sobol import Points
from . import lobes
from .absorption import UNBOUNDED, medium_before, transmittance
from .direct import direct_light
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
    """Returns the :class:`.Vertex` at ``si``, where ``ray`` ends; ``active`` tells in which lanes it met a surface."""
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
