"""Camera -> Mitsuba's sensor: exactly the rays of the language, for off-centre and oblique windows too."""

import math

import numpy as np

from ..nodes import Node
from ..view import Camera


def sensor(camera: Camera, planes: tuple[float, float], film: Node, sampler: Node) -> Node:
    """Mitsuba's ``perspective`` for square pixels, ``prosim_window`` for any others, between two ``planes``."""
    width, height = camera.right - camera.left, camera.top - camera.bottom
    to_world = np.eye(4)
    # Mitsuba's camera looks along +z with x to the left of the image.
    to_world[:3] = np.stack([-camera.u, camera.v, -camera.n, camera.eye], axis=1)
    common = {"to_world": to_world, "near_clip": planes[0], "far_clip": planes[1], "film": film, "sampler": sampler}
    if not camera.square_pixels:
        return {
            "type": "prosim_window",
            "left": camera.left / camera.depth,
            "right": camera.right / camera.depth,
            "bottom": camera.bottom / camera.depth,
            "top": camera.top / camera.depth,
            **common,
        }
    return {
        "type": "perspective",
        "fov": 2 * math.degrees(math.atan2(width / 2, camera.depth)),
        "fov_axis": "x",
        # In units of the image's width and height, from its centre to where the eye looks straight at the plane.
        "principal_point_offset_x": 0.5 + camera.left / width,
        "principal_point_offset_y": 0.5 - camera.top / height,
        **common,
    }
