"""Computes the camera of a scene from its VIEW statement; the camera is exact, also for off-centre windows and oblique
views.

The ray through pixel (i, j) of a w x h image starts at the eye, and passes through the point VRP + u (umin +
(i+1/2)(umax-umin)/w) + v (vmax - (j+1/2)(vmax-vmin)/h) of the view plane; the unit vectors u and v point to the right
and up in the image.
"""

from dataclasses import dataclass

import numpy as np

from .language.document import Document

PARALLEL = 1e-9  # the sine of an angle; two directions with a smaller angle between them are parallel
MIN_LENGTH = 1e-15  # a shorter direction vector counts as 0
CENTRED = 1e-9  # the largest offset of a window that counts as 0, relative to its smaller side
WIDEST, NARROWEST = 1e5, 1e-9  # largest and smallest side of a window, relative to the window's distance from the eye


@dataclass(frozen=True)
class Camera:
    """A camera in world coordinates: the position of the eye, three unit axes, and the window on the view plane.

    The axis ``u`` points to the right in the image, ``v`` points up, and ``n`` is the view plane's normal on the side
    of the eye.

    ``depth`` is the distance of the eye from the view plane. ``left, bottom, right, top`` are the borders of the window
    on the view plane, relative to the orthogonal projection of the eye onto this plane. ``resolution`` is (width,
    height) in pixels. ``aperture`` is the radius of the lens, and ``focus`` the depth of the plane of focus.
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
    aperture: float
    focus: float

    @property
    def size(self) -> tuple[float, float]:
        """The width and the height of the window."""
        return self.right - self.left, self.top - self.bottom

    @property
    def centred(self) -> bool:
        """Whether the middle of the window is straight ahead, except for rounding."""
        return max(abs(self.left + self.right), abs(self.top + self.bottom)) < CENTRED * min(self.size)

    @property
    def pixel(self) -> tuple[float, float]:
        """The width and the height of a pixel on the view plane, in scene units."""
        return self.size[0] / self.resolution[0], self.size[1] / self.resolution[1]

    @property
    def square_pixels(self) -> bool:
        """Whether width and height of a row's or column's pixels differ by less than 1e-4 in all."""
        w, h = self.pixel
        return abs(w / h - 1) * max(self.resolution) < 1e-4

    def footprint(self, distance: np.ndarray | float) -> np.ndarray:
        """Returns the length that the smaller side of a pixel covers at a distance from the eye.

        A distance below ``depth`` / 1000 is replaced by ``depth`` / 1000, so the result is never 0.
        """
        return np.asarray(min(self.pixel) * np.maximum(distance, 1e-3 * self.depth) / self.depth)

    def may_see(self, corners: np.ndarray) -> np.ndarray:
        """Whether the convex hull of points (..., n, 3) may intersect the view frustum.

        The test is conservative: if the result is False, the camera certainly does not see the points; if True, it may
        see them.
        """
        x, y, z = np.moveaxis((corners - self.eye) @ np.stack([self.u, self.v, -self.n]).T, -1, 0)
        x, y = x * self.depth, y * self.depth  # now x and y can be compared with the window's borders times z
        outside = [z <= 0, x < self.left * z, x > self.right * z, y < self.bottom * z, y > self.top * z]
        return np.asarray(~np.any([side.all(axis=-1) for side in outside], axis=0))


def distortion_message(width: int, height: int, ratio: float) -> str | None:
    """Returns the message that an image of ``width`` x ``height`` pixels is distorted, because the scene's window has
    another aspect ratio; ``ratio`` is the width of the window divided by its height.

    Returns None if the distortion is below 1 %, or is caused only by rounding to whole pixels.
    """
    rounding = min(abs(width - height * ratio), abs(height - width / ratio)) <= 1
    if rounding or abs(width / (height * ratio) - 1) <= 0.01:
        return None
    others = f"{width}x{max(round(width / ratio), 1)} or {max(round(height * ratio), 1)}x{height}"
    return f"{width}x{height} pixels distort the image of the scene's window; {others} would not"


def warn_of_distortion(document: Document) -> None:
    """Warns if the RESOLUTION and the WINDOW of a scene have different aspect ratios; :func:`distortion_message`
    defines which differences count. The warning is about RESOLUTION if the text states it, or else about WINDOW.
    """
    view = document.scene.view
    umin, vmin, umax, vmax = view.window
    message = distortion_message(*view.resolution, (umax - umin) / (vmax - vmin))
    if message is not None:
        known = document.is_given("view", "resolution")
        document.warn(message, "view", "resolution" if known else "window")


def camera_of(document: Document, resolution: tuple[int, int] | None = None) -> Camera:
    """Returns the :class:`Camera` of a scene; ``resolution``, if given, replaces the RESOLUTION of the scene. If VPN is
    0 0 0, the normal of the view plane is EYE - VRP.

    Raises SceneError for a degenerate view: an eye on the view plane, a VPN that is tiny but not 0 0 0, a VUP that has
    length 0 or is parallel to VPN, or a window that is empty, too large or too small.
    """
    view = document.scene.view
    eye, vrp, vup, normal = (np.array(x, dtype=float) for x in (view.eye, view.vrp, view.vup, view.vpn))
    if not normal.any():
        normal = eye - vrp
        if np.linalg.norm(normal) < MIN_LENGTH:
            raise document.error("EYE and VRP are the same point and VPN is 0 0 0; move one", "view", "eye")
    if np.linalg.norm(normal) < MIN_LENGTH:
        raise document.error("VPN has length 0 in single precision; expected a direction, or 0 0 0", "view", "vpn")
    if np.linalg.norm(vup) < MIN_LENGTH:
        raise document.error("VUP has length 0; expected a direction", "view", "vup")
    n, up = normal / np.linalg.norm(normal), vup / np.linalg.norm(vup)
    depth = float((eye - vrp) @ n)
    if abs(depth) <= PARALLEL * max(np.linalg.norm(eye - vrp), np.linalg.norm(eye), np.linalg.norm(vrp)):
        raise document.error("EYE lies on the view plane (through VRP, normal VPN); move it", "view", "eye")
    if depth < 0:  # VPN points away from the eye
        n, depth = -n, -depth
    u = np.cross(up, n)
    if np.linalg.norm(u) < PARALLEL:
        raise document.error("VUP is parallel to VPN; expected a direction that points up in the image", "view", "vup")
    u /= np.linalg.norm(u)
    v = np.cross(n, u)
    umin, vmin, umax, vmax = view.window
    if umin >= umax or vmin >= vmax:
        raise document.error("this window is empty; expected umin < umax and vmin < vmax", "view", "window")
    offset = vrp - eye
    a, b = float(offset @ u), float(offset @ v)
    window = a + umin, b + vmin, a + umax, b + vmax
    lens = view.aperture, view.focus or depth
    result = Camera(eye, u, v, n, depth, *window, resolution or view.resolution, *lens)
    least, most = NARROWEST * depth, WIDEST * depth
    if not least <= min(result.size) <= max(result.size) <= most:
        reason = f"this window is too large or too small; expected sides from {least:g} to {most:g}"
        raise document.error(reason, "view", "window")
    return result
