"""Translates a scene for the target ``stock``, which uses only plugins that are part of Mitsuba. Each kind of
approximation causes one warning.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from ..language.words import PIXELS
from ..model import Leaf, Light, Method, Surface, Vector
from ..nodes import Comment, Default, Node, rgb, rgb_clipped
from ..view import Camera
from . import lights, materials, textures
from .translation_context import Context

SAMPLER, LENS = "multijitter", "thinlens"


def _approximate(context: Context, reason: str, *path: str | int) -> None:
    context.warn_once(f"stock target: {reason}", *path)


def settings(context: Context) -> Node:
    """Returns the integrator and the background of a scene, and a comment that lists their statements. Emits a warning
    for each setting that the target ``stock`` approximates or ignores.

    A black background, and any background of a scene with a SKY light, is left out.
    """
    scene = context.scene
    absorbing = any(materials.absorbs(scene.surfaces[leaf.index]) for _, leaf in scene.leaves)
    integrator = "volpath" if absorbing else "path"
    result: Node = {
        "comment": Comment(f"{scene.name}, for Mitsuba's built-in plugins: MAX-LEVEL, NSAMPLES, BACKGROUND"),
        # A path is one camera ray, max_level reflected or refracted rays, and one ray to a light.
        "integrator": {"type": integrator, "max_depth": Default("max_depth", scene.max_level + 2), "rr_depth": 1000},
    }
    differences = f"{integrator!r} also follows diffuse reflections, and samples one light at a time; "
    differences += "there are no N-rook patterns and no adaptive sampling"
    _approximate(context, differences, "ambient")
    if any(scene.ambient):
        _approximate(context, "surfaces emit AMBIENT (ka I_a), and so light each other", "ambient")
    if not scene.shadows:
        _approximate(context, "DO-SHADOW has no effect, shadows are cast", "shadows")
    if scene.caustics:
        _approximate(context, f"CAUSTICS has no effect; {integrator!r} finds caustics by chance", "caustics")
    if scene.method != Method():
        _approximate(context, "METHOD has no effect", "method")
    if not all(scene.channels):
        _approximate(context, "all channels are written", "channels")
    if scene.background.image is not None:
        result["background"] = context.image("envmap", scene.background.image, "background", "image")
    elif any(scene.background.color):
        result["background"] = {"type": "constant", "radiance": rgb(lights.from_full_scale(scene.background.color))}
    if any(light.kind == "sky" for light in scene.lights):
        if result.pop("background", None):
            _approximate(context, "the SKY replaces BACKGROUND", "background", "image")
    elif "background" in result:
        _approximate(context, "BACKGROUND lights the scene", "background", "image")
    return result


def camera(context: Context, camera: Camera) -> Camera:
    """Returns a camera with square pixels whose window is that of ``camera``, except for rounding to whole pixels. If
    the window is not centred, the camera has no aperture, and a warning is emitted.

    If the pixels of ``camera`` are not square, the returned camera's image has the same width in pixels, but another
    height, and a warning is emitted. Raises SceneError if this image would have too many pixels.
    """
    if camera.aperture and not camera.centred:
        _approximate(context, "APERTURE has no effect if the window is not centred", "view", "aperture")
        camera = replace(camera, aperture=0)
    if camera.square_pixels:
        return camera
    width, height = camera.resolution
    pixel = (camera.right - camera.left) / width
    new_height = max(1, round((camera.top - camera.bottom) / pixel))
    if width * new_height > PIXELS:
        reason = f"stock target: pixels are square, and this window would have {width}x{new_height} of them; "
        raise context.document.error(f"{reason}expected a window with other proportions", "view", "window")
    _approximate(context, f"pixels are square, {width}x{new_height} of them instead of {width}x{height}", "view")
    # Rounding the height changes the window by the same amount at its top and at its bottom.
    middle, half = (camera.top + camera.bottom) / 2, new_height * pixel / 2
    return replace(camera, resolution=(width, new_height), bottom=middle - half, top=middle + half)


def light(context: Context, number: int, light: Light) -> Node:
    """Returns the dictionary of the emitter of a POINT light, or of the sphere of an AREA light, which contains the
    emitter. The light units "unattenuated" are replaced by "calibrated", with a warning.

    A light with the distribution CONE or SPOT becomes Mitsuba's point light ``spot``, even if it is an AREA light.
    """
    path, units = ("lights", number), context.options.light_units
    if units == "unattenuated":
        _approximate(context, "lights are attenuated with distance; they are calibrated at VRP", *path)
        units = "calibrated"
    uniform = light.distribution == "uniform"
    color = lights.radiance_or_intensity(context, number, light if uniform else replace(light, kind="point"), units)
    if uniform:
        if light.kind == "area":
            _approximate(context, "the camera sees AREA lights", *path)
        return lights.emitter("", light, color, {})
    _approximate(context, "CONE and SPOT lights are points, SPOT with a linear falloff", *path)
    beam, cutoff = _spot_angles(light)
    return {
        "type": "spot",
        "to_world": _to_world_along(light.position, light.direction),
        "intensity": color,
        "beam_width": beam,
        "cutoff_angle": cutoff,
    }


def _spot_angles(light: Light) -> tuple[float, float]:
    """Returns the angles ``beam_width`` and ``cutoff_angle`` of Mitsuba's emitter ``spot`` in degrees, for a light with
    the distribution CONE or SPOT. The intensity of the emitter is constant below the first angle, 0 above the second
    angle, and linear between them.
    """
    limit = min(light.angle or 90.0, 90.0 if light.distribution == "spot" else 179.0)
    if light.distribution == "cone":
        return 0.999 * limit, limit
    # The intensity falls linearly from the axis (t = 0) to the angle c. For small c, where sin t is about t, the flux
    # is that of cos^n: the integral of (1 - t/c) t dt is c^2/6, and the integral of cos^n t sin t dt is 1/(n+1). For
    # n = 1 the flux is 27 % too small.
    return 0.0, min(limit, math.degrees(math.sqrt(6 / (light.exponent + 1))))


def _to_world_along(position: Vector, direction: Vector) -> np.ndarray:
    z = np.array(direction) / np.linalg.norm(direction)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    to_world = np.eye(4)
    to_world[:3] = np.stack([x, np.cross(z, x), z, position], axis=1)
    return to_world


def surface(context: Context, number: int, leaf: Leaf, sides: materials.MediumInterface) -> Node:
    """Returns the BSDF of a primitive, the absorbing media on both sides of its surface, and an emitter for the ambient
    term, unless the ambient term is black.

    A pattern texture is replaced by its mean colour, a factor of kd and ka. An image replaces kd and its factors, and
    does not change ka.
    """
    scene = context.scene
    surface = scene.surfaces[leaf.index]
    kd, ks, ka = materials.reflectances(surface)
    factor, image = np.ones(3), None
    for slot, texture in enumerate(materials.effective_textures(leaf, surface)):
        path = "csg", number, "textures", slot
        if texture and texture.image is not None:
            _approximate(context, "an image replaces kd, and does not change ka", *path)
            image = context.image("bitmap", texture.image, *path)
        elif texture and texture.name is not None:
            _approximate(context, "the mean colour of a pattern replaces it", *path)
            factor = factor * _mean_color(*textures.parameters(scene, texture.name, slot == 1))
    if image is None and max(factor * kd) > 1:
        context.warn_once(textures.CLIPPED, "surfaces", leaf.index, "kd", each_line=True)
    result = {
        "bsdf": _bsdf(context, leaf.index, surface, sides, image or rgb_clipped(factor * kd), ks),
        **materials.media(context, sides),
    }
    ambient = [a * i for a, i in zip(factor * ka, lights.from_full_scale(scene.ambient), strict=True)]
    if any(ambient):
        result["emitter"] = {"type": "area", "radiance": rgb(ambient)}
    return result


def _mean_color(kind: str, parameters: dict[str, Any]) -> np.ndarray:
    if kind == "brick":
        width, height, joint = parameters["brick_width"], parameters["brick_height"], parameters["mortar_width"]
        fraction = width / (width + joint) * height / (height + joint)
        color0, color1 = parameters["brick"], parameters["mortar"]
    else:
        fraction = parameters.get("duty", 0.5)  # fractal noise has as much of one colour as of the other
        color0, color1 = parameters["color0"], parameters["color1"]
    return np.asarray(fraction * np.array(color0) + (1 - fraction) * np.array(color1))


def _bsdf(
    context: Context, index: int, surface: Surface, sides: materials.MediumInterface, diffuse: Node, ks: Vector
) -> Node:
    """Returns the BSDF of ``surface``, number ``index``, between the media ``sides``."""
    path = "surfaces", index
    alpha = materials.beckmann_slope(surface)
    if alpha:
        _approximate(context, "rough surfaces have Beckmann's distribution and Smith's shadowing", *path)
    indices = materials.mean_indices(context, sides) if surface.material in ("dielectric", "composite") else {}
    # Between equal indices roughness has no effect, and a coat is invisible; roughplastic refuses equal indices.
    equal = len(set(indices.values())) == 1
    rough: Node = {"distribution": "beckmann", "alpha": alpha} if alpha and not equal else {}
    prefix = "rough" if rough else ""
    if surface.material == "conductor":
        optics: Node = {"material": surface.metal}
        outside = materials.mean_index(context, sides.outside)
        if surface.eta and surface.k:  # relative to the medium outside, for which there is no parameter
            optics = {"eta": rgb([x / outside for x in surface.eta]), "k": rgb([x / outside for x in surface.k])}
        elif sides.outside is not None:
            _approximate(context, "a named metal in a dielectric reflects as in air", *path)
        return {"type": prefix + "conductor", **optics, **rough}
    if surface.material == "dielectric":
        if surface.glass or surface.abbe:
            _approximate(context, "glass has one index for all wavelengths", *path)
        return {"type": prefix + "dielectric", **indices, **rough}
    if surface.material == "composite":
        _approximate(context, "a composite is a (rough)plastic", *path)
        if not equal:
            reflectances = {"diffuse_reflectance": diffuse, "specular_reflectance": rgb(ks)}
            return {"type": prefix + "plastic", **reflectances, **indices, **rough}
    elif surface.material is None and any(ks):
        reason = "a Phong surface is a blend of a diffuse one and a rough mirror, and saturated colours may be darker"
        _approximate(context, reason, *path)
        return _phong(surface, diffuse, ks)
    return {"type": "diffuse", "reflectance": diffuse}


def _phong(surface: Surface, diffuse: Node, ks: Vector) -> Node:
    """Returns a BSDF that approximates a Phong surface: a blend of a diffuse BSDF and a mirror, which is rough if the
    surface has a Phong exponent or a slope. The specular reflectance of the surface is ``ks``, which is not black.
    """
    # The blend weights the two BSDFs by 1 - w and w. Each reflectance is divided by its weight, and may not exceed 1.
    # An image is not divided; its mean colour counts as 0.5.
    kd = np.array(diffuse["value"]) if diffuse["type"] == "rgb" else np.full(3, 0.5)
    weight = float(np.mean(ks) / (np.mean(ks) + np.mean(kd)))
    # A weight of at least max(ks) keeps ks / weight at most 1. For max(ks) = 1, it would leave no diffuse reflection.
    weight = min(max(weight, max(ks) if max(ks) < 1 else 0.0), 1.0)
    base = rgb_clipped(kd / (1 - weight)) if diffuse["type"] == "rgb" and weight < 1 else diffuse
    mirror: Node = {"type": "conductor"}
    if alpha := materials.beckmann_slope(surface):
        mirror = {"type": "roughconductor", "distribution": "beckmann", "alpha": alpha}
    mirror |= {"material": "none", "specular_reflectance": rgb_clipped(np.array(ks) / weight)}
    diffuse_bsdf = {"type": "diffuse", "reflectance": base}
    return {"type": "blendbsdf", "weight": weight, "diffuse": diffuse_bsdf, "specular": mirror}
