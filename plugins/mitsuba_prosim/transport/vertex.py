"""Shading: what a vertex of the ray tree or path adds to the radiance."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi

from ..masks import but_not, idle
from ..optics import ambient
from ..sampling.nrook import SamplerPoints
from ..sampling.sobol import Points
from .context import Context
from .direct import direct_light
from .media import ENDLESS, before, transmittance
from .ray import Ray, Vertex, mis
from .workarounds import past_emitters


def shade(
    context: Context, ray: Ray, camera: mi.Ray3f, points: Points, active: mi.Bool, scattered: mi.Bool | bool = False
) -> tuple[mi.Spectrum, Vertex]:
    """``(L, vertex)``: what a vertex adds to the radiance of the camera ray, by emission, background, ambient and
    direct light; and the :class:`Vertex`. ``camera``: the camera ray, for time and wavelengths;
    ``scattered``: the lanes behind a diffuse reflection that has gathered photons.
    """
    settings, lights = context.settings, context.facts.lights
    ray3, si = meet(context, ray, camera, active)
    if settings.hide_emitters and not lights.only_points:
        si = past_emitters(context.scene, ray3, si, active & (ray.level == 0), context.attached)
    if context.facts.absorbs:
        ray = arriving(ray, ray3, si, active)
    surface = active & si.is_valid()
    inside = active if settings.max_level < 0 else active & (ray.level <= settings.max_level)
    L = mi.Spectrum(0)
    if not lights.only_points:
        L += emission(context, ray, si, active)
    if settings.background is not None:
        escaped = but_not(inside, surface)
        L += dr.select(escaped, background_radiance(settings.background, ray3, si, escaped), 0)
    surface_inside = surface & inside
    if idle(surface_inside):
        return ray.throughput * L, Vertex(ray, si, None, False)
    bsdf = si.bsdf()
    if settings.ambient is not None and context.facts.surfaces:
        L += ambient_term(context, si, bsdf, surface_inside)
    direct, estimates = direct_light(context, ray, si, bsdf, points, surface_inside, scattered)
    L += direct
    if context.photons is not None:
        assert not isinstance(points, SamplerPoints)
        L = context.photons.add_to(L, ray, si, bsdf, context.facts.glossy, points.t, surface_inside, scattered)
    return ray.throughput * L, Vertex(ray, si, bsdf, surface, estimates)


def meet(context: Context, ray: Ray, camera: mi.Ray3f, active: mi.Bool) -> tuple[mi.Ray3f, mi.SurfaceInteraction3f]:
    """The ``mi.Ray3f`` of a :class:`Ray`, and its interaction with the scene."""
    ray3 = mi.Ray3f(ray.o, ray.d, camera.time, camera.wavelengths)
    ray3.maxt = dr.select(ray.level == 0, camera.maxt, ray3.maxt)  # up to the camera's far_clip
    return ray3, context.scene.ray_intersect(ray3, mi.RayFlags.All, ray.level == 0, active=active)


def arriving(ray: Ray, ray3: mi.Ray3f, si: mi.SurfaceInteraction3f, active: mi.Bool) -> Ray:
    """The ray where it meets ``si``: less what the medium has absorbed that it came through (Beer's law)."""
    met = active & si.is_valid()
    medium = before(si, ray.medium, ray.d, met & (ray.level == 0))
    t = ray.gap + dr.dot(si.p - ray.o, ray.d)  # si.t would begin at the last source that was passed by
    left = transmittance(medium, ray3.wavelengths, dr.select(met, t, ENDLESS), active)
    ray = replace(ray, throughput=ray.throughput * left, medium=medium)
    if ray.etendue is not None:
        ray.etendue = ray.etendue * dr.max(left)
    return ray


def end(context: Context, ray: Ray, camera: mi.Ray3f, active: mi.Bool) -> mi.Spectrum:
    """What a ray adds that can only end in a source."""
    ray3, si = meet(context, ray, camera, active)
    if context.facts.absorbs:
        ray = arriving(ray, ray3, si, active)
    return ray.throughput * emission(context, ray, si, active)


def emission(context: Context, ray: Ray, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Spectrum:
    """Radiance of a source that ``ray`` meets, shared with the sampling of the sources at the ray's origin."""
    lights = context.facts.lights
    emitter = si.emitter(context.scene)
    if ray.counts is not None:
        active = active & ray.counts
    if context.settings.hide_emitters:
        active = active & (ray.level > 0)
    if idle(active) or emitter is None:
        return mi.Spectrum(0)
    L = emitter.eval(si, active)
    shares = active & ray.shares
    if lights.sky is not None:
        shares &= si.is_valid()
    origin = dr.zeros(mi.Interaction3f)
    origin.p, origin.n, origin.time, origin.t = ray.o, ray.n, si.time, mi.Float(0)
    ds = mi.DirectionSample3f(context.scene, si, origin)
    if context.attached:  # not by way of the point, whose derivative is unbounded at a sphere's outline
        ds.d = dr.replace_grad(ds.d, ray.d)
    both_sides = ray.both_sides if context.facts.both_sides else False
    pdf = lights.pdf(origin, ray.n, both_sides, ds, shares, ray.estimates)
    weight = dr.select(shares, mis(ray.pdf, pdf), 1)
    if context.photon_mis is not None:
        weight = context.photon_mis.emission_weight(ray, origin, ds, pdf, shares, weight, active)
    return dr.select(active, L * weight, 0)


def ambient_term(
    context: Context, si: mi.SurfaceInteraction3f, bsdf: mi.BSDF | mi.BSDFPtr, active: mi.Bool
) -> mi.UnpolarizedSpectrum:
    """The ambient term ka I_a."""
    assert context.settings.ambient is not None
    if dr.is_jit_v(mi.Float):
        ka = dr.dispatch(bsdf, ambient.reflectance, si, active)
    else:
        ka = ambient.reflectance(bsdf, si, active)
    return ka * context.settings.ambient.eval(si, active)


def background_radiance(
    background: mi.Texture, ray: mi.Ray3f, si: mi.SurfaceInteraction3f, active: mi.Bool
) -> mi.UnpolarizedSpectrum:
    """Radiance of the texture ``background`` in the direction of ``ray``; ``si``: what the ray has met, i.e. nothing.

    An image is looked up by latitude and longitude as Mitsuba's ``envmap`` has them: y is up, u = 0 towards +z.
    """
    d = ray.d
    si = mi.SurfaceInteraction3f(si)  # whoever called still needs its own uv
    u = dr.atan2(d.x, -d.z) * dr.inv_two_pi
    si.uv = mi.Point2f(u - dr.floor(u), dr.safe_acos(d.y) * dr.inv_pi)
    return background.eval(si, active)
