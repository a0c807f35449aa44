"""One node of the ray tree, or vertex of a path: what it adds to the radiance."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi

from ..masks import but_not, idle
from ..optics import ambient
from ..sampling.nrook import SamplerPoints
from ..sampling.sobol import Points
from .context import Stage
from .direct import direct_light
from .media import ENDLESS, before, transmittance
from .merging import share, straight
from .ray import Node, Ray, mis


def shade(
    stage: Stage, ray: Ray, camera: mi.Ray3f, points: Points, active: mi.Bool, scattered: mi.Bool | bool = False
) -> tuple[mi.Spectrum, Node]:
    """``(L, node)``: what a node adds to the radiance of the camera ray, by emission, background, ambient and
    direct light; and the :class:`Node`. ``camera``: the camera ray, for time and wavelengths;
    ``scattered``: whether there was a diffuse reflection before that has gathered what comes to it by way of specular
    surfaces.
    """
    settings, lights = stage.settings, stage.facts.lights
    ray3, si = meet(stage, ray, camera, active)
    if settings.hide_emitters and not lights.only_points:
        si = past_emitters(stage, ray3, si, active & (ray.level == 0))
    if stage.facts.absorbs:
        ray = arriving(ray, ray3, si, active)
    surface = active & si.is_valid()
    inside = active if settings.max_level < 0 else active & (ray.level <= settings.max_level)
    L = mi.Spectrum(0)
    if not lights.only_points:
        L += emission(stage, ray, si, active)
    if settings.background is not None:
        escaped = but_not(inside, surface)
        L += dr.select(escaped, background_radiance(settings.background, ray3, si, escaped), 0)
    surface_inside = surface & inside
    if idle(surface_inside):
        return ray.throughput * L, Node(ray, si, None, False)
    bsdf = si.bsdf()
    if settings.ambient is not None and stage.facts.surfaces:
        L += ambient_term(stage, si, bsdf, surface_inside)
    direct, estimates = direct_light(stage, ray, si, bsdf, points, surface_inside, scattered)
    L += direct
    if stage.caustics is not None:
        assert not isinstance(points, SamplerPoints)
        L += stage.caustics(si, bsdf, points.t, surface_inside)
        if stage.merging is not None:
            glossy = but_not(surface_inside, scattered)
            L += stage.merging(ray, si, bsdf, stage.facts.glossy, points.t, glossy)
    return ray.throughput * L, Node(ray, si, bsdf, surface, estimates)


def meet(stage: Stage, ray: Ray, camera: mi.Ray3f, active: mi.Bool) -> tuple[mi.Ray3f, mi.SurfaceInteraction3f]:
    """The ``mi.Ray3f`` of a :class:`Ray`, and its interaction with the scene."""
    ray3 = mi.Ray3f(ray.o, ray.d, camera.time, camera.wavelengths)
    ray3.maxt = dr.select(ray.level == 0, camera.maxt, ray3.maxt)  # up to the camera's far_clip
    return ray3, stage.scene.ray_intersect(ray3, mi.RayFlags.All, ray.level == 0, active=active)


def arriving(ray: Ray, ray3: mi.Ray3f, si: mi.SurfaceInteraction3f, active: mi.Bool) -> Ray:
    """The ray where it meets ``si``: less what the medium has absorbed that it came through (Beer's law)."""
    met = active & si.is_valid()
    medium = before(si, ray.medium, ray.d, met & (ray.level == 0))
    t = ray.gap + dr.dot(si.p - ray.o, ray.d)  # si.t would begin at the last source that was passed by
    left = transmittance(medium, ray3.wavelengths, dr.select(met, t, ENDLESS), active)
    ray = replace(ray, throughput=ray.throughput * left, medium=medium)
    if ray.reach is not None:
        ray.begun, ray.reach = ray.begun * dr.max(left), ray.reach * dr.max(left)
    return ray


def past_emitters(stage: Stage, ray: mi.Ray3f, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.SurfaceInteraction3f:
    """The interaction behind all emitters that the camera ray ``ray`` meets first.

    (Mitsuba 3.9's ``skip_area_emitters`` counts the distance from the last emitter, so that what is behind is
    found in a wrong place, and knows no ``maxt``.)
    """
    hidden = active & si.is_valid()
    if idle(hidden):
        return si
    hidden &= si.shape.is_emitter()

    def beyond(o: mi.Point3f) -> mi.Ray3f:
        """The rest of the ray, from ``o`` on."""
        rest = mi.Ray3f(ray)
        rest.o, rest.maxt = o, ray.maxt - dr.dot(o - ray.o, ray.d)
        return rest

    def step(o: mi.Point3f, blocked: mi.Bool) -> tuple[mi.Point3f, mi.Bool]:
        pi = stage.scene.ray_intersect_preliminary(beyond(o), active=blocked)
        blocked = blocked & pi.is_valid()
        if idle(blocked):
            return o, blocked
        blocked = blocked & pi.shape.is_emitter()
        front = pi.compute_surface_interaction(beyond(o), mi.RayFlags.Minimal, blocked)
        return dr.select(blocked, front.spawn_ray(ray.d).o, o), blocked

    with dr.suspend_grad(when=stage.attached):
        o, _ = dr.while_loop((mi.Point3f(ray.o), hidden), lambda o, blocked: blocked, step, labels=("o", "blocked"))
    if stage.attached:
        o = dr.replace_grad(o, ray.o + ray.d * dr.norm(o - dr.detach(ray.o)))
    return dr.select(hidden, stage.scene.ray_intersect(beyond(o), hidden), si)


def end(stage: Stage, ray: Ray, camera: mi.Ray3f, active: mi.Bool) -> mi.Spectrum:
    """What a ray adds that can only end in a source."""
    ray3, si = meet(stage, ray, camera, active)
    if stage.facts.absorbs:
        ray = arriving(ray, ray3, si, active)
    return ray.throughput * emission(stage, ray, si, active)


def emission(stage: Stage, ray: Ray, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Spectrum:
    """Radiance of a source that ``ray`` meets, shared with the sampling of the sources at the ray's origin."""
    lights = stage.facts.lights
    emitter = si.emitter(stage.scene)
    if ray.counts is not None:
        active = active & ray.counts
    if stage.settings.hide_emitters:
        active = active & (ray.level > 0)
    if idle(active) or emitter is None:
        return mi.Spectrum(0)
    L = emitter.eval(si, active)
    shares = active & ray.shares
    if lights.sky is not None:
        shares &= si.is_valid()
    origin = dr.zeros(mi.Interaction3f)
    origin.p, origin.n, origin.time, origin.t = ray.o, ray.n, si.time, mi.Float(0)
    ds = mi.DirectionSample3f(stage.scene, si, origin)
    if stage.attached:  # not by way of the point, whose derivative is unbounded at a sphere's outline
        ds.d = dr.replace_grad(ds.d, ray.d)
    both_sides = ray.both_sides if stage.facts.both_sides else False
    pdf = lights.pdf(origin, ray.n, both_sides, ds, shares, ray.estimates)
    weight = dr.select(shares, mis(ray.pdf, pdf), 1)
    if stage.merging is not None and ray.reach is not None:
        # What comes straight from a sky is found by rays alone.
        late = active & (ray.reach > 0) & (shares | but_not(mi.Bool(True), ray.shares))
        others = dr.select(shares & late, 1 + dr.square(pdf / ray.pdf), 1)
        photons = straight(ray) * stage.merging.density(origin, ds, late)
        weight = dr.select(late, share(photons, others), weight)
    return dr.select(active, L * weight, 0)


def ambient_term(
    stage: Stage, si: mi.SurfaceInteraction3f, bsdf: mi.BSDF | mi.BSDFPtr, active: mi.Bool
) -> mi.UnpolarizedSpectrum:
    """The ambient term ka I_a."""
    assert stage.settings.ambient is not None
    if dr.is_jit_v(mi.Float):
        ka = dr.dispatch(bsdf, ambient.reflectance, si, active)
    else:
        ka = ambient.reflectance(bsdf, si, active)
    return ka * stage.settings.ambient.eval(si, active)


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
