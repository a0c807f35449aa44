"""The same scene for Mitsuba's built-in plugins alone. What they cannot say is approximated, and said so once."""

import math
from dataclasses import replace

import numpy as np

from . import lights, materials, textures
from .errors import Place
from .model import Texture
from .textures import rgb
from .xml import Comment, Default


def settings(translation, image_path):
    scene = translation.scene
    place = scene.places.get("AMBIENT", Place(0, 0))
    result = {
        "comment": Comment(f"{scene.name}, for Mitsuba's built-in plugins: MAX-LEVEL, NSAMPLES, BACKGROUND"),
        # One camera ray, max_level reflections or refractions, and the light's ray.
        "integrator": {"type": "path", "max_depth": Default("max_depth", scene.max_level + 2), "rr_depth": 1000},
    }
    translation.approximate(place, "stock target: 'path' follows diffuse reflections too, and takes one sample of one light "
                                   "at a time; N-rook patterns and adaptive sampling are left out")
    if any(scene.ambient):
        translation.approximate(place, "stock target: AMBIENT is emitted by the surfaces (ka I_a), so that they also light "
                                       "each other with it")
    if not scene.shadows:
        translation.approximate(scene.places["DO_SHADOW"], "stock target: shadows are cast all the same")
    if not all(scene.channels):
        translation.approximate(scene.places["SAVE_RGB"], "stock target: all channels are written")
    if scene.background.image:
        texture = Texture(image=scene.background.image, at=scene.background.at)
        result["background"] = {"type": "envmap", "filename": image_path(translation.image(texture))}
    elif any(scene.background.color):
        result["background"] = {"type": "constant", "radiance": rgb(lights.radiometric(scene.background.color))}
    if "background" in result:
        translation.approximate(scene.background.at, "stock target: BACKGROUND lights the scene")
    return result


def square(translation, camera):
    """A camera with square pixels: the height of the image follows from the window."""
    if camera.square_pixels:
        return camera
    width, height = camera.resolution
    pixel = (camera.right - camera.left) / width
    new = max(1, round((camera.top - camera.bottom) / pixel))
    translation.approximate(translation.scene.view.at, f"stock target: pixels are square, {width}x{new} of them instead of "
                                                       f"{width}x{height}")
    # What rounding leaves over goes to both sides of the window.
    middle, half = (camera.top + camera.bottom) / 2, new * pixel / 2
    return replace(camera, resolution=(width, new), bottom=middle - half, top=middle + half)


def light(translation, light):
    scene, units = translation.scene, translation.light_units
    if units == "unattenuated":
        translation.approximate(light.at, "stock target: lights are attenuated with distance; they are calibrated at VRP")
        units = "calibrated"
    if light.distribution == "uniform":
        if light.kind == "point":
            return {"type": "point", "position": lights.point(light.position),
                    "intensity": rgb(lights.quantity(scene, light, units))}
        translation.approximate(light.at, "stock target: AREA lights are seen by the camera")
        return lights.sphere(light, {"type": "area", "radiance": rgb(lights.quantity(scene, light, units))})
    translation.approximate(light.at, "stock target: CONE and SPOT lights are points, SPOT with a linear falloff")
    # The intensity of a sphere along its axis is that of a point with pi r^2 times its radiance.
    quantity = lights.quantity(scene, light, units)
    if light.kind == "area":
        quantity = [math.pi * light.radius**2 * x for x in quantity]
    beam, cutoff = _falloff(light)
    return {"type": "spot", "to_world": _along(light.position, light.direction), "intensity": rgb(quantity),
            "beam_width": beam, "cutoff_angle": cutoff}


def _falloff(light):
    """Degrees up to which a stock spot light is constant, and from which it is black."""
    limit = min(light.angle or 90.0, 90.0 if light.distribution == "spot" else 179.0)
    if light.distribution == "cone":
        return 0.999 * limit, limit
    # A linear ramp from the axis to where it has the same flux as cos^n: the integral of (1 - t/c) t dt is c^2/6,
    # that of cos^n t sin t dt is 1/(n+1).
    return 0.0, min(limit, math.degrees(math.sqrt(6 / (light.exponent + 1))))


def _along(position, direction):
    """A transform that takes the origin to ``position`` and the z axis to ``direction``."""
    z = np.array(direction) / np.linalg.norm(direction)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    to_world = np.eye(4)
    to_world[:3] = np.stack([x, np.cross(z, x), z, position], axis=1)
    return to_world


