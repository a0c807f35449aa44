"""Why a picture is black, as far as its scene can tell."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compat import world_matrix

#: Below half of the darkest grey of a PNG, in linear light.
BLACK = 0.5 / 255 / 12.92
#: Rays to see what is in view: so many a side.
SIDE = 64


#: What makes a picture brighter where it is shown, by so many factors of two.
IN_THE_PNG = "The EXR has it all; --exposure {} makes it bright in the PNG"


def why(
    scene: mi.Scene, sensor: mi.Sensor, colours: np.ndarray, brighter: str = IN_THE_PNG, exposure: float = 0.0
) -> str | None:
    """What is said of a picture that is black throughout: why it may be, and what may help; None for any other.

    ``colours``: linear, as bright as they are shown, with that ``exposure``; ``brighter``: as :data:`IN_THE_PNG`.
    """
    brightest = float(np.fmax.reduce(colours, axis=None, initial=0.0))  # no NaN
    if brightest >= BLACK:
        return None
    return "the picture is black: " + (
        _too_dark(brightest, brighter, exposure) if brightest > 0 else _reason(scene, sensor)
    )


def _too_dark(brightest: float, brighter: str, exposure: float) -> str:
    enough = f"{exposure + math.ceil(-math.log2(brightest)):g}"
    return (
        f"its brightest value is {brightest:.2g}, white being 1. {brighter.format(enough)}, and brighter lights do in "
        "the scene."
    )


def _reason(scene: mi.Scene, sensor: mi.Sensor) -> str:
    if not scene.emitters():
        return "the scene has no lights."
    if not dr.is_jit_v(mi.Float):
        return "no light arrives at what is in view, or nothing is."
    side = dr.linspace(mi.Float, 0, 1, SIDE, endpoint=False) + 0.5 / SIDE
    x, y = dr.meshgrid(side, side)
    ray, _ = sensor.sample_ray_differential(0.0, 0.5, mi.Point2f(x, y), mi.Point2f(0.5))
    si = scene.ray_intersect(ray)
    seen = si.is_valid()
    if not dr.any(seen):
        return "nothing is in view. " + _where(scene, sensor, ray)
    if dr.all(~seen | (dr.dot(si.n, ray.d) > 0)):
        return "all that is in view is seen from its inside: the eye is within a solid, or a mesh is turned inside out."
    return _unlit(scene, si, seen)


def _where(scene: mi.Scene, sensor: mi.Sensor, ray: mi.Ray3f) -> str:
    """Where the camera looks, and where there is something: but for lamps, which may be far away."""
    solids = [shape for shape in scene.shapes() if not shape.is_emitter()]
    box = mi.ScalarBoundingBox3f()
    for shape in solids or scene.shapes():
        box.expand(shape.bbox())
    rays = np.array(ray.d).T
    eye, ahead = world_matrix(sensor)[:3, 3], np.mean(rays, axis=0)
    ahead /= np.linalg.norm(ahead)
    text = f"The eye is at {_point(eye)} and looks towards {_point(eye + ahead)}"
    if not box.valid():
        return text + "; the scene has no surfaces."
    middle = np.array(box.center()).ravel()
    corners = rays[[0, SIDE - 1, -1, -SIDE]]
    beside = np.cross(corners, np.roll(corners, -1, axis=0)) @ (middle - eye)
    if np.dot(middle - eye, ahead) < 0:
        side = "behind it"
    elif np.all(beside > 0) or np.all(beside < 0):
        size, distance = float(max(box.extents())), np.linalg.norm(middle - eye)
        side = f"in what it sees, but all of it is {size:.3g} large and {distance:.3g} away"
    else:
        side = "beside what it sees"
    return text + f"; the middle of all that there is lies {side}, at {_point(middle)}."


def _unlit(scene: mi.Scene, si: mi.SurfaceInteraction3f, seen: mi.Bool) -> str:
    """Whether it is the lights, shadow, or what the surfaces do with light. Each place asks another point of a light
    (the additive recurrence of Roberts 2018, "The Unreasonable Effectiveness of Quasirandom Sequences").
    """
    k = dr.arange(mi.Float, SIDE * SIDE)
    at = mi.Point2f(k * 0.7548776662466927, k * 0.5698402909980532)
    at -= dr.floor(at)
    ds, light = scene.sample_emitter_direction(si, at, False, seen)
    lit = seen & (dr.max(mi.unpolarized_spectrum(light)) > 0)
    if not dr.any(lit):
        return "no light arrives at what is in view: the lights shine elsewhere, or are dark."
    lit &= dr.dot(si.n, ds.d) > 0
    if dr.any(lit & ~scene.ray_test(si.spawn_ray_to(ds.p), lit)):
        return (
            "light arrives at what is in view, and none is thrown back to the eye. Are the surfaces black, or mirrors, "
            "or glass, before what is black?"
        )
    return (
        "no light arrives at what is in view: it lies in shadow. Is there something around the lights, or are they "
        "behind a wall?"
    )


def _point(values: np.ndarray) -> str:
    return "(" + ", ".join(f"{round(float(v), 3) + 0:g}" for v in values) + ")"
