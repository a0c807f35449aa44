"""Samples camera rays.

The compiled kernel is the same for all film sizes, and the camera rays of a pixel are the same to the bit for all crop
windows.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence

import drjit as dr
import mitsuba as mi

from ..compat import FLAT_SENSOR, PERSPECTIVE, world_transform


def is_perspective(sensor: mi.Sensor) -> bool:
    """Tells whether ``sensor`` is Mitsuba's perspective camera, whose rays :func:`ray_sampler` computes itself."""
    return bool(sensor.class_name() == PERSPECTIVE)


def ray_sampler(sensor: mi.Sensor) -> Callable[..., tuple[mi.RayDifferential3f, mi.Spectrum]]:
    """Returns a function that samples camera rays, with the arguments of ``sensor.sample_ray_differential``.

    The arguments of the returned function are the time, a random number for the wavelengths, the position on the whole
    film in [0, 1)², and the position on the lens. If ``sensor`` is not Mitsuba's perspective camera, the returned
    function is the sensor's method ``sample_ray_differential``. Call this method only within
    :func:`without_crop_window`. The method ``sample_ray`` is not used, because some sensors do not have this method.

    The code of Mitsuba's perspective camera contains the film's size as a constant, so Dr.Jit would compile a new
    kernel for each resolution. To avoid a new kernel for each resolution, the returned function computes the rays of
    the perspective camera itself, from the camera's projection matrix.
    """
    if not is_perspective(sensor):
        return lambda *point: sensor.sample_ray_differential(*point, True)
    params = mi.traverse(sensor)
    offset = mi.Point2f(*(params[f"principal_point_offset_{axis}"] for axis in "xy"))
    size, near, far = mi.ScalarVector2i(sensor.film().size()), sensor.near_clip(), sensor.far_clip()
    fov = params["x_fov"]
    if not dr.grad_enabled(fov):
        fov = float(fov[0])  # a number, because a Dr.Jit array would make the size a constant of the kernel
    to_camera = mi.perspective_projection(size, size, mi.ScalarVector2i(0), fov, near, far).inverse()
    near, far = dr.opaque(mi.Float, near), dr.opaque(mi.Float, far)
    pixel = mi.Point2f(*(dr.opaque(mi.Float, 1 / int(side)) for side in size))
    dr.make_opaque(to_camera, offset)

    def sample_ray(
        time: mi.Float, wavelength_sample: mi.Float, position: mi.Point2f, _: mi.Point2f
    ) -> tuple[mi.RayDifferential3f, mi.Spectrum]:
        """Returns the camera ray through ``position`` on the film, in [0, 1)², and the weight of its wavelengths.

        The ray begins at the near clipping plane, and ends at the far clipping plane. The last argument, the position
        on the lens, is ignored.
        """
        wavelengths, weight = sensor.sample_wavelengths(dr.zeros(mi.SurfaceInteraction3f), wavelength_sample)
        to_world, x, y = world_transform(sensor, time), position.x + offset.x, position.y + offset.y
        d, d_x, d_y = (
            dr.normalize(mi.Vector3f(to_camera @ mi.Point3f(*on_near, 0)))
            for on_near in ((x, y), (x + pixel.x, y), (x, y + pixel.y))
        )
        direction = to_world @ d
        origin = to_world.translation() + direction * (near / d.z)
        ray = mi.RayDifferential3f(mi.Ray3f(origin, direction, (far - near) / d.z, time, wavelengths))
        ray.o_x, ray.o_y, ray.d_x, ray.d_y, ray.has_differentials = origin, origin, to_world @ d_x, to_world @ d_y, True
        return ray, weight

    return sample_ray


@contextlib.contextmanager
def samples_of(sensor: mi.Sensor, x: mi.Int32) -> Iterator[None]:
    """Inside the ``with`` block, the sensor of Mitsuba's ``RayDataLoader`` takes one sample of each pixel in column
    ``x`` of its film, which has one row. Other sensors are not changed.

    This sensor knows the pixel of a sample only by its place among the samples of all pixels, of which each has the
    same number.
    """
    if type(sensor).__name__ != FLAT_SENSOR:
        yield
        return
    batch = sensor.pixel_idx
    sensor.pixel_idx = dr.gather(mi.UInt32, batch, mi.UInt32(x))
    try:
        yield
    finally:
        sensor.pixel_idx = batch


@contextlib.contextmanager
def without_crop_window(sensor: mi.Sensor) -> Iterator[None]:
    """Removes the crop window of the film of ``sensor`` inside the ``with`` block, and restores the window at the end.

    If the film has no crop window, nothing is changed.

    Without the crop window, the camera rays of a pixel have the same bits in a render of a crop as in a render of the
    whole image. With a crop window, Mitsuba's sensors scale positions on the film, which changes the rounding of the
    rays. Use this function only inside a block ``with`` :func:`.alone`, because the film belongs to the user, and
    another render may use the film.
    """
    film = sensor.film()
    with _film_window(sensor, film.size(), (0, 0), film.size()):
        yield


@contextlib.contextmanager
def coarse_film(sensor: mi.Sensor, pixels: int) -> Iterator[None]:
    """Inside the ``with`` block, the crop window of the film has about ``pixels`` pixels or fewer; the image shows the
    same part of the scene.

    The change of the film's size causes no compilation, because Dr.Jit's kernels do not depend on this size.
    """
    film = sensor.film()
    divisor = max(1, math.ceil(math.sqrt(math.prod(film.crop_size()) / pixels)))
    size, crop = ([max(1, side // divisor) for side in sides] for sides in (film.size(), film.crop_size()))
    offset = [min(first // divisor, most - part) for first, most, part in zip(film.crop_offset(), size, crop)]
    with _film_window(sensor, size, offset, crop):
        yield


@contextlib.contextmanager
def _film_window(sensor: mi.Sensor, *window: Sequence[int]) -> Iterator[None]:
    """Inside the ``with`` block, the film has the ``window``: its size, and the offset and the size of the crop."""
    film = sensor.film()
    before = [tuple(map(int, sides)) for sides in (film.size(), film.crop_offset(), film.crop_size())]
    if before == [tuple(sides) for sides in window]:
        yield
        return
    params = mi.traverse(sensor)

    def change(window: Sequence[Sequence[int]]) -> None:
        size, offset, crop = window
        params["film.size"], params["film.crop_size"] = mi.ScalarVector2u(size), mi.ScalarVector2u(crop)
        params["film.crop_offset"] = mi.ScalarPoint2u(offset)
        params.update()

    try:
        change(window)
        yield
    finally:
        change(before)