def surface(translation, leaf, surface, slots, images):
    """BSDF, and the emitter that stands for the ambient term."""
    scene = translation.scene
    kd, ks, ka = materials.defaults(surface)
    factor = np.ones(3)
    image = None
    for slot in slots:
        if slot is None:
            continue
        if slot.image:
            translation.approximate(slot.at, "stock target: an image takes the place of kd, and does not change ka")
            image = {"type": "bitmap", "filename": images(slot)}
        else:
            translation.approximate(slot.at, "stock target: patterns are replaced by their mean colour")
            factor = factor * _mean(*textures.parameters(scene, slot.name, slot is slots[1]))
    diffuse = image or textures.rgb_clipped(factor * kd)
    result = {"bsdf": _bsdf(translation, surface, diffuse, ks, scene.air_index)}
    ambient = [a * i for a, i in zip(factor * ka, lights.radiometric(scene.ambient))]
    if any(ambient):
        result["emitter"] = {"type": "area", "radiance": rgb(ambient)}
    return result


def _mean(kind, values):
    """Mean colour of a pattern."""
    if kind == "brick":
        width, height, joint = values["brick_width"], values["brick_height"], values["mortar_width"]
        share = width / (width + joint) * height / (height + joint)
        first, second = values["brick"], values["mortar"]
    else:
        share = values.get("duty", 0.5)
        first, second = values["color0"], values["color1"]
    return share * np.array(first) + (1 - share) * np.array(second)


def _alpha(surface):
    """Beckmann's RMS slope: m itself, or that of a Phong exponent n (n = 2/m^2 - 2); 0: smooth."""
    if surface.exponent is not None:
        return math.sqrt(2 / (surface.exponent + 2))
    return surface.slope or 0.0


def _bsdf(translation, surface, diffuse, ks, air):
    alpha = _alpha(surface)
    if alpha:
        translation.approximate(surface.at, "stock target: rough surfaces have Beckmann's distribution and Smith's shadowing")
    rough = {"distribution": "beckmann", "alpha": alpha} if alpha else {}
    prefix = "rough" if alpha else ""
    if surface.material == "conductor":
        if surface.metal:
            optics = {"material": surface.metal}
        else:  # no parameter for the medium outside: relative to it
            optics = {"eta": rgb([x / air for x in surface.eta]), "k": rgb([x / air for x in surface.k])}
        return {"type": prefix + "conductor", **optics, **rough}
    if surface.material == "dielectric":
        index = materials.mean_index(translation.scene, surface, translation.approximate)
        return {"type": prefix + "dielectric", "int_ior": index, "ext_ior": air, **rough}
    if surface.material == "lambertian":
        return {"type": "diffuse", "reflectance": diffuse}
    if surface.material == "composite":
        index = materials.mean_index(translation.scene, surface, translation.approximate)
        translation.approximate(surface.at, "stock target: a composto is a (rough)plastic")
        return {"type": prefix + "plastic", "diffuse_reflectance": diffuse, "specular_reflectance": rgb(ks),
                "int_ior": index, "ext_ior": air, **rough}
    if not any(ks):
        return {"type": "diffuse", "reflectance": diffuse}
    translation.approximate(surface.at, "stock target: a Phong surface is a blend of a diffuse one and a rough mirror")
    # The blend weighs its parts with w and 1 - w; reflectances are divided by that, and may not exceed 1.
    kd = np.array(diffuse["value"]) if diffuse["type"] == "rgb" else np.full(3, 0.5)
    weight = float(np.mean(ks) / (np.mean(ks) + np.mean(kd)))
    weight = min(max(weight, max(ks) if max(ks) < 1 else 0.0), 1.0)
    base = textures.rgb_clipped(kd / (1 - weight)) if diffuse["type"] == "rgb" and weight < 1 else diffuse
    mirror = {"type": "conductor"}
    if (exponent := materials.phong_exponent(surface)) is not None:
        # A half vector turns half as fast as the mirror ray: 4 times the exponent.
        mirror = {"type": "roughconductor", "distribution": "beckmann", "alpha": math.sqrt(2 / (4 * exponent + 2))}
    mirror |= {"material": "none", "specular_reflectance": textures.rgb_clipped(np.array(ks) / weight)}
    return {"type": "blendbsdf", "weight": weight, "diffuse": {"type": "diffuse", "reflectance": base}, "specular": mirror}
