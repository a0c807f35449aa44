"""What every primitive has to say about itself, in its own space."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

MIN_SEGMENTS, MAX_SEGMENTS = 16, 1024  # around a circle
ON_FACE = 1e-6  # distance in a primitive's own space within which a vertex lies on a flat face


@dataclass
class Corners:
    """What a primitive says of the corners of n triangles on its surface.

    ``normals`` (n, 3, 3) point outwards and have any length, ``uv`` is (n, 3, 2), ``face`` (n,) numbers the primitive's
    faces, and ``alone`` (n, 3) is true where a corner may not be shared with another triangle.
    """

    normals: np.ndarray
    uv: np.ndarray
    face: np.ndarray
    alone: np.ndarray


class Primitive(ABC):
    """A convex solid that planes and quadrics bound."""

    #: The name that the language gives it.
    name: str
    #: The surfaces of its faces as quadrics p^T Q p = 0, p = (x, y, z, 1), by the number of the face.
    quadrics: list[np.ndarray]
    #: Its bounding box, min and max corner.
    box: tuple[tuple[float, float, float], tuple[float, float, float]]
    #: A circle's segments are multiplied by this for the same chord error.
    segment_factor = 1.0

    @abstractmethod
    def mesh(self, segments: int) -> tuple[np.ndarray, np.ndarray]:
        """Vertices (n, 3) and outward triangles (m, 3); the vertices of curved faces lie on the quadric."""

    @abstractmethod
    def round_part(self, linear: np.ndarray) -> tuple[float, np.ndarray, float]:
        """Longest semi-axis of the curved faces under a linear map, and a ball (centre, radius) around the primitive."""

    @abstractmethod
    def inside(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Which points it contains."""

    @abstractmethod
    def corners(self, p: np.ndarray) -> Corners:
        """Normals and surface parameters of triangles (n, 3, 3) on its surface."""

    def flat_face(self, face: int, segments: int) -> tuple[int, int, list[int], np.ndarray] | None:
        """Of a flat face: its axis, the side (1 or -1) it looks to, the other two axes, its outline on them; else None."""
        return None

    def on_surface(self, p: np.ndarray, face: np.ndarray) -> np.ndarray:
        """Points (n, 3) within the chords of curved faces, brought onto the surface."""
        return p

    def segments(self, to_world: np.ndarray, camera, tolerance: float) -> int:
        """Segments around a circle, so that the chord error stays below ``tolerance`` pixels in the image."""
        size, center, radius = self.round_part(to_world[:3, :3])
        error = tolerance * camera.footprint(center + to_world[:3, 3], radius) / size
        n = math.pi / math.acos(1 - min(error, 0.5)) if error > 1e-9 else MAX_SEGMENTS
        n = min(max(n * self.segment_factor, MIN_SEGMENTS), MAX_SEGMENTS)
        return 4 * math.ceil(n / 4)


def plane(*nd: float) -> np.ndarray:
    """The plane n.p + d = 0 as a quadric."""
    return np.outer(nd, nd).astype(float)


def circle(segments: int) -> np.ndarray:
    """Corners (segments, 2) of a regular polygon in the unit circle."""
    angle = 2 * math.pi * np.arange(segments) / segments
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def azimuth(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Azimuth of the corners in [0, 1], or up to 2 in triangles across the seam, and which corners lie on the axis.

    A corner on the axis has no azimuth of its own and takes the mean of the others.
    """
    pole = np.hypot(p[..., 0], p[..., 1]) < ON_FACE
    u = np.arctan2(p[..., 1], p[..., 0]) / (2 * math.pi) % 1.0
    spread = np.where(pole, -np.inf, u).max(axis=1) - np.where(pole, np.inf, u).min(axis=1)
    u = np.where((spread > 0.5)[:, None] & (u < 0.5), u + 1, u)
    others = np.where(pole, 0, u).sum(axis=1) / np.maximum((~pole).sum(axis=1), 1)
    return np.where(pole, others[:, None], u), pole


def around_an_axis(p: np.ndarray, caps: dict[int, float], normals: np.ndarray) -> Corners:
    """Corners of a solid of revolution: its side, face 0, with (azimuth, z), and discs {face: z} with (x, y) in the unit
    square. ``normals`` are those of the side."""
    u, pole = azimuth(p)
    uv = np.stack([u, p[..., 2]], axis=2)
    face = np.zeros(len(p), int)
    for code, z in caps.items():
        flat = np.all(np.abs(p[..., 2] - z) < ON_FACE, axis=1)
        face[flat] = code
        normals[flat] = [0, 0, 1 if z else -1]
        uv[flat] = p[flat][..., :2] / 2 + 0.5
    return Corners(normals, uv, face, pole & (face == 0)[:, None])
