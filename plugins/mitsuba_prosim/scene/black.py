"""Finds the reason why a rendered image is black or lacks light, for a message."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compat import AOV, description, name_of, named_by, world_transform
from ..engine.camera import is_perspective
from ..engine.tiny_lamps import lights_off
from ..optics.nested import all_shapes, parts
from ..transport import lobes

#: A function that returns the name of a shape.
Called = Callable[[Any], str]

#: Half of the darkest grey value of a PNG, in linear light.
BLACK = 0.5 / 255 / 12.92

#: Number of camera rays per side of the image.
SIDE = 64

#: Maximum number of mirrors and glass surfaces that a camera ray passes.
PASSED = 16

#: A part of the light, or of the image, that is too large to be missing without a word; a part of a dark image that may
#: be bright; the optical thickness of a medium that lets no light through; and the number of lamps that are looked for.
LOST, RARE, THICK, MOST_LAMPS = 0.02, 0.1, 10.0, 16

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
        text = reason_by_rays(scene, sensor, called)
    return "the picture is black: " + text


def reason_by_rays(scene: mi.Scene, sensor: mi.Sensor, called: Called, rare: float = 0.0) -> str:
    """Returns why a scene with lights is black, by the points that the camera sees, and their points on lights; empty
    if all lights and surfaces are in order. At most the part ``rare`` of the points may be in order.
    """
    ray, si = _seen(scene, sensor)
    off = lights_off(scene, called)
    if len(off) == len(scene.emitters()):
        return f"the lights are off: {', '.join(off[:3])}."
    return _why_unseen(scene, sensor, called, rare, ray, si) or _why_unlit(scene, called, rare, ray, si, off)


def _why_unseen(scene: mi.Scene, sensor: mi.Sensor, called: Called, rare: float, ray: Any, si: Any) -> str:
    """Returns why the camera sees no front of a surface, through air; empty if it sees one."""
    visible, no = si.is_valid(), partial(_at_most, rare * dr.count(si.is_valid())[0])
    for shape, thickness, why in media_of(scene):
        box = shape.bbox()
        within = all(box.contains(lamp.bbox().center()) for lamp in scene.emitters())
        within |= box.contains(ray.o.numpy()[:, 0]) or no(visible & (si.shape != mi.ShapePtr(shape)))
        if within and thickness > THICK:
            return f"the medium in {called(shape)} lets no light through: {why}."
    if getattr(innermost(scene.integrator()), "hide_emitters", False):
        lamps = si.emitter(scene) != None  # noqa: E711
        if dr.any(lamps) and dr.all(~visible | lamps):
            return "only lamps are in view, and hide_emitters of the integrator hides them."
    if not dr.any(visible):  # many pictures have little in view
        if cut := clipped(scene, sensor, called):
            return f"{cut[0].lower()}{cut[1:]}."
        film, others = sensor.film(), len(scene.sensors()) > 1
        where = "nothing is in the crop window" if dr.any(film.crop_size() != film.size()) else "nothing is in view"
        return (
            f"{where}, or it is tiny. Does the camera look at the scene, and between its clipping planes?"
            + " Or is another sensor of the scene meant?" * others
        )
    if no(visible & ((si.wi.z >= 0) | lobes.has_any(si.bsdf().flags(), "BackSide"))):
        return (
            "all visible surfaces show their inner side: the eye is within a solid, or a mesh is turned inside out "
            "(in Mitsuba, the material twosided is on both sides)."
        )
    return ""


def _why_unlit(scene: mi.Scene, called: Called, rare: float, ray: Any, si: Any, off: list[str]) -> str:
    """Returns why no light comes from the surfaces that the camera sees; empty if they are in order. ``off`` are the
    lamps without light.
    """
    no, (limit, deepest) = partial(_at_most, rare * dr.count(si.is_valid())[0]), depth_limit(scene.integrator())
    si, passed, ds, light = _lit(scene, si, ray)
    if no(si.is_valid()):
        return "the visible surfaces are mirrors, glass or masks with nothing behind or around them."
    lit = light > 0
    if no(lit):
        return (
            "no light arrives at the visible surfaces: the lights shine elsewhere (an area light to the side of its "
            f"normal), or are {'off: ' + ', '.join(off[:3]) if off else 'dark'}."
        )
    if no(lit & (passed <= deepest)):
        return f"{limit} ends all rays before they find light: allow more reflections."
    facing = _cosine(si, ds) > 1e-4
    if no(lit & facing):
        return (
            "the lights shine only on the other side of the visible surfaces, or along them. Are the lights or the eye "
            f"behind them, such as within {called(_most(si, lit))}?"
        )
    lit &= facing
    first, through = _first_hit(scene, si, ds, lit)
    if not no(arrives := lit & ~first.is_valid()):
        _, weight = si.bsdf().sample(mi.BSDFContext(), si, 0.5, mi.Point2f(0.5, 0.3), arrives)
        if no(arrives & (dr.max(mi.unpolarized_spectrum(weight)) > 0)):
            shape = called(_most(si, arrives))
            return f"light arrives at {shape}, which reflects nothing: is it black, or one-sided (see twosided)?"
        told = (
            "light arrives at the visible surfaces, and none is reflected to the eye. Are they black, one-sided (see "
            "twosided), or mirrors or glass that show something black?"
        )
        return "" if rare else told
    if not no(through > 0):
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


def _at_most(most: float, points: mi.Bool) -> bool:
    return int(dr.count(points)[0]) <= most


def has_media(scene: mi.Scene, sensor: mi.Sensor) -> bool:
    """Tells whether the scene has participating media."""
    return sensor.get_medium() is not None or any(shape.is_medium_transition() for shape in all_shapes(scene))


def media_of(scene: mi.Scene) -> Iterator[tuple[mi.Shape, float, str]]:
    """Yields each shape with a medium, its optical thickness, and the density and the size, in words; none if the
    integrator ignores media.
    """
    if "Vol" in description(innermost(scene.integrator())).partition("[")[0]:
        for shape in all_shapes(scene):
            if (medium := shape.interior_medium()) is not None:
                size = float(dr.norm(shape.bbox().extents()))
                density = float(dr.max(medium.get_majorant(dr.zeros(mi.MediumInteraction3f)), axis=None)[0])
                yield (
                    shape,
                    size * density,
                    f"its density (sigma_t times scale) is {density:.3g}, and its size {size:.3g}",
                )


def unseen_medium(scene: mi.Scene, sensor: mi.Sensor, called: Called = name_of) -> str:
    """Returns a sentence that a medium has no effect, or none on the camera within it; empty if all have one."""
    for shape, thickness, why in media_of(scene):
        if not lobes.has_any(int(shape.bsdf().flags()), *lobes.REFRACTED, "DiffuseTransmission"):
            return f"The medium in {called(shape)} is hidden by its surface, which is opaque: give it a bsdf null"
        if thickness < 1 / THICK**2:
            return f"The medium in {called(shape)} is too thin to see: {why}"
        ray, _ = sensor.sample_ray_differential(0.0, 0.5, mi.Point2f(0.5), mi.Point2f(0.5), True)
        for _ in range(PASSED if sensor.get_medium() is None else 0):
            si = scene.ray_intersect(ray)
            if dr.all(si.shape == mi.ShapePtr(shape)):
                if dr.all(dr.dot(si.n, ray.d) > 0):
                    return f"The camera is within {called(shape)}, whose medium the sensor lacks: add a reference to it"
                break
            ray = si.spawn_ray(ray.d)
    return ""


def hidden_lamp(scene: mi.Scene, sensor: mi.Sensor, called: Called = name_of) -> str:
    """Returns a sentence that no direct light of a lamp arrives at the visible surfaces; empty if that of each does."""
    ray, seen = _seen(scene, sensor)
    si, _, ds, light = _lit(scene, seen, ray)
    lit = (light > 0) & (_cosine(si, ds) > 1e-4)
    first, through = _first_hit(scene, si, ds, lit)
    lamps = scene.emitters()
    for lamp in lamps if len(lamps) <= MOST_LAMPS else []:
        pointer = mi.EmitterPtr(lamp)
        points = si.is_valid() & (ds.emitter == pointer)
        if dr.count(points)[0] < SIDE or dr.any(points & (through > 0)) or dr.any(seen.emitter(scene) == pointer):
            continue
        told = f"No direct light of {called(named_by(lamp))} arrives at the visible surfaces: "
        hidden = points & lit & first.is_valid()
        return told + (f"{called(_most(first, hidden))} is in the way" if dr.any(hidden) else "it shines elsewhere")
    return ""


def shows_back(scene: mi.Scene, sensor: mi.Sensor, called: Called = name_of) -> str:
    """Returns a sentence that more than :data:`LOST` of the picture shows the black side of surfaces; empty if not."""
    _, si = _seen(scene, sensor)
    back = si.is_valid() & (si.wi.z < -0.1) & ~lobes.has_any(si.bsdf().flags(), "BackSide")
    back &= si.emitter(scene) == None  # noqa: E711
    share = dr.count(back)[0] / SIDE**2
    told = f"In {share:.0%} of the picture, surfaces such as {{}} show their inner side, which is black (see twosided)"
    return told.format(called(_most(si, back))) if share > LOST else ""


def clipped(scene: mi.Scene, sensor: mi.Sensor, called: Called) -> str:
    """Returns a sentence that a clipping plane of the sensor cuts off more than :data:`LOST` of what is in view; empty
    if not.
    """
    ray, si = _seen(scene, sensor)
    eye = mi.Point3f(world_transform(sensor, mi.Float(sensor.shutter_open())).translation())
    near = mi.Ray3f(ray.o, -ray.d, dr.norm(ray.o - eye) if is_perspective(sensor) else 0, 0, ray.wavelengths)
    beyond = mi.Ray3f(ray.o, ray.d, dr.inf, 0, ray.wavelengths)
    for name, way, active in ("near", near, True), ("far", beyond, ~si.is_valid()):
        hit = scene.ray_intersect(way, active)
        share = float(dr.mean(dr.select(hit.is_valid(), mi.Float(1), 0))[0])
        if share > LOST:
            shape = called(_most(hit, hit.is_valid()))
            return f"The camera's {name}_clip cuts off {share:.0%} of the picture, such as {shape}"
    return ""


def lost_behind_glass(
    scene: mi.Scene, sensor: mi.Sensor, paths: bool, called: Called = name_of, volumes: bool = False
) -> str:
    """Returns a sentence that more than :data:`LOST` of the light of lamps reaches the visible surfaces only through
    glass or masks, where shadow rays end; empty if not. Rays of ``paths`` find the light of lamps with an extent; those
    of ``volumes`` pass null surfaces, and find what media scatter.
    """
    ray, si = _seen(scene, sensor)
    si, _, ds, light = _lit(scene, si, ray)
    light = dr.select(light > 0, light * dr.maximum(_cosine(si, ds), 0), 0)  # without light, a direction may be NaN
    first, through = _first_hit(scene, si, ds, light > 0)
    ideal = ds.delta & ~lobes.has_any(first.bsdf().flags(), *lobes.BOTH_SIDES)  # paths sample lamps at rough glass
    missed = first.is_valid() & (through > 0) & (ideal | (not paths))
    missed &= lobes.has_any(first.bsdf().flags(), *lobes.THROUGH) | (not volumes)
    lost, all_light = (float(dr.sum(light * part)[0]) for part in (dr.select(missed, through, 0), through))
    if not lost > LOST * all_light:
        return ""
    share, name = lost / all_light, called(_most(first, missed))
    if volumes:
        return f"The light that lamps without extent send through {name} is missing, unless media scatter it"
    return f"About {share:.0%} of the lamps' light is missing: through {name}, only photons (caustics) find it"


def lost_by_mirrors(scene: mi.Scene, sensor: mi.Sensor, called: Called = name_of) -> str:
    """Returns a sentence that the image lacks light that a mirror sends from a lamp without an extent to visible
    surfaces; empty if at most the part :data:`RARE` of the points of each mirror does so.
    """
    k = dr.arange(mi.Float, SIDE * SIDE)
    wavelengths = _seen(scene, sensor)[0].wavelengths
    u = [mi.Point2f(k * a - dr.floor(k * a), (k + 0.5) / SIDE**2) for a in (0.7548776662466927, 0.618033988749895)]
    for shape in scene.shapes():
        flags = int(shape.bsdf().flags()) if shape.bsdf() else 0
        if not lobes.has_any(flags, "DeltaReflection") or lobes.has_any(flags, *lobes.SMOOTH, *lobes.REFRACTED):
            continue
        si = mi.SurfaceInteraction3f(shape.sample_position(0, u[0]), wavelengths)
        ds, light = scene.sample_emitter_direction(si, mi.Point2f(u[1].x, 0.5))
        cosine = dr.dot(ds.d, si.n)
        lit = ds.delta & (dr.max(mi.unpolarized_spectrum(light)) > 0)
        lit &= (cosine > 0) | lobes.has_any(flags, "BackSide")
        hit = scene.ray_intersect(si.spawn_ray(2 * cosine * si.n - ds.d), lit)
        eye, _ = sensor.sample_direction(hit, mi.Point2f(0.5), lit & hit.is_valid())
        lit &= hit.is_valid() & lobes.has_any(hit.bsdf().flags(), *lobes.SMOOTH) & (eye.pdf > 0)
        lit &= ~scene.ray_test(hit.spawn_ray_to(eye.p), lit)
        if not _at_most(RARE * SIDE**2, lit):
            told = "The light that lamps without extent send by way of {} is missing: only photons (caustics) find it"
            return told.format(called(shape))
    return ""


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
    text = description(innermost(integrator))
    if depth := re.search(r"max_depth = (\d+)", text):
        most = int(depth[1])
        return f"max_depth = {most}", most - 2
    level = getattr(innermost(integrator), "max_level", math.inf)
    if text.startswith("DirectIntegrator"):
        return "the integrator direct, unlike path,", 0
    return f"max_level = {level}", level if level >= 0 else math.inf
