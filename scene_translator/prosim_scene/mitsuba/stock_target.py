"""The target with Mitsuba's own plugins only. An approximation is a warning, once."""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from ..language.words import PIXELS
from ..model import Leaf, Light, Surface, Vector
from ..nodes import Comment, Default, Node, Point, rgb, rgb_clipped
from ..view import Camera
from . import lights, materials, textures
from .translation_context import Context

SAMPLER = "multijitter"


def settings(context: Context) -> Node:
    """Integrator and background."""
    scene = context.scene
    used = {node.index for node in scene.csg if isinstance(node, Leaf)}
    integrator = "volpath" if any(materials.absorbs(scene.surfaces[index]) for index in used) else "path"
    result: Node = {
        "comment": Comment(f"{scene.name}, for Mitsuba's built-in plugins: MAX-LEVEL, NSAMPLES, BACKGROUND"),
        # One camera ray, max_level reflections or refractions, and the light's ray.
        "integrator": {"type": integrator, "max_depth": Default("max_depth", scene.max_level + 2), "rr_depth": 1000},
    }
    context.approximate(
        f"stock target: {integrator!r} also follows diffuse reflections, and samples one light at a time; "
        "there are no N-rook patterns and no adaptive sampling",
        "ambient",
    )
    if any(scene.ambient):
        context.approximate("stock target: surfaces emit AMBIENT (ka I_a), and so light each other", "ambient")
    if not scene.shadows:
        context.approximate("stock target: DO-SHADOW has no effect, shadows are cast", "shadows")
    if scene.caustics:
        context.approximate(
            f"stock target: CAUSTICS has no effect; {integrator!r} finds caustics by chance", "caustics"
        )
    if not all(scene.channels):
        context.approximate("stock target: all channels are written", "channels")
    if scene.background.image is not None:
        image = context.image(scene.background.image, "background", "image")
        result["background"] = {"type": "envmap", "filename": image}
    elif any(scene.background.color):
        result["background"] = {"type": "constant", "radiance": rgb(lights.radiometric(scene.background.color))}
    if any(light.kind == "sky" for light in scene.lights):
        if result.pop("background", None):
            context.approximate("stock target: the SKY replaces BACKGROUND", "background", "image")
    elif "background" in result:
        context.approximate("stock target: BACKGROUND lights the scene", "background", "image")
    return result


def camera(context: Context, camera: Camera) -> Camera:
    """A camera with square pixels: the height of the image follows from the window."""
    if camera.square_pixels:
        return camera
    width, height = camera.resolution
    pixel = (camera.right - camera.left) / width
    new = max(1, round((camera.top - camera.bottom) / pixel))
    if width * new > PIXELS:
        raise context.document.error(
            f"stock target: pixels are square, and this window would have {width}x{new} of them; "
            "expected a window with other proportions",
            "view",
            "window",
        )
    context.approximate(f"stock target: pixels are square, {width}x{new} of them instead of {width}x{height}", "view")
    # Both sides of the window get half of the rounding.
    middle, half = (camera.top + camera.bottom) / 2, new * pixel / 2
    return replace(camera, resolution=(width, new), bottom=middle - half, top=middle + half)


def light(context: Context, number: int, light: Light) -> Node:
    """A sphere that emits, or a point; CONE and SPOT are Mitsuba's spot."""
    if light.kind == "sky":
        return lights.sky(context, number, light)
    path, units = ("lights", number), context.light_units
    if units == "unattenuated":
        context.approximate("stock target: lights are attenuated with distance; they are calibrated at VRP", *path)
        units = "calibrated"
    if light.distribution == "uniform":
        quantity = lights.quantity(context, number, light, units)
        if light.kind == "point":
            return {"type": "point", "position": Point(light.position), "intensity": rgb(quantity)}
        context.approximate("stock target: the camera sees AREA lights", *path)
        return lights.sphere(light, {"type": "area", "radiance": rgb(quantity)})
    context.approximate("stock target: CONE and SPOT lights are points, SPOT with a linear falloff", *path)
    quantity = lights.quantity(context, number, replace(light, kind="point"), units)
    beam, cutoff = _falloff(light)
    return {
        "type": "spot",
        "to_world": _along(light.position, light.direction),
        "intensity": rgb(quantity),
        "beam_width": beam,
        "cutoff_angle": cutoff,
    }


def _falloff(light: Light) -> tuple[float, float]:
    """Angles in degrees below which a stock spot light is constant, and above which it is black."""
    limit = min(light.angle or 90.0, 90.0 if light.distribution == "spot" else 179.0)
    if light.distribution == "cone":
        return 0.999 * limit, limit
    # A linear ramp from the axis with the flux of cos^n: the integral of (1 - t/c) t dt is c^2/6, that of
    # cos^n t sin t dt is 1/(n+1).
    return 0.0, min(limit, math.degrees(math.sqrt(6 / (light.exponent + 1))))


def _along(position: Vector, direction: Vector) -> np.ndarray:
    """A transform that maps the origin to ``position`` and the z axis to ``direction``."""
    z = np.array(direction) / np.linalg.norm(direction)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    to_world = np.eye(4)
    to_world[:3] = np.stack([x, np.cross(z, x), z, position], axis=1)
    return to_world


