"""Finds lamps that are so small that rays may miss their reflections and their light behind glass."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compat import world_transform
from ..optics.nested import all_flags, all_shapes
from ..transport import lobes
from .camera import is_perspective

#: Minimum value, straight on, of a transmitting lobe that few rays find: that of glass with a roughness of 0.2.
NARROW = 30.0


def sees_tiny_lamp(scene: mi.Scene, sensor: mi.Sensor) -> bool:
    """Tells whether the perspective camera ``sensor`` may see a tiny lamp reflected or refracted by a surface.

    Camera rays may miss the reflected or refracted image of a tiny lamp, because this image is small. A lamp is tiny if
    the diagonal of its bounding box is less than the width of two pixels at the lamp's distance from the camera. Only
    emitters with a shape count as lamps. The function only checks that some BSDF of the scene has a glossy or specular
    lobe, not where in the scene this BSDF is. For sensors that are not Mitsuba's perspective camera, and without a
    glossy or specular BSDF, the result is False.

    A lamp without an extent is tiny in any view if the scene has glass with little roughness: only the few rays that
    leave the glass in the direction of the lamp find its light.
    """
    if any(mi.has_flag(lamp.flags(), mi.EmitterFlags.Delta) for lamp in scene.emitters()) and has_clear_glass(scene):
        return True
    if not is_perspective(sensor) or not lobes.has_any(all_flags(scene), *lobes.SPECULAR):
        return False
    pixel = 2 * np.tan(np.radians(float(mi.traverse(sensor)["x_fov"][0])) / 2) / sensor.film().size()[0]
    eye = np.ravel(world_transform(sensor, mi.Float(sensor.shutter_open())).translation())
    boxes = (emitter.get_shape().bbox() for emitter in scene.emitters() if emitter.get_shape() is not None)
    return any(np.linalg.norm(box.extents()) < 2 * pixel * np.linalg.norm(box.center() - eye) for box in boxes)


def has_clear_glass(scene: mi.Scene) -> bool:
    """Tells whether the scene has glass that scatters light into a narrow, but not a single, direction."""
    bsdfs = {bsdf for shape in all_shapes(scene) if (bsdf := shape.bsdf()) is not None}
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi = mi.Vector3f(0, 0, 1)
    return any(
        lobes.has_any(int(bsdf.flags()), "GlossyTransmission")
        and bool(dr.any(dr.max(mi.unpolarized_spectrum(bsdf.eval(mi.BSDFContext(), si, -si.wi))) > NARROW))
        for bsdf in bsdfs
    )
