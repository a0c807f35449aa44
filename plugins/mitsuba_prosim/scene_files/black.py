"""Why a picture is black, as far as its scene can tell."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np

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
    brightest = float(np.max(np.nan_to_num(colours), initial=0.0))
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
    return "no light arrives at what is in view: " + _shadow(scene, si, seen)


def _where(scene: mi.Scene, sensor: mi.Sensor, ray: mi.Ray3f) -> str:
    """Where the camera looks, and where there is something."""
    box = scene.bbox()
    eye, ahead = np.array(sensor.world_transform() @ mi.Point3f(0)).ravel(), np.array(dr.mean(ray.d, axis=1)).ravel()
    ahead /= np.linalg.norm(ahead)
    middle = np.array(box.center()).ravel()
    text = f"The eye is at {_point(eye)} and looks towards {_point(eye + ahead)}"
    if not box.valid():
        return text + "; the scene has no surfaces."
    side = "behind it" if np.dot(middle - eye, ahead) < 0 else "beside what it sees"
    return text + f"; the middle of all that there is lies {side}, at {_point(middle)}."


def _shadow(scene: mi.Scene, si: mi.SurfaceInteraction3f, seen: mi.Bool) -> str:
    """Whether it is shadow or the lights themselves."""
    _, unshadowed = scene.sample_emitter_direction(si, mi.Point2f(0.5), False, seen)
    if not dr.any(seen & (dr.max(mi.unpolarized_spectrum(unshadowed)) > 0)):
        return "the lights shine elsewhere, or are dark."
    return "it lies in shadow. Is there something around the lights, or are they behind a wall?"


def _point(values: np.ndarray) -> str:
    return "(" + ", ".join(f"{round(float(v), 3) + 0:g}" for v in values) + ")"
