"""Camera rays whose code does not depend on the film's size, and whose bits do not depend on the crop window."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compat import PERSPECTIVE, world_transform
from ..optics.nested import all_flags
from ..transport import lobes


def is_perspective(sensor: mi.Sensor) -> bool:
    """Tells whether ``sensor`` is Mitsuba's perspective camera, whose rays :func:`ray_sampler` computes itself."""
    return bool(sensor.class_name() == PERSPECTIVE)


def sees_tiny_lamp(scene: mi.Scene, sensor: mi.Sensor) -> bool:
    """Tells whether the perspective camera ``sensor`` may see a tiny lamp in a glossy surface.

    Few rays may find the image of such a lamp. A lamp is tiny if the diagonal of its bounding box is less than two
    pixels at its distance from the camera. The scene has any glossy or specular lobe; its place does not matter.
    """
    if not is_perspective(sensor) or not lobes.has_any(all_flags(scene), *lobes.SPECULAR):
        return False
    pixel = 2 * np.tan(np.radians(float(mi.traverse(sensor)["x_fov"][0])) / 2) / sensor.film().size()[0]
    eye = np.ravel(world_transform(sensor, mi.Float(sensor.shutter_open())).translation())
    boxes = (emitter.get_shape().bbox() for emitter in scene.emitters() if emitter.get_shape() is not None)
    return any(np.linalg.norm(box.extents()) < 2 * pixel * np.linalg.norm(box.center() - eye) for box in boxes)


def ray_sampler(sensor: mi.Sensor) -> Callable[..., tuple[mi.Ray3f, mi.Spectrum]]:
    """Returns a function like ``sensor.sample_ray_differential``, but without differentials.

    Its arguments are the time, a number for the wavelengths, the position on the whole film, and the position on the
    lens. If the sensor is no perspective camera, call the returned function only within
    :func:`without_crop_window`. Some sensors have no method ``sample_ray``. Mitsuba's perspective camera has the film's
    size as a constant in its code, so Dr.Jit would compile a kernel for each resolution. To avoid this, the returned
    function computes the rays of the perspective camera itself, with the camera's matrices.
    """
    if not is_perspective(sensor):
        return sensor.sample_ray_differential
    params = mi.traverse(sensor)
    offset = mi.Point2f(*(params[f"principal_point_offset_{axis}"] for axis in "xy"))
    size, near, far = mi.ScalarVector2i(sensor.film().size()), sensor.near_clip(), sensor.far_clip()
    fov = float(params["x_fov"][0])  # a number, because a Dr.Jit array would make the size a constant of the kernel
    to_camera = mi.perspective_projection(size, size, mi.ScalarVector2i(0), fov, near, far).inverse()
    near, far = dr.opaque(mi.Float, near), dr.opaque(mi.Float, far)
    dr.make_opaque(to_camera, offset)

    def sample_ray(
        time: mi.Float, wavelength_sample: mi.Float, position: mi.Point2f, _: mi.Point2f
    ) -> tuple[mi.Ray3f, mi.Spectrum]:
        """Returns the camera ray through ``position``, in [0, 1)² on the film, and the weight of the sampled
        wavelengths.
        """
        wavelengths, weight = sensor.sample_wavelengths(dr.zeros(mi.SurfaceInteraction3f), wavelength_sample)
        on_near = to_camera @ mi.Point3f(position.x + offset.x, position.y + offset.y, 0)
        d = dr.normalize(mi.Vector3f(on_near))
        to_world = world_transform(sensor, time)
        direction = to_world @ d
        origin = to_world.translation() + direction * (near / d.z)
        return mi.Ray3f(origin, direction, (far - near) / d.z, time, wavelengths), weight

    return sample_ray


@contextlib.contextmanager
def without_crop_window(sensor: mi.Sensor) -> Iterator[None]:
    """Removes the crop window of the film of ``sensor`` inside the ``with`` block, and restores it at the end.

    Without the crop window, the rays of a crop have the same bits as the rays of the whole image. With a crop window, a
    sensor would scale positions on the film. Use this function only inside a block ``with`` :func:`.alone`, because the
    film belongs to the user.
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
