"""A camera that moves, and its text for a scene."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from prosim_scene import View

#: The largest factor by which the distance to the pivot differs from the scene's own view: single precision allows no
#: more.
FARTHEST = 1e5

#: The steepest direction up or down, in degrees: beyond, up and down would change places.
STEEPEST = 89.0


@dataclass(frozen=True, eq=False)
class Camera:
    """A view in the world: ``to_world``, a 4x4 matrix without scaling, by which Mitsuba's cameras look along +z with +x
    to the left of the image; ``distance`` from the eye to the pivot, along the viewing direction; ``up``, the
    unit axis that it turns about; ``across``, what it sees at distance 1, (width, height); and ``home``, the distance
    of the scene's own view, None for this one.
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
        """The point that it rotates about."""
        return np.asarray(self.eye + self.distance * self.to_world[:3, 2])

    def orbited(self, right: float, up: float) -> Camera:
        """The camera after a rotation about the pivot, by degrees to the right and up."""
        level = np.degrees(np.arcsin(np.clip(-self.to_world[:3, 2] @ self.up, -1, 1)))
        # Where it is steeper already it may stay so, but gets no steeper.
        low, high = min(-STEEPEST, level), max(STEEPEST, level)
        up = float(np.clip(level + up, low, high) - level)
        turn = rotation(self.up, right) @ rotation(self.to_world[:3, 0], up)
        moved = np.eye(4)
        moved[:3, :3] = turn
        moved[:3, 3] = self.pivot - turn @ self.pivot
        return replace(self, to_world=moved @ self.to_world)

    def panned(self, right: float, up: float) -> Camera:
        """The camera after a translation by fractions of the image's width and height at the pivot."""
        width, height = self.across
        moved = self.to_world.copy()
        moved[:3, 3] += self.distance * (right * width * moved[:3, 0] - up * height * moved[:3, 1])
        return replace(self, to_world=moved)

    def dollied(self, factor: float) -> Camera:
        """The camera with another distance from the pivot, by a factor within :data:`FARTHEST`."""
        home = self.home or self.distance
        distance = min(max(factor * self.distance, home / FARTHEST), home * FARTHEST)
        moved = self.to_world.copy()
        moved[:3, 3] = self.pivot - distance * moved[:3, 2]
        return replace(self, to_world=moved, distance=distance, home=home)


def rotation(axis: np.ndarray, degrees: float) -> np.ndarray:
    """The 3x3 matrix of a rotation about a unit axis (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(degrees)
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)


def nearest_axis(direction: np.ndarray) -> np.ndarray:
    """The axis of the world, or its opposite, that a direction is nearest to."""
    k = int(np.argmax(np.abs(direction)))
    return np.asarray(np.sign(direction[k]) * np.eye(3)[k])


def as_view(view: View, home: Camera, moved: Camera) -> str:
    """The statement VIEW of ``moved``; ``view`` is that of ``home``."""
    size = float(np.abs([view.eye, view.vrp]).max())
    motion = moved.to_world @ np.linalg.inv(home.to_world)

    def vector(value: tuple[float, float, float], place: float) -> str:
        return numbers((motion @ [*value, place])[:3], size if place else 1.0)

    # Going nearer changes the eye alone: the plane stays where it was from the eye, and so does the window on it.
    lines = [
        "VIEW",
        "RESOLUTION {} {}".format(*view.resolution),
        f"WINDOW {numbers(view.window)}",
        f"OBS {vector(view.eye, 1)}",
        f"VPN {vector(view.vpn, 0) if any(view.vpn) else '0 0 0'}",
        f"VRP {vector(view.vrp, 1)}",
        f"VUP {vector(view.vup, 0)}",
    ]
    return "\n    ".join(lines)


def as_xml(moved: Camera) -> str:
    """The transform of ``moved`` in Mitsuba's XML."""
    rows = "\n            ".join(numbers(row) for row in moved.to_world)
    return f'<transform name="to_world">\n    <matrix value="{rows}"/>\n</transform>'


def numbers(values: np.ndarray | tuple[float, ...], size: float = 0.0) -> str:
    """Numbers in seven digits, the precision of 32 bits; those that are negligible relative to ``size`` are 0."""
    return " ".join(format(0.0 if abs(v) < 1e-7 * size else float(v) + 0.0, ".7g") for v in values)
