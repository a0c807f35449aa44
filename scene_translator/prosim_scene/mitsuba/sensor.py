"""Translates a camera to a Mitsuba sensor; the translation is exact, also for off-centre windows and oblique views.

The scene language has no clipping planes, so the clipping planes of the sensor enclose the whole scene.
"""

import math
from collections.abc import Collection, Iterable

import numpy as np

from ..geometry import Triangles
from ..model import Light
from ..nodes import Default, Node
from ..view import Camera
from .translation_context import Context

#: The default depths of the clipping planes, in units of the view plane's distance from the eye.
NEAR, FAR = 1e-3, 1e5


def clipping_depths(camera: Camera, meshes: Collection[Triangles], lights: Iterable[Light]) -> tuple[float, float]:
    """Returns the depths of a near and a far clipping plane. Neither plane clips a triangle of ``meshes``, and the far
    plane clips no light.

    A depth is a distance from the eye along the viewing direction, in scene units.

    The default depths of the planes are NEAR and FAR times the depth of the view plane. The depth of the far clipping
    plane is also at least twice the depth of any triangle and light. If a triangle may lie in front of the default near
    clipping plane, the near plane gets a tiny depth, which is never 0.
    """
    depths = [_depth(camera, np.array(light.position)) + light.radius for light in lights if light.kind != "sky"]
    depths += [_depth(camera, mesh.vertices).max() for mesh in meshes]
    near, far = NEAR * camera.depth, max([FAR * camera.depth, *(2 * float(depth) for depth in depths)])
    x, y = max(abs(camera.left), abs(camera.right)), max(abs(camera.bottom), abs(camera.top))
    slant = math.hypot(x, y, camera.depth) / camera.depth  # distance over depth, in a corner of the image
    if any(_is_near(camera.eye, mesh, near * slant + camera.aperture) for mesh in meshes):
        near = 1e-9 * max(float(np.abs(mesh.vertices - camera.eye).max()) for mesh in meshes)
    return near, far


def _depth(camera: Camera, points: np.ndarray) -> np.ndarray:
    return np.asarray((camera.eye - points) @ camera.n)


def _is_near(point: np.ndarray, mesh: Triangles, distance: float) -> bool:
    below, above = mesh.vertices < point + distance, mesh.vertices > point - distance
    return bool(np.all(below[mesh.index].any(axis=1) & above[mesh.index].any(axis=1), axis=1).any())


def sensor(context: Context, camera: Camera, lens: str, sampler: str, meshes: Collection[Triangles]) -> Node:
    """Returns the dictionary of a camera's sensor, which is Mitsuba's ``perspective`` for a pinhole with square pixels,
    and ``prosim_window`` for other cameras. The plugin ``lens`` is used for a camera with an aperture. The clipping
    planes of the sensor clip no triangle of ``meshes``.
    """
    near, far = clipping_depths(camera, meshes, context.scene.lights)
    width, height = camera.size
    to_world = np.eye(4)
    # Mitsuba's camera looks along +z; its x axis points to the left side of the image.
    to_world[:3] = np.stack([-camera.u, camera.v, -camera.n, camera.eye], axis=1)
    common = {
        "to_world": to_world,
        "near_clip": near,
        "far_clip": far,
        "film": {
            "type": "hdrfilm",
            "width": Default("width", camera.resolution[0]),
            "height": Default("height", camera.resolution[1]),
            "pixel_format": "rgb",
            "component_format": "float32",
            "filter": {"type": "box"},
        },
        "sampler": {"type": sampler, "sample_count": context.samples**2},
    }
    kind = lens if camera.aperture else "perspective" if camera.square_pixels else "prosim_window"
    if camera.aperture:
        common |= {"aperture_radius": camera.aperture, "focus_distance": camera.focus}
    if kind == "prosim_window":
        window = {side: getattr(camera, side) / camera.depth for side in ("left", "right", "bottom", "top")}
        return {"type": kind, **window, **common}
    # The orthogonal projection of the eye onto the view plane: its offset from the image's centre, in image sizes.
    x, y = 0.5 + camera.left / width, 0.5 - camera.top / height
    offsets = {} if camera.centred else {"principal_point_offset_x": x, "principal_point_offset_y": y}
    return {
        "type": kind,
        "fov": 2 * math.degrees(math.atan2(width / 2, camera.depth)),
        "fov_axis": "x",
        **offsets,
        **common,
    }
