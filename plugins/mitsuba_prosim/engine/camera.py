"""Camera rays whose code does not depend on the film's size, nor their bits on its crop window."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

from ..compat import PERSPECTIVE, world_transform

if TYPE_CHECKING:
    #: From time and a number for the wavelengths, the places on the film and on the lens: the ray and its weight.
    RaySampler = Callable[[mi.Float, mi.Float, mi.Point2f, mi.Point2f], tuple[mi.Ray3f, mi.Spectrum]]


def is_perspective(sensor: mi.Sensor) -> bool:
    """Whether ``sensor`` is Mitsuba's perspective camera, whose rays :func:`ray_sampler` makes itself."""
    return bool(sensor.class_name() == PERSPECTIVE)


def ray_sampler(sensor: mi.Sensor) -> RaySampler:
    """A function like ``sensor.sample_ray_differential`` without differentials, for positions on the whole film. A
    sensor without :func:`is_perspective` must be called within :func:`without_crop_window`.

    Not every sensor has a ``sample_ray``. Mitsuba's perspective camera has the film's size as a constant in its code,
    so that Dr.Jit would compile a kernel for each resolution: its rays are made here, by its own matrices.
    """
    if not is_perspective(sensor):
        return sensor.sample_ray_differential
    params = mi.traverse(sensor)
    offset = mi.Point2f(*(params[f"principal_point_offset_{axis}"] for axis in "xy"))
    size, near, far = mi.ScalarVector2i(sensor.film().size()), sensor.near_clip(), sensor.far_clip()
    fov = float(params["x_fov"][0])  # a literal, as the kernel of an array would have the size as a constant
    to_camera = mi.perspective_projection(size, size, mi.ScalarVector2i(0), fov, near, far).inverse()
    near, far = dr.opaque(mi.Float, near), dr.opaque(mi.Float, far)
    dr.make_opaque(to_camera, offset)

    def sample_ray(
        time: mi.Float, wavelength_sample: mi.Float, position: mi.Point2f, _: mi.Point2f
    ) -> tuple[mi.Ray3f, mi.Spectrum]:
        wavelengths, weight = sensor.sample_wavelengths(dr.zeros(mi.SurfaceInteraction3f), wavelength_sample)
        on_near = to_camera @ mi.Point3f(position.x + offset.x, position.y + offset.y, 0)
        d = dr.normalize(mi.Vector3f(on_near))
        ray = dr.zeros(mi.Ray3f)
        ray.time, ray.wavelengths = time, wavelengths
        to_world = world_transform(sensor, time)
        ray.d = to_world @ d
        ray.o = to_world.translation() + ray.d * (near / d.z)
        ray.maxt = (far - near) / d.z
        return ray, weight

    return sample_ray


@contextlib.contextmanager
def without_crop_window(sensor: mi.Sensor) -> Iterator[None]:
    """Removes the crop window of the film of ``sensor`` for a while, so that the rays of a crop are those of the whole
    image to the bit (a sensor scales positions by the window). Only within :func:`.alone`, as the film is the user's.
    """
    film = sensor.film()
    offset, size = mi.ScalarPoint2u(film.crop_offset()), mi.ScalarVector2u(film.crop_size())
    if all(offset == 0) and all(size == film.size()):
        yield
        return
    params = mi.traverse(sensor)
    try:
        params["film.crop_offset"], params["film.crop_size"] = mi.ScalarPoint2u(0), mi.ScalarVector2u(film.size())
        params.update()
        yield
    finally:
        params["film.crop_offset"], params["film.crop_size"] = offset, size
        params.update()
