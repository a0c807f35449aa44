"""How large a pixel is where a camera sees it."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..compat import world_transform
from ..engine.camera import uncropped

#: Where a camera has no pixels to speak of (a meter of one ray): that part of the scene's radius.
LEAST = 1e-5

#: That area over the area of Epanechnikov's kernel.
EVENLY = 0.75


@dataclass(frozen=True)
class Footprint:
    """A pixel is ``size + spread * |p - eye|`` wide at the point p."""

    eye: mi.Point3f
    size: mi.Float
    spread: mi.Float

    @classmethod
    def of(cls, scene: mi.Scene, sensor: mi.Sensor) -> Footprint:
        """That of the pixels in the middle of the film of ``sensor``, a crop window left aside."""
        width, height = (int(v) for v in sensor.film().size())
        with uncropped(sensor):
            middle, right, below = (
                sensor.sample_ray_differential(sensor.shutter_open(), 0.5, mi.Point2f(x, y), mi.Point2f(0.5))[0]
                for x, y in ((0.5, 0.5), (0.5 + 1 / width, 0.5), (0.5, 0.5 + 1 / height))
            )
        apart, turned = (
            min(float(dr.norm(getattr(ray, name) - getattr(middle, name))[0]) for ray in (right, below))
            for name in ("o", "d")
        )
        least = LEAST * float(scene.bbox().bounding_sphere().radius)
        # Rays start at the near plane, where those of a perspective camera are already apart.
        eye = world_transform(sensor, sensor.shutter_open()).translation()
        begun = float(dr.norm(middle.o - eye)[0])
        result = cls(mi.Point3f(eye), mi.Float(max(apart - begun * turned, least)), mi.Float(turned))
        dr.make_opaque(result.eye, result.size, result.spread)
        return result

    def distance(self, p: mi.Point3f) -> mi.Float:
        """That of ``p`` from the eye."""
        return dr.norm(p - self.eye)

    def evenly(self, p: mi.Point3f) -> mi.Float:
        """Area on which photons within reach of ``p`` would count alike, with the same noise as by their kernel."""
        return EVENLY * dr.pi * dr.square(self.at(self.distance(p)))

    def at(self, distance: mi.Float) -> mi.Float:
        """Width of a pixel at that distance."""
        return self.size + self.spread * distance