def surface(context: Context, number: int, leaf: Leaf, sides: materials.MediumInterface) -> Node:
    """BSDF, the media on its sides, and an emitter for the ambient term."""
    scene = context.scene
    surface = scene.surfaces[leaf.index]
    kd, ks, ka = materials.defaults(surface)
    factor = np.ones(3)
    image = None
    for i, slot in enumerate(materials.slots(leaf, surface)):
        path = "csg", number, "textures", i
        if slot is None:
            continue
        if slot.image is not None:
            context.approximate("stock target: an image replaces kd, and does not change ka", *path)
            image = {"type": "bitmap", "filename": context.image(slot.image, *path)}
        elif slot.name is not None:
            context.approximate("stock target: the mean colour of a pattern replaces it", *path)
            factor = factor * _mean(*textures.parameters(scene, slot.name, i == 1))
    result = {
        "bsdf": _bsdf(context, leaf.index, surface, sides, image or rgb_clipped(factor * kd), ks),
        **materials.media(context, sides),
    }
    ambient = [a * i for a, i in zip(factor * ka, lights.radiometric(scene.ambient), strict=True)]
    if any(ambient):
        result["emitter"] = {"type": "area", "radiance": rgb(ambient)}
    return result


def _mean(kind: str, values: dict[str, Any]) -> np.ndarray:
    """Mean colour of a pattern."""
    if kind == "brick":
        width, height, joint = values["brick_width"], values["brick_height"], values["mortar_width"]
        share = width / (width + joint) * height / (height + joint)
        first, second = values["brick"], values["mortar"]
    else:
        share = values.get("duty", 0.5)
        first, second = values["color0"], values["color1"]
    return np.asarray(share * np.array(first) + (1 - share) * np.array(second))


def _bsdf(
    context: Context, index: int, surface: Surface, sides: materials.MediumInterface, diffuse: Node, ks: Vector
) -> Node:
    path = "surfaces", index
    alpha = materials.beckmann_slope(surface)
    if alpha:
        context.approximate("stock target: rough surfaces have Beckmann's distribution and Smith's shadowing", *path)
    rough: Node = {"distribution": "beckmann", "alpha": alpha} if alpha else {}
    prefix = "rough" if alpha else ""
    if surface.material == "conductor":
        optics: Node = {"material": surface.metal}
        outside = materials.index_outside(context, sides)
        if (
            surface.eta and surface.k
        ):  # the plugin has no parameter for the medium outside, so indices are relative to it
            optics = {"eta": rgb([x / outside for x in surface.eta]), "k": rgb([x / outside for x in surface.k])}
        elif sides.outside is not None:
            context.approximate("stock target: a named metal in a dieletrico reflects as in air", *path)
        return {"type": prefix + "conductor", **optics, **rough}
    if surface.material == "dielectric":
        if surface.glass or surface.abbe:
            context.approximate("stock target: glass has one index for all wavelengths", *path)
        indices = materials.mean_indices(context, sides)
        if materials.invisible(indices):
            return {"type": "dielectric", **indices}
        return {"type": prefix + "dielectric", **indices, **rough}
    if surface.material == "lambertian":
        return {"type": "diffuse", "reflectance": diffuse}
    if surface.material == "composite":
        indices = materials.mean_indices(context, sides)
        context.approximate("stock target: a composto is a (rough)plastic", *path)
        if materials.invisible(indices):  # roughplastic refuses equal indices, and the coat is invisible
            return {"type": "diffuse", "reflectance": diffuse}
        return {
            "type": prefix + "plastic",
            "diffuse_reflectance": diffuse,
            "specular_reflectance": rgb(ks),
            **indices,
            **rough,
        }
    if not any(ks):
        return {"type": "diffuse", "reflectance": diffuse}
    context.approximate("stock target: a Phong surface is a blend of a diffuse one and a rough mirror", *path)
    return _phong(surface, diffuse, ks)


def _phong(surface: Surface, diffuse: Node, ks: Vector) -> Node:
    # The blend has the weights w and 1 - w; reflectances are divided by them, and may not exceed 1.
    kd = np.array(diffuse["value"]) if diffuse["type"] == "rgb" else np.full(3, 0.5)
    weight = float(np.mean(ks) / (np.mean(ks) + np.mean(kd)))
    weight = min(max(weight, max(ks) if max(ks) < 1 else 0.0), 1.0)
    base = rgb_clipped(kd / (1 - weight)) if diffuse["type"] == "rgb" and weight < 1 else diffuse
    mirror: Node = {"type": "conductor"}
    if (exponent := materials.phong_exponent(surface)) is not None:
        # A half vector turns half as fast as the mirror ray: 4 times the exponent.
        mirror = {"type": "roughconductor", "distribution": "beckmann", "alpha": math.sqrt(2 / (4 * exponent + 2))}
    mirror |= {"material": "none", "specular_reflectance": rgb_clipped(np.array(ks) / weight)}
    return {
        "type": "blendbsdf",
        "weight": weight,
        "diffuse": {"type": "diffuse", "reflectance": base},
        "specular": mirror,
    }
