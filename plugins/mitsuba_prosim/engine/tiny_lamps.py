"""Finds lamps that are so small that camera rays may miss their reflections."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from ..compat import world_transform
from ..optics.nested import all_flags
from ..transport import lobes
from .camera import is_perspective


def sees_tiny_lamp(scene: mi.Scene, sensor: mi.Sensor) -> bool:
    """Tells whether the perspective camera ``sensor`` may see a tiny lamp reflected or refracted by a surface.

    Camera rays may miss the reflected or refracted image of a tiny lamp, because this image is small. A lamp is tiny if
    the diagonal of its bounding box is less than the width of two pixels at the lamp's distance from the camera. Only
    emitters with a shape count as lamps. The function only checks that some BSDF of the scene has a glossy or specular
    lobe, not where in the scene this BSDF is. For sensors that are not Mitsuba's perspective camera, and without a
    glossy or specular BSDF, the result is False.
    """
    if not is_perspective(sensor) or not lobes.has_any(all_flags(scene), *lobes.SPECULAR):
        return False
    pixel = 2 * np.tan(np.radians(float(mi.traverse(sensor)["x_fov"][0])) / 2) / sensor.film().size()[0]
    eye = np.ravel(world_transform(sensor, mi.Float(sensor.shutter_open())).translation())
    boxes = (emitter.get_shape().bbox() for emitter in scene.emitters() if emitter.get_shape() is not None)
    return any(np.linalg.norm(box.extents()) < 2 * pixel * np.linalg.norm(box.center() - eye) for box in boxes)
