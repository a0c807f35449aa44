"""Finds the reason why a rendered image is black, for an error message."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np

#: Half of the darkest grey value of a PNG, in linear light.
BLACK = 0.5 / 255 / 12.92

#: Number of camera rays per side of the image.
SIDE = 64

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
    elif not scene.emitters():
        text = "the scene has no lights."
    elif not dr.is_jit_v(mi.Float):
        text = "no light arrives at the visible surfaces, or nothing is in view."
    else:
        text = _reason_by_rays(scene, sensor)
    return "the picture is black: " + text


def _reason_by_rays(scene: mi.Scene, sensor: mi.Sensor) -> str:
    """Returns why a scene with lights is black, by :data:`SIDE` x :data:`SIDE` camera rays, and a point on a light for
    each surface point that they meet.

    These points follow the sequence of Roberts (2018), "The Unreasonable Effectiveness of Quasirandom Sequences".
    """
    k = dr.arange(mi.Float, SIDE * SIDE)
    x, y = dr.meshgrid(*[dr.arange(mi.Float, SIDE) + 0.5] * 2)
    ray, _ = sensor.sample_ray_differential(0.0, 0.5, mi.Point2f(x, y) / SIDE, mi.Point2f(0.5))
    si = scene.ray_intersect(ray)
    visible = si.is_valid()
    if not dr.any(visible):
        return "nothing is in view. Does the camera look at the scene, and between its clipping planes?"
    if dr.all(~visible | (dr.dot(si.n, ray.d) > 0)):
        return "all visible surfaces show their inner side: the eye is within a solid, or a mesh is turned inside out."
    on_light = mi.Point2f(k * 0.7548776662466927, k * 0.5698402909980532)
    # False: without a test for shadows, which follows below.
    ds, light = scene.sample_emitter_direction(si, on_light - dr.floor(on_light), False, visible)
    lit = visible & (dr.max(mi.unpolarized_spectrum(light)) > 0)
    if not dr.any(lit):
        return "no light arrives at the visible surfaces: the lights shine elsewhere, or are dark."
    lit &= dr.dot(si.n, ds.d) > 0  # the light arrives at the outer side of the surface
    if dr.any(lit & ~scene.ray_test(si.spawn_ray_to(ds.p), lit)):
        return (
            "light arrives at the visible surfaces, and none is reflected to the eye. Are they black, or mirrors or "
            "glass that show something black?"
        )
    return "no light arrives at the visible surfaces: they lie in shadow. Are the lights enclosed, or behind a wall?"
