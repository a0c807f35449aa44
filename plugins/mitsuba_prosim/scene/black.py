"""Finds the reason why a rendered image is black or lacks light, for a message."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compat import AOV, description, name_of
from ..optics.nested import parts
from ..transport import lobes

#: A function that returns the name of a shape.
Called = Callable[[Any], str]

#: Half of the darkest grey value of a PNG, in linear light.
BLACK = 0.5 / 255 / 12.92

#: Number of camera rays per side of the image.
SIDE = 64

#: Maximum number of mirrors and glass surfaces that a camera ray passes.
PASSED = 16

#: A part of the light that is too large to be missing without a word.
LOST = 0.02

#: Advice for an image that is too dark; ``{}`` is the exposure in stops.
IN_THE_PNG = "The EXR has these values; --exposure {} makes them bright in the PNG"


def reason(
    scene: mi.Scene,
    sensor: mi.Sensor,
    colours: np.ndarray | None,
    brighter: str = IN_THE_PNG,
    exposure: float = 0.0,
    called: Called = name_of,
) -> str | None:
    """Returns why a rendered image is black, and a remedy, in words; None if it is not black.

    ``colours`` are the linear colours of the image, shape (height, width, 3), or None. The image is black if all its
    colours times 2^``exposure`` are NaN or below :data:`BLACK`. ``brighter`` is the advice for an image that is only
    too dark, in which ``{}`` is replaced by the exposure, in stops, that makes it bright. ``called`` gives the
    name of a shape. Scalar variants trace no camera rays, so their reason is less exact.
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
        text = _reason_by_rays(scene, sensor, called)
    return "the picture is black: " + text


def _reason_by_rays(scene: mi.Scene, sensor: mi.Sensor, called: Called) -> str:
    """Returns why a scene with lights is black, by the points that the camera sees, and their points on lights."""
    ray, si = _seen(scene, sensor)
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
    si, passed, ds, light = _lit(scene, si, ray)
    if not dr.any(si.is_valid()):
        return "the visible surfaces are mirrors, glass or masks with nothing behind or around them."
    lit = light > 0
    if not dr.any(lit):
        return (
            "no light arrives at the visible surfaces: the lights shine elsewhere (an area light to the side of its "
            "normal), or are dark."
        )
    if dr.all(~lit | (passed > deepest)):
        return f"{limit} ends all rays before they find light: allow more reflections."
    lit &= _cosine(si, ds) > 1e-4
    if not dr.any(lit):
        return (
            "the lights shine only on the other side of the visible surfaces, or along them. Are the lights or the eye "
            "behind them?"
        )
    first, through = _first_hit(scene, si, ds, lit)
    if dr.any(lit & ~first.is_valid()):
        return (
            "light arrives at the visible surfaces, and none is reflected to the eye. Are they black, one-sided (see "
            "twosided), or mirrors or glass that show something black?"
        )
    if dr.any(through > 0):
        return (
            "light reaches the visible surfaces only through glass or a mask, such as "
            f"{called(_most(first, through > 0))}, where shadow rays end. Photons (caustics) find it, or paths that "
            "meet a lamp with an extent."
        )
    shade = called(_most(first, first.is_valid()))
    return (
        f"no light arrives at the visible surfaces: they lie in shadow, such as that of {shade}: are the lights or "
        "the eye enclosed, or behind a wall?"
    )


def lost_behind_glass(scene: mi.Scene, sensor: mi.Sensor, paths: bool, called: Called = name_of) -> str:
    """Returns a sentence that more than :data:`LOST` of the light of lamps reaches the visible surfaces only through
    glass or masks, where shadow rays end; empty if not. Rays of ``paths`` find the light of lamps with an extent.
    """
    ray, si = _seen(scene, sensor)
    si, _, ds, light = _lit(scene, si, ray)
    light = dr.select(light > 0, light * dr.maximum(_cosine(si, ds), 0), 0)  # without light, a direction may be NaN
    first, through = _first_hit(scene, si, ds, light > 0)
    ideal = ds.delta & ~lobes.has_any(first.bsdf().flags(), *lobes.BOTH_SIDES)  # paths sample lamps at rough glass
    missed = first.is_valid() & (through > 0) & (ideal | (not paths))
    lost, all_light = (float(dr.sum(light * part)[0]) for part in (dr.select(missed, through, 0), through))
    if not lost > LOST * all_light:
        return ""
    share, name = lost / all_light, called(_most(first, missed))
    return f"About {share:.0%} of the lamps' light is missing: through {name}, only photons (caustics) find it"


