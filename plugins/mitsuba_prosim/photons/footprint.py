"""The footprint of a pixel: its width where the camera sees it."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..compat import world_transform
from ..engine.camera import without_crop_window

#: Least width of a pixel, for sensors without pixels (a meter of one ray): this part of the scene's radius.
MIN_PIXEL_WIDTH = 1e-5

#: Radii of the kernels of photons, in pixel widths, and the logarithm to base 2 of the ratio of one to the next.
OCTAVES = 2
RADII = tuple(2 ** (OCTAVES * k) for k in range(3))

#: Greatest radius but that of a pixel, as a part of the image.
WIDEST = 1 / 25

#: Area on which photons have equal weights, over the area of an Epanechnikov kernel of the same noise.
UNIFORM_AREA = 0.75


@dataclass(frozen=True)
class Footprint:
    """A pixel is ``size + spread * |p - eye|`` wide at the point p."""

    eye: mi.Point3f
    size: mi.Float
    spread: mi.Float
    #: Those of :data:`RADII` that fit the image.
    radii: tuple[int, ...] = RADII

    @classmethod
    def of(cls, scene: mi.Scene, sensor: mi.Sensor) -> Footprint:
        """The footprint of the pixels in the middle of the whole film of ``sensor``."""
        width, height = (int(v) for v in sensor.film().size())
        with without_crop_window(sensor):
            middle, right, below = (
                sensor.sample_ray_differential(sensor.shutter_open(), 0.5, mi.Point2f(x, y), mi.Point2f(0.5))[0]
                for x, y in ((0.5, 0.5), (0.5 + 1 / width, 0.5), (0.5, 0.5 + 1 / height))
            )
        offset, spread = (
            min(float(dr.norm(getattr(ray, name) - getattr(middle, name))[0]) for ray in (right, below))
            for name in ("o", "d")
        )
        least = MIN_PIXEL_WIDTH * float(scene.bbox().bounding_sphere().radius)
        # Rays start at the near plane, where those of a perspective camera already have a distance.
        eye = world_transform(sensor, sensor.shutter_open()).translation()
        near = float(dr.norm(middle.o - eye)[0])
        radii = tuple(radius for radius in RADII if radius == 1 or radius <= WIDEST * max(width, height))
        result = cls(mi.Point3f(eye), mi.Float(max(offset - near * spread, least)), mi.Float(spread), radii)
        dr.make_opaque(result.eye, result.size, result.spread)
        return result

    def distance(self, p: mi.Point3f) -> mi.Float:
        """Distance of ``p`` from the eye."""
        return dr.norm(p - self.eye)

    def width_at(self, distance: mi.Float) -> mi.Float:
        """Width of a pixel at that distance from the eye."""
        return self.size + self.spread * distance

    def width(self, p: mi.Point3f) -> mi.Float:
        """Width of a pixel at ``p``."""
        return self.width_at(self.distance(p))

    def area(self, p: mi.Point3f) -> mi.Float:
        """Area around ``p`` on which photons with equal weights have the same noise as with those of the kernel."""
        return UNIFORM_AREA * dr.pi * dr.square(self.width(p))
