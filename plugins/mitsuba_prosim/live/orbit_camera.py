"""A camera that rotates about a point, and the text that describes this camera in a scene file."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from prosim_scene import View

#: Maximum ratio of the distance to the pivot to this distance in the scene file's view; the minimum is the inverse.
#: Beyond these limits, single precision is not sufficient.
FARTHEST = 1e5

#: The steepest viewing direction, in degrees above or below the horizon. Beyond 90 degrees the image would turn upside
#: down.
STEEPEST = 89.0


@dataclass(frozen=True, eq=False)
class Camera:
    """A view of the scene.

    ``to_world`` is the 4x4 matrix, without scaling, from camera coordinates to world coordinates. In camera
    coordinates, the camera looks along +z, and +x points to the left of the image, as in Mitsuba. ``distance`` is the
    distance from the eye to the pivot, the point in the viewing direction about which the camera rotates. ``up`` is the
    unit vector of the axis about which the camera rotates to the left and right. ``across`` is the size (width, height)
    of the region that is visible at distance 1 from the eye. ``home`` is the distance from the eye to the pivot in the
    scene file's view; None if ``distance`` still has this value.
    """

    to_world: np.ndarray
    distance: float
    up: np.ndarray
    across: tuple[float, float]
    home: float | None = None

    @property
    def eye(self) -> np.ndarray:
        """The position of the eye."""
        return np.asarray(self.to_world[:3, 3])

    @property
    def pivot(self) -> np.ndarray:
        """The point about which the camera rotates."""
        return np.asarray(self.eye + self.distance * self.to_world[:3, 2])

    def orbited(self, right: float, up: float) -> Camera:
        """Returns the camera after a rotation about the pivot by ``right`` and ``up`` degrees, up to :data:`STEEPEST`
        degrees above or below the horizon, the plane that is perpendicular to :attr:`up`.
        """
        level = np.degrees(np.arcsin(np.clip(-self.to_world[:3, 2] @ self.up, -1, 1)))
        # A camera that is already steeper than STEEPEST may stay so, but must not become steeper.
        low, high = min(-STEEPEST, level), max(STEEPEST, level)
        up = float(np.clip(level + up, low, high) - level)
        turn = rotation(self.up, right) @ rotation(self.to_world[:3, 0], up)
        moved = np.eye(4)
        moved[:3, :3] = turn
        moved[:3, 3] = self.pivot - turn @ self.pivot
        return replace(self, to_world=moved @ self.to_world)

    def panned(self, right: float, up: float) -> Camera:
        """Returns the camera after a translation parallel to the image plane, by which points at the pivot's distance
        move in the image by the fractions ``right`` of its width and ``up`` of its height.
        """
        width, height = self.across
        to_world = self.to_world.copy()
        to_world[:3, 3] += self.distance * (right * width * to_world[:3, 0] - up * height * to_world[:3, 1])
        return replace(self, to_world=to_world)

    def dollied(self, factor: float) -> Camera:
        """Returns the camera after a motion that multiplies the distance to the pivot by ``factor``, within the limits
        of :data:`FARTHEST`.
        """
        home = self.home or self.distance
        distance = min(max(factor * self.distance, home / FARTHEST), home * FARTHEST)
        to_world = self.to_world.copy()
        to_world[:3, 3] = self.pivot - distance * to_world[:3, 2]
        return replace(self, to_world=to_world, distance=distance, home=home)


def rotation(axis: np.ndarray, degrees: float) -> np.ndarray:
    """Returns the 3x3 matrix of a right-handed rotation by ``degrees`` about the unit vector ``axis``."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(degrees)
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)


def nearest_axis(direction: np.ndarray) -> np.ndarray:
    """Returns the unit vector of the coordinate axis (+x, -x, +y, ...) that is nearest to ``direction``."""
    k = int(np.argmax(np.abs(direction)))
    return np.asarray(np.sign(direction[k]) * np.eye(3)[k])


def as_view(view: View, home: Camera, moved: Camera, spellings: Mapping[str, str]) -> str:
    """Returns the text of a VIEW statement, in the scene language, that describes the camera ``moved``.

    ``view`` is the VIEW statement of the scene file, and ``home`` is the camera that this statement describes.
    ``spellings`` maps English keywords to those of the scene file.
    """
    # The greatest coordinate. Coordinates of points that are much smaller are rounding errors, and are written as 0.
    size = float(np.abs([view.eye, view.vrp]).max())
    motion = moved.to_world @ np.linalg.inv(home.to_world)

    def vector(value: tuple[float, float, float], homogeneous: float) -> str:
        return format_numbers((motion @ [*value, homogeneous])[:3], size if homogeneous else 1.0)

    # The view plane and the window keep their position relative to the eye, also after a change of the distance.
    # If VPN is 0 0 0, the normal of the view plane is EYE - VRP, also for the moved camera.
    lines = [
        "VIEW",
        "RESOLUTION {} {}".format(*view.resolution),
        f"WINDOW {format_numbers(view.window)}",
        f"EYE {vector(view.eye, 1)}",
        f"VPN {vector(view.vpn, 0) if any(view.vpn) else '0 0 0'}",
        f"VRP {vector(view.vrp, 1)}",
        f"VUP {vector(view.vup, 0)}",
        *([f"APERTURE {view.aperture:.7g}"] if view.aperture else []),
        *([] if view.focus is None else [f"FOCUS {view.focus:.7g}"]),
    ]
    return re.sub("[A-Z]+", lambda word: spellings.get(word[0], word[0]), "\n    ".join(lines))


def as_xml(moved: Camera) -> str:
    """Returns the XML element ``transform`` that describes the camera ``moved`` in a Mitsuba scene."""
    rows = "\n            ".join(format_numbers(row) for row in moved.to_world)
    return f'<transform name="to_world">\n    <matrix value="{rows}"/>\n</transform>'


def format_numbers(values: np.ndarray | tuple[float, ...], size: float = 0.0) -> str:
    """Returns the numbers ``values`` as text with seven significant digits, about the precision of 32-bit numbers.

    A number whose absolute value is below 1e-7 times ``size`` is written as 0.
    """
    return " ".join(format(0.0 if abs(v) < 1e-7 * size else float(v) + 0.0, ".7g") for v in values)
