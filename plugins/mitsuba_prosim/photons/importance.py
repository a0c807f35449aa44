"""The importance of a photon for an image, by the place where it lands: an importance map (Peter and Pietrek 1998)."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from ..engine.camera import uncropped
from ..masks import but_not
from ..sampling.hash import combine
from ..transport import lobes
from . import grid
from .emission import Start, start_points
from .footprint import Footprint
from .grid import WIDE, Landed
from .tracing import Walk

#: Camera rays, and entries of the hash table that they are counted in.
RAYS, ENTRIES = 1 << 16, 1 << 18

#: Reach of a cell of that table, as a part of the width of the image.
REACH = 1 / 128

#: Radiance that a surface has besides that of the photons, white being 1: the eye sees the noise of dark ones more.
OTHER = 0.1


class Importance:
    """The contribution of a photon to the pixels of ``sensor``, by its flux and by the place where it lands.

    Rays of the camera go by ``walk`` as photons do. In each cell of space, the sum of the squared reflectances of what
    they meet is its visibility, directly or through specular surfaces.
    """

    def __init__(self, scene: mi.Scene, sensor: mi.Sensor, walk: Walk, footprint: Footprint) -> None:
        self.footprint = footprint
        self.scale = dr.opaque(mi.Float, REACH * max(sensor.film().size()))
        i = dr.arange(mi.UInt32, RAYS)
        with uncropped(sensor):
            ray, _ = sensor.sample_ray(sensor.shutter_open(), 0.5, *start_points(mi.UInt32(0), i))
        si = scene.ray_intersect(ray)
        start = Start(ray, mi.Spectrum(1), mi.Float(0), dr.zeros(mi.PositionSample3f), dr.zeros(mi.EmitterPtr, RAYS))
        beyond, _ = walk(start, combine(mi.UInt32(0), i))
        through = dr.select(beyond.valid, dr.sqrt(dr.minimum(dr.max(beyond.flux), 1)) * dr.inv_pi, 0)
        entries = np.concatenate([np.array(self._entry(p)) for p in (si.p, beyond.p)])
        reflectances = np.concatenate([np.array(reflectance(si)), np.array(through)]).astype(np.float64)
        self.visibility = np.bincount(entries, reflectances**2, minlength=ENTRIES)
        rays = np.bincount(entries, reflectances > 0, minlength=ENTRIES)
        self.reflectances = np.bincount(entries, reflectances, minlength=ENTRIES) / np.maximum(rays, 1)
        self.irradiance, self.rounds = np.zeros(ENTRIES), 0

    def __call__(self, landed: Sequence[Landed | None]) -> np.ndarray:
        """Mean square contribution of each photon of a round to a pixel, in display units up to a factor; 0 where none
        has ``landed``.

        The tone curve is about a square root: the square of its slope is as the inverse of the radiance, which all
        rounds up to this one tell.
        """
        kinds = [one for one in landed if one is not None]
        entries = [self._entry(one.p) for one in kinds]
        for one, entry in zip(kinds, entries):
            area = dr.square(grid.edge(self._level(one.p)))
            per_area = np.array(dr.select(one.valid, dr.max(one.flux) / area, 0))
            self.irradiance += np.bincount(np.array(entry), per_area, minlength=ENTRIES)
        self.rounds += 1
        radiance = self.reflectances * self.irradiance / self.rounds
        weights = mi.Float((self.visibility / (OTHER + radiance)).tolist())  # a list: see Targets
        result = mi.Float(0)
        for one, entry in zip(kinds, entries):
            width = self.footprint.width(one.p)
            added = dr.max(one.flux) / (dr.square(width) * dr.select(one.wide, WIDE, 1))
            weight = dr.gather(mi.Float, weights, entry, one.valid)
            result += dr.select(one.valid, weight * dr.square(added), 0)
        return np.array(result, dtype=np.float64)

    def _entry(self, p: mi.Point3f) -> mi.UInt32:
        """The entry of the hash table that the cell of ``p`` has."""
        level = self._level(p)
        x, y, z = grid.cell(p, level)
        return combine(grid.key(level, y, z), mi.UInt32(x)) & dr.opaque(mi.UInt32, ENTRIES - 1)

    def _level(self, p: mi.Point3f) -> mi.Int32:
        """The grid that the cell of ``p`` is of."""
        return grid.level_of(self.scale * self.footprint.width(p))


def reflectance(si: mi.SurfaceInteraction3f) -> mi.Float:
    """Diffuse reflectance at ``si`` over pi; 1 / pi of a surface with other lobes."""
    bsdf, valid = si.bsdf(), si.is_valid()
    up = mi.Vector3f(0, 0, dr.sign(mi.Frame3f.cos_theta(si.wi)))
    diffuse = dr.max(mi.unpolarized_spectrum(bsdf.eval(lobes.diffuse(), si, up, valid)))
    only = but_not(valid, lobes.has_any(bsdf.flags(), *lobes.GLOSSY, *lobes.IDEAL))
    return dr.select(only, diffuse, dr.select(valid, dr.inv_pi, 0))
