"""VIEW -> Mitsuba's sensor: exactly the rays of the language, for off-centre and oblique windows too.

A pixel (i, j) looks from E through VRP + u (umin + (i+1/2)(umax-umin)/w) + v (vmax - (j+1/2)(vmax-vmin)/h).
"""

import math
from dataclasses import dataclass

import numpy as np

from .errors import Place

PARALLEL = 1e-9  # sine of an angle below which two directions count as parallel


@dataclass(frozen=True)
class Camera:
    """The frame of a view: unit axes u (right), v (up), n (towards the eye's side), and the window as seen from the eye.

    ``left, bottom, right, top`` are plane coordinates relative to the foot of the eye on the plane, ``depth`` the
    eye's distance to it.
    """

    eye: np.ndarray
    u: np.ndarray
    v: np.ndarray
    n: np.ndarray
    depth: float
    left: float
    bottom: float
    right: float
    top: float
    resolution: tuple[int, int]

    @property
    def pixel(self):
        """Width and height of a pixel on the view plane."""
        return (self.right - self.left) / self.resolution[0], (self.top - self.bottom) / self.resolution[1]

    @property
    def square_pixels(self):
        """Whether width and height of a pixel agree to 1e-4 of a pixel over the whole image."""
        w, h = self.pixel
        return abs(w / h - 1) * max(self.resolution) < 1e-4

    def ray(self, i, j):
        """Unit direction through the centre of pixel (i, j), both may be arrays: the formula above."""
        w, h = self.pixel
        a, b = self.left + (np.asarray(i) + 0.5) * w, self.top - (np.asarray(j) + 0.5) * h
        d = np.multiply.outer(a, self.u) + np.multiply.outer(b, self.v) - self.depth * self.n
        return d / np.linalg.norm(d, axis=-1, keepdims=True)

    def footprint(self, distance: float) -> float:
        """Length that the smaller side of a pixel covers at a distance from the eye."""
        return min(self.pixel) * max(distance, 1e-3 * self.depth) / self.depth

    def may_see(self, corners: np.ndarray) -> bool:
        """Whether the convex hull of points (n, 3) may reach into the pyramid that the window shows."""
        x, y, z = np.stack([self.u, self.v, -self.n]) @ (corners - self.eye).T
        x, y = x * self.depth, y * self.depth  # against the window's borders at the depth z
        return not any(map(np.all, (z <= 0, x < self.left * z, x > self.right * z, y < self.bottom * z, y > self.top * z)))


def camera(scene, resolution=None):
    """The :class:`Camera` of a scene; a degenerate view is a SceneError."""
    view = scene.view

    def error(word, reason):
        return scene.source.error(scene.places.get(word) or view.at or Place(0, 0), reason)

    eye, vrp, vup, normal = (np.array(x, dtype=float) for x in (view.eye, view.vrp, view.vup, view.vpn))
    if not normal.any():
        normal = eye - vrp
        if not normal.any():
            raise error("OBS", "OBS and VRP are the same point and VPN is 0 0 0; expected an eye off the view plane")
    if not vup.any():
        raise error("VUP", "VUP has length 0; expected a direction")
    n, up = normal / np.linalg.norm(normal), vup / np.linalg.norm(vup)
    depth = float((eye - vrp) @ n)
    if abs(depth) <= PARALLEL * max(np.linalg.norm(eye - vrp), np.linalg.norm(eye), np.linalg.norm(vrp)):
        raise error("OBS", "OBS lies on the view plane (through VRP, normal VPN); expected an eye off that plane")
    if depth < 0:
        n, depth = -n, -depth
    u = np.cross(up, n)
    if np.linalg.norm(u) < PARALLEL:
        raise error("VUP", "VUP is parallel to VPN; expected a direction that points up in the image")
    u /= np.linalg.norm(u)
    v = np.cross(n, u)
    umin, vmin, umax, vmax = view.window
    if umin >= umax or vmin >= vmax:
        raise error("WINDOW", f"the window {umin:g} {vmin:g} {umax:g} {vmax:g} is empty; "
                              "expected umin vmin umax vmax with umin < umax and vmin < vmax")
    offset = vrp - eye
    a, b = float(offset @ u), float(offset @ v)
    result = Camera(eye, u, v, n, depth, a + umin, b + vmin, a + umax, b + vmax, resolution or view.resolution)
    if not all(map(math.isfinite, (*result.pixel, result.left, result.top))) or min(result.pixel) <= 0:
        raise error("WINDOW", "the window is too large or too small for numbers of double precision")
    return result


def sensor(cam, film, sampler):
    """Mitsuba's ``perspective`` for square pixels, ``prosim_window`` for any others."""
    width, height = cam.right - cam.left, cam.top - cam.bottom
    to_world = np.eye(4)
    # Mitsuba's camera looks along +z with x to the left of the image.
    to_world[:3] = np.stack([-cam.u, cam.v, -cam.n, cam.eye], axis=1)
    common = {"to_world": to_world, "near_clip": 1e-3 * cam.depth, "far_clip": 1e5 * cam.depth,
              "film": film, "sampler": sampler}
    if not cam.square_pixels:
        return {"type": "prosim_window", "left": cam.left / cam.depth, "right": cam.right / cam.depth,
                "bottom": cam.bottom / cam.depth, "top": cam.top / cam.depth, **common}
    return {
        "type": "perspective",
        "fov": 2 * math.degrees(math.atan2(width / 2, cam.depth)),
        "fov_axis": "x",
        # In units of the image's width and height, from its centre to where the eye looks straight at the plane.
        "principal_point_offset_x": 0.5 + cam.left / width,
        "principal_point_offset_y": 0.5 - cam.top / height,
        **common,
    }
