"""Finds lamps that are so small that rays may miss their reflections and their light behind glass."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compat import MAPS, exposed, name_of, named_by, world_transform
from ..optics.nested import all_bsdfs, all_flags, all_shapes, all_within
from ..transport import lobes
from .camera import is_perspective

#: Minimum value, straight on, of a transmitting lobe that few rays find: that of glass with a roughness of 0.2; and of
#: a reflecting lobe that fewer than one of a thousand rays find: that of metal with a roughness of 0.016. Light
#: through glass has no other way, but a reflection adds to the direct light. Maximum size in radians of a lamp that
#: few rays from a diffuse surface find through glass, about one of five thousand; and how many rays of an image must
#: find it, so that the measured error contains its noise.
NARROW, POLISHED, SMALL, ENOUGH = 30.0, 300.0, 0.06, 200
#: Width of the sun in radians, which is a few texels of a bitmap that is so wide.
SUN, WIDE = 0.0094, 2048

#: Beginnings of the names of the parameters of lamps that are factors of their light.
POWER = ("radiance", "intensity", "irradiance", "data", "scale", "texture")


def samples_for_tiny_lamps(
    scene: mi.Scene, sensor: mi.Sensor, by_chance: bool = False
) -> tuple[float, mi.Emitter | None]:
    """Returns how many samples all pixels need together, so that rays meet a tiny lamp that a surface reflects or
    refracts, and this lamp: 0 without a tiny lamp, infinite if no number suffices.

    Camera rays may miss the reflected or refracted image of a tiny lamp, because this image is small. A lamp is tiny if
    the diagonal of its bounding box, or of the :func:`bright_part` of its bitmap, is less than the width of two pixels
    at the lamp's distance from the perspective camera ``sensor``; of an environment, its sun or bright part counts. The
    function only checks that some BSDF of the scene has a glossy or specular lobe, not where in the scene this BSDF is.

    ``by_chance``: whether only rays that meet a lamp by chance find its light behind glass, as in a path tracer. Then a
    lamp is also tiny if the scene has glass, and the lamp's diagonal is less than :data:`SMALL`, seen from the camera:
    about one in ``20 / diagonal**2`` rays from surfaces as far away meets it. A lamp without an extent is tiny if the
    glass is a little rough, or a metal almost a mirror. For sensors that are not Mitsuba's perspective camera, the size
    of lamps is not known.
    """
    clear, rough = has_glass(scene) if by_chance else (False, False)
    points = [lamp for lamp in scene.emitters() if mi.has_flag(lamp.flags(), mi.EmitterFlags.Delta)]
    if by_chance and points and (rough or has_lobe(scene, "GlossyReflection", POLISHED)):
        return np.inf, points[0]
    if not is_perspective(sensor) or not lobes.has_any(all_flags(scene), *lobes.SPECULAR):
        return 0, None
    pixel = 2 * np.tan(np.radians(float(mi.traverse(sensor)["x_fov"][0])) / 2) / sensor.film().size()[0]
    eye, smallest = np.ravel(world_transform(sensor, mi.Float(sensor.shutter_open())).translation()), (np.inf, None)
    for lamp in scene.emitters():
        if lamp.get_shape() is not None:
            box = lamp.get_shape().bbox()
            diagonal = np.linalg.norm(box.extents()) * bright_part(lamp) ** 0.5
            seen = float(diagonal / max(np.linalg.norm(box.center() - eye), 1e-30))
        else:
            sun = "sun_scale" in (params := exposed(lamp)) and np.any(np.array(params["sun_scale"]))
            seen = SUN if sun else (4 * np.pi * bright_part(lamp)) ** 0.5
        smallest = (seen, lamp) if seen < smallest[0] else smallest
    size, lamp = smallest
    if size < 2 * pixel:
        return np.inf, lamp
    return (ENOUGH * 20 / size**2, lamp) if (clear or rough) and size < SMALL else (0, None)


def bright_part(lamp: mi.Emitter) -> float:
    """Returns which part of the bitmaps of a lamp has most of its light, 0 to 1; 1 without a bitmap."""
    params, parts = exposed(lamp), [1.0]
    for name in params.keys():  # noqa: SIM118 (a SceneParameters iterates over other things)
        if isinstance(data := params[name], mi.TensorXf) and data.ndim == 3:
            height, width, channels = data.shape
            step, used = 1 + width // WIDE, np.arange(min(channels, 3))
            x, y = np.arange(0, width, step)[:, None], np.arange(0, height, step)[:, None, None]
            where = (y * width + x) * channels + used  # of large bitmaps, few texels are read
            texels = np.array(dr.gather(type(data.array), data.array, mi.UInt32(where.ravel()))).reshape(where.shape)
            if mi.is_spectral and texels.shape[-1] == 3:  # coefficients of spectra (Jakob and Hanika 2019)
                wavelengths = np.array([450, 550, 650])
                values = np.clip(texels @ np.vander(wavelengths, 3).T, -1e9, 1e9)
                texels = 0.5 + 0.5 * values / np.hypot(1, values)
            light = texels.max(axis=-1)
            if light.any():
                light = light / light.max()  # of which the squares are finite
                parts.append(float(np.mean(light, dtype=np.float64) ** 2 / np.mean(light**2, dtype=np.float64)))
    return min(parts)


def lights_off(scene: mi.Scene, called: Callable[[Any], str] = name_of, endless: bool = False) -> list[str]:
    """Returns the lamps that give no light, with the parameter that is 0, in words; ``endless``: only those of an
    environment.
    """
    off = []
    for lamp in (emitter for emitter in scene.emitters() if emitter.is_environment() or not endless):
        params = exposed(lamp)
        for name in params.keys():  # noqa: SIM118 (a SceneParameters iterates over other things)
            if name.partition(".")[0] in POWER and "to_" not in name and not np.any(np.array(params[name])):
                off.append(f"{name.partition('.')[0]} of {called(named_by(lamp))} is 0")
                break
    return off


def has_glass(scene: mi.Scene) -> tuple[bool, bool]:
    """Returns whether glass or a mirror of the scene sends light into a single direction, and whether glass into a
    narrow cone.
    """
    flags = [int(bsdf.flags()) for bsdf in all_bsdfs(scene)]
    mirror = any(lobes.has_any(one, "DeltaReflection") and not lobes.has_any(one, *lobes.DIFFUSE) for one in flags)
    return mirror or lobes.has_any(all_flags(scene), "DeltaTransmission"), has_lobe(scene, "GlossyTransmission", NARROW)


def has_lobe(scene: mi.Scene, kind: str, least: float) -> bool:
    """Tells whether a BSDF of the scene has a lobe of a ``kind``, a name in ``mi.BSDFFlags``, with a value above
    ``least`` straight on.
    """
    bsdfs = {bsdf for shape in all_shapes(scene) if (bsdf := shape.bsdf()) is not None}
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi = mi.Vector3f(0, 0, 1)
    wo = si.wi if kind.endswith("Reflection") else -si.wi
    parts = (part for bsdf in bsdfs for part in all_within(bsdf) if part.class_name() not in MAPS)
    values = (part.eval(mi.BSDFContext(), si, wo, mi.Bool(True)) for part in parts if lobes.has_any(part.flags(), kind))
    return any(bool(dr.any(dr.max(mi.unpolarized_spectrum(mi.Spectrum(value))) > least)) for value in values)