def _seen(scene: mi.Scene, sensor: mi.Sensor) -> tuple[mi.Ray3f, mi.SurfaceInteraction3f]:
    """Returns :data:`SIDE` x :data:`SIDE` camera rays, and the points that they meet."""
    x, y = dr.meshgrid(*[dr.arange(mi.Float, SIDE) + 0.5] * 2)
    ray, _ = sensor.sample_ray_differential(0.0, 0.5, mi.Point2f(x, y) / SIDE, mi.Point2f(0.5), True)
    si = scene.ray_intersect(ray)
    dr.eval(ray, si)  # as below, so that no kernel computes again what others have
    return ray, si


def _lit(scene: mi.Scene, si: mi.SurfaceInteraction3f, ray: mi.Ray3f) -> tuple[Any, mi.Float, Any, mi.Float]:
    """Returns the points behind mirrors, glass and masks, how many of these a ray passes, a point on a light for each,
    and its light without a test for shadows.

    The points follow the sequence of Roberts (2018), "The Unreasonable Effectiveness of Quasirandom Sequences".
    """
    k = dr.arange(mi.Float, SIDE * SIDE)
    on_light = mi.Point2f(k * 0.7548776662466927, k * 0.5698402909980532)
    on_light -= dr.floor(on_light)
    si, passed = _after_mirrors(scene, si, ray, on_light)
    ds, light = scene.sample_emitter_direction(si, on_light, False, si.is_valid())
    amount = dr.select(si.is_valid(), dr.max(mi.unpolarized_spectrum(light)), 0)
    dr.eval(ds, amount)
    return si, passed, ds, amount


def _cosine(si: mi.SurfaceInteraction3f, ds: mi.DirectionSample3f) -> mi.Float:
    """Returns the cosine of the light at the side of the surface that the eye sees."""
    return dr.dot(si.n, ds.d) * dr.sign(dr.dot(si.n, si.to_world(si.wi)))


def _first_hit(scene: mi.Scene, si: Any, ds: Any, active: mi.Bool) -> tuple[mi.SurfaceInteraction3f, mi.Float]:
    """Returns what ``active`` shadow rays meet, and how much light they let through: 1 without an obstacle, and through
    glass; less through masks.
    """
    ray = si.spawn_ray_to(ds.p)
    first = hit = scene.ray_intersect(ray, active)
    through = dr.select(active, mi.Float(1), 0)
    dr.eval(hit, through)
    for _ in range(PASSED):  # straight on, as if glass did not bend light
        bsdf, meets = hit.bsdf(), hit.is_valid()
        if not dr.any(meets):
            break
        null = dr.max(mi.unpolarized_spectrum(bsdf.eval_null_transmission(hit, meets)))
        glass = lobes.has_any(bsdf.flags(), *lobes.THROUGH)
        through *= dr.select(meets & ~glass, null, 1)
        ray = hit.spawn_ray_to(ds.p)
        hit = scene.ray_intersect(ray, meets & (through > 0))
        dr.eval(hit, through)
    return first, dr.select(hit.is_valid(), 0, through)


def _most(si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Shape:
    """Returns the shape that most of the ``active`` points lie on."""
    numbers = np.array(dr.reinterpret_array(mi.UInt32, si.shape)) * np.array(active)
    return si.shape[int(np.argmax(numbers == 1 + np.argmax(np.bincount(numbers)[1:])))]


def _after_mirrors(
    scene: mi.Scene, si: mi.SurfaceInteraction3f, ray: mi.Ray3f, u: mi.Point2f
) -> tuple[mi.SurfaceInteraction3f, mi.Float]:
    """Returns the first points from ``si`` that scatter light into many directions, after at most :data:`PASSED`
    mirrors, glass surfaces and masks, and how many these were.
    """
    passed = mi.Float(0)
    for _ in range(PASSED):
        active = si.is_valid()
        bs, weight = si.bsdf(ray).sample(mi.BSDFContext(), si, u.y, u, active)  # u.x chooses the lamp
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
        return "the integrator direct, unlike path,", 0
    return f"max_level = {level}", level if level >= 0 else math.inf
