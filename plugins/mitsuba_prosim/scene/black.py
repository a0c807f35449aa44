"""Finds the reason why a rendered image is black, for an error message."""

from __future__ import annotations

import math
import re
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compat import AOV, description, name_of
from ..optics.nested import parts
from ..transport import lobes

#: Half of the darkest grey value of a PNG, in linear light.
BLACK = 0.5 / 255 / 12.92

#: Number of camera rays per side of the image.
SIDE = 64

#: Maximum number of mirrors and glass surfaces that a camera ray passes.
PASSED = 16

#: Advice for an image that is too dark; ``{}`` is the exposure in stops.
IN_THE_PNG = "The EXR has these values; --exposure {} makes them bright in the PNG"


def reason(
    scene: mi.Scene, sensor: mi.Sensor, colours: np.ndarray | None, brighter: str = IN_THE_PNG, exposure: float = 0.0
) -> str | None:
    """Returns why a rendered image is black, and a remedy, in words; None if it is not black.

    ``colours`` are the linear colours of the image, shape (height, width, 3), or None. The image is black if all its
    colours times 2^``exposure`` are NaN or below :data:`BLACK`. ``brighter`` is the advice for an image that is only
    too dark, in which ``{}`` is replaced by the exposure, in stops, that makes it bright. Scalar variants trace no
    camera rays, so their reason is less exact.
    """
    if colours is None:
        return None
    brightest = float(np.fmax.reduce(colours, axis=None, initial=0.0)) * 2.0**exposure  # the maximum without NaN values
    if brightest >= BLACK:
        return None
    if brightest > 0:
        enough = brighter.format(f"{exposure + math.ceil(-math.log2(brightest)):g}")
        text = f"its brightest value is {brightest:.2g}, white being 1. {enough}, and so do brighter lights."
    elif np.any(colours < 0):
        text = "its values are 0 or negative: a lamp, texture or material has negative values."
    elif (integrator := innermost(scene.integrator())) and integrator.class_name() == AOV:
        text = f"aov alone computes only its channels, such as {integrator.aov_names()[0]}; nest path in it for light."
    elif not scene.emitters():
        text = "the scene has no lights."
    elif not dr.is_jit_v(mi.Float):
        text = "no light arrives at the visible surfaces, or nothing is in view."
    else:
        text = _reason_by_rays(scene, sensor)
    return "the picture is black: " + text


def _reason_by_rays(scene: mi.Scene, sensor: mi.Sensor) -> str:
    """Returns why a scene with lights is black, by :data:`SIDE` x :data:`SIDE` camera rays, which mirrors, glass and
    masks pass on, and a point on a light for each surface point that they meet.

    These points follow the sequence of Roberts (2018), "The Unreasonable Effectiveness of Quasirandom Sequences".
    """
    k = dr.arange(mi.Float, SIDE * SIDE)
    x, y = dr.meshgrid(*[dr.arange(mi.Float, SIDE) + 0.5] * 2)
    ray, _ = sensor.sample_ray_differential(0.0, 0.5, mi.Point2f(x, y) / SIDE, mi.Point2f(0.5), True)
    si = scene.ray_intersect(ray)
    dr.eval(ray, si)  # as below, so that no kernel computes again what others have
    visible, integrator, (limit, deepest) = si.is_valid(), scene.integrator(), depth_limit(scene.integrator())
    if getattr(innermost(integrator), "hide_emitters", False):
        lamps = si.emitter(scene) != None  # noqa: E711
        if dr.any(lamps) and dr.all(~visible | lamps):
            return "only lamps are in view, and hide_emitters of the integrator hides them."
    if not dr.any(visible):
        film, others = sensor.film(), len(scene.sensors()) > 1
        where = "nothing is in the crop window" if dr.any(film.crop_size() != film.size()) else "nothing is in view"
        return (
            f"{where}, or it is tiny. Does the camera look at the scene, and between its clipping planes?"
            + " Or is another sensor of the scene meant?" * others
        )
    if dr.all(~visible | ((dr.dot(si.n, ray.d) > 0) & ~lobes.has_any(si.bsdf().flags(), "BackSide"))):
        return (
            "all visible surfaces show their inner side: the eye is within a solid, or a mesh is turned inside out "
            "(in Mitsuba, the material twosided is on both sides)."
        )
    on_light = mi.Point2f(k * 0.7548776662466927, k * 0.5698402909980532)
    on_light -= dr.floor(on_light)
    si, passed = _after_mirrors(scene, si, ray, on_light)
    if not dr.any(si.is_valid()):
        return "the visible surfaces are mirrors, glass or masks with nothing behind or around them."
    # False: without a test for shadows, which follows below.
    ds, light = scene.sample_emitter_direction(si, on_light, False, si.is_valid())
    dr.eval(ds, light)
    lit = si.is_valid() & (dr.max(mi.unpolarized_spectrum(light)) > 0)
    if not dr.any(lit):
        return (
            "no light arrives at the visible surfaces: the lights shine elsewhere (an area light to the side of its "
            "normal), or are dark."
        )
    if dr.all(~lit | (passed > deepest)):
        return f"{limit} ends all rays before they find light: allow more reflections."
    lit &= dr.dot(si.n, ds.d) * dr.sign(dr.dot(si.n, si.to_world(si.wi))) > 1e-4  # at the side that the eye sees
    if not dr.any(lit):
        return (
            "the lights shine only on the other side of the visible surfaces, or along them. Are the lights or the eye "
            "behind them?"
        )
    shadow_ray = si.spawn_ray_to(ds.p)
    first = hit = scene.ray_intersect(shadow_ray, lit)
    dr.eval(hit)
    if dr.any(lit & ~hit.is_valid()):
        return (
            "light arrives at the visible surfaces, and none is reflected to the eye. Are they black, one-sided (see "
            "twosided), or mirrors or glass that show something black?"
        )
    for _ in range(PASSED):  # straight on, as if glass did not bend light
        null = dr.max(mi.unpolarized_spectrum(hit.bsdf().eval_null_transmission(hit, lit)))
        lit &= lobes.has_any(hit.bsdf().flags(), *lobes.THROUGH) | (null > 0)
        shadow_ray = hit.spawn_ray_to(ds.p)
        hit = scene.ray_intersect(shadow_ray, lit)
        dr.eval(hit, lit)
        if dr.any(reached := lit & ~hit.is_valid()):
            return (
                f"light reaches the visible surfaces only through glass or a mask, such as {_most(first, reached)}, "
                "where shadow rays end. Photons (caustics) find it, or paths that meet a lamp with an extent."
            )
    shade = _most(first, first.is_valid())
    return (
        f"no light arrives at the visible surfaces: they lie in shadow, such as that of {shade}: are the lights or "
        "the eye enclosed, or behind a wall?"
    )


def _most(si: mi.SurfaceInteraction3f, active: mi.Bool) -> str:
    """Returns the name of the shape that most of the ``active`` points lie on."""
    numbers = np.array(dr.reinterpret_array(mi.UInt32, si.shape)) * np.array(active)
    return name_of(si.shape[int(np.argmax(numbers == 1 + np.argmax(np.bincount(numbers)[1:])))])


def _after_mirrors(
    scene: mi.Scene, si: mi.SurfaceInteraction3f, ray: mi.Ray3f, u: mi.Point2f
) -> tuple[mi.SurfaceInteraction3f, mi.Float]:
    """Returns the first points from ``si`` that scatter light into many directions, after at most :data:`PASSED`
    mirrors, glass surfaces and masks, and how many these were.
    """
    passed = mi.Float(0)
    for _ in range(PASSED):
        active = si.is_valid()
        bs, weight = si.bsdf(ray).sample(mi.BSDFContext(), si, u.x, u, active)
        active &= lobes.has_any(bs.sampled_type, *lobes.IDEAL) & (dr.max(mi.unpolarized_spectrum(weight)) > 0)
        if not dr.any(active):
            break
        ray = si.spawn_ray(si.to_world(bs.wo))
        si = dr.select(active, scene.ray_intersect(ray, active), si)
        passed += dr.select(active, mi.Float(1), 0)
        dr.eval(ray, si, passed)
    return si, passed


def innermost(integrator: Any) -> Any:
    """Returns the integrator that finds the light: ``integrator``, or the one nested in it, at any depth."""
    while integrator and (inner := [one for one in parts(integrator).values() if isinstance(one, mi.Integrator)]):
        integrator = inner[0]
    return integrator


def depth_limit(integrator: mi.Integrator | None) -> tuple[str, float]:
    """Returns the parameter of an integrator that limits the depth of rays, in words, and the maximum number of
    reflections and refractions before the last surface whose light from lamps it finds. The number is negative if there
    is no such surface, and infinite or huge without a limit.
    """
    text = description(integrator)
    if depth := re.search(r"max_depth = (\d+)", text):
        most = int(depth[1])
        return f"max_depth = {most}", most - 2
    level = getattr(innermost(integrator), "max_level", math.inf)
    if text.startswith("DirectIntegrator"):
        return "the integrator direct", 0
    return f"max_level = {level}", level if level >= 0 else math.inf
