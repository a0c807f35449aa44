"""What every primitive says about itself, in its own space."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from ..sight import Sight

MIN_SEGMENTS, MAX_SEGMENTS = 16, 1024  # around a circle
#: What lies outside the window may be seen in a mirror, or by its shadow: it is coarser by this factor, and no finer
#: than so many segments.
UNSEEN_TOLERANCE, UNSEEN_SEGMENTS = 10.0, 128
ON_AXIS = 1e-6  # distance from an axis or an apex within which a corner has no azimuth of its own


@dataclass(frozen=True)
class Mesh:
    """A closed mesh: ``vertices`` (n, 3), ``triangles`` (m, 3) all wound to the same side, ``facets`` (m,), the number
    of the plane facet that each triangle is part of, and ``faces`` (k,), the number of the face that each facet is part
    of.

    A flat face is one facet; a curved one is approximated by as many as it takes.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    facets: np.ndarray
    faces: np.ndarray


@dataclass(frozen=True)
class Corners:
    """What a primitive says of the corners of n triangles on its surface.

    ``normals`` (n, 3, 3) point outwards and have any length, ``uv`` is (n, 3, 2), and ``alone`` (n, 3) is true where a
    corner may not be shared with another triangle.
    """

    normals: np.ndarray
    uv: np.ndarray
    alone: np.ndarray


class Primitive(ABC):
    """A convex solid that planes and at most one quadric bound."""

    #: The name that the language gives it.
    name: ClassVar[str]
    #: The surfaces of its faces as quadrics p^T Q p = 0, p = (x, y, z, 1), by the number of the face.
    quadrics: ClassVar[np.ndarray]
    #: Its bounding box, min and max corner.
    box: ClassVar[np.ndarray]
    #: The curved face, if it has one.
    curved: ClassVar[int | None] = None
    #: It is round in so many of the axes: 2 about z, 3 about the origin.
    axes: ClassVar[int] = 2
    #: Whether its quadric has a second sheet, at z < 0.
    two_sheets: ClassVar[bool] = False
    #: Lines (k, 2, 3) on the curved face: no point of it is farther from them than ``gap`` times its longest semi-axis.
    lines: ClassVar[np.ndarray]
    gap: ClassVar[float] = 0.08
    #: So many times the segments of a circle give the same chord error.
    segment_factor: ClassVar[float] = 1.0

    @abstractmethod
    def mesh(self, segments: int, frame: np.ndarray) -> Mesh:
        """The solid with ``segments`` around a circle; the vertices of a curved face lie on the quadric.

        ``frame`` (4, 4) is a map that takes the quadric to itself, or another primitive's of the same quadric to this
        one: the facets of the curved face are the images of those that the identity gives, in the same order. Of a
        sphere it may be a projective map.
        """

    @abstractmethod
    def count(self, segments: int) -> int:
        """How many triangles :meth:`mesh` gives; MIN_SEGMENTS at least are counted."""

    @abstractmethod
    def corners(self, p: np.ndarray, face: np.ndarray) -> Corners:
        """Normals and surface parameters of triangles (n, 3, 3) on its faces with the numbers ``face`` (n,)."""

    @cached_property
    def box_corners(self) -> np.ndarray:
        """The corners (8, 3) of its bounding box."""
        return box_corners(self.box)

    def ball(self, linear: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Under linear maps (..., 3, 3): its curved face's longest semi-axis, centre and radius of a ball around it."""
        raise NotImplementedError(f"a {self.name} with a curved face says how large that is")

    def segments(self, to_world: np.ndarray, camera: Sight, tolerance: float) -> list[int]:
        """Segments around a circle at each of the places (n, 4, 4), so that the chord error stays below ``tolerance``
        pixels in the image.
        """
        if self.curved is None:
            return [4] * len(to_world)
        linear, offset = to_world[:, :3, :3], to_world[:, :3, 3]
        size, center, radius = self.ball(linear)
        seen = camera.may_see(self.box_corners @ linear.transpose(0, 2, 1) + offset[:, None])
        distance = np.linalg.norm(center + offset - camera.eye, axis=1) - radius
        for i in np.flatnonzero(distance < radius).tolist():
            # The eye is near the ball around the solid, but maybe not near its surface.
            a, b = (self.lines[:, end] @ linear[i].T + offset[i] for end in range(2))
            distance[i] = max(distance[i], to_segments(a, b, camera.eye) - self.gap * size[i])
        error = np.where(seen, 1, UNSEEN_TOLERANCE) * tolerance * camera.footprint(distance) / size
        most = np.where(seen, MAX_SEGMENTS, UNSEEN_SEGMENTS)
        return [self.segments_for(*of) for of in zip(error.tolist(), most.tolist())]

    def segments_for(self, error: float, most: int = MAX_SEGMENTS) -> int:
        """Segments around a circle for a chord error, a share of the curved face's radius; ``most`` of them at most."""
        n = math.pi / math.acos(1 - min(error, 0.5)) if error > 1e-9 else most
        n = min(max(n * self.segment_factor, MIN_SEGMENTS), most)
        return 4 * math.ceil(n / 4)


def box_corners(box: np.ndarray) -> np.ndarray:
    """The eight corners of a box that is given by its min and max corner."""
    return np.array([[box[i][0], box[j][1], box[k][2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)], float)


def longest_axis(linear: np.ndarray) -> np.ndarray:
    """The longest semi-axis of the unit ball's image under linear maps (..., m, n)."""
    return np.asarray(np.linalg.svd(linear, compute_uv=False)[..., 0])


def to_segments(a: np.ndarray, b: np.ndarray, point: np.ndarray) -> float:
    """Distance from a point to the nearest of the line segments from a (n, 3) to b (n, 3)."""
    along, length = b - a, np.maximum(np.sum((b - a) ** 2, axis=1), 1e-300)
    t = np.clip(np.sum((point - a) * along, axis=1) / length, 0, 1)
    return float(np.sqrt(np.min(np.sum((a + t[:, None] * along - point) ** 2, axis=1))))


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
    pole = np.hypot(p[..., 0], p[..., 1]) < ON_AXIS
    u = np.arctan2(p[..., 1], p[..., 0]) / (2 * math.pi) % 1.0
    spread = np.where(pole, -np.inf, u).max(axis=1) - np.where(pole, np.inf, u).min(axis=1)
    u = np.where((spread > 0.5)[:, None] & (u < 0.5), u + 1, u)
    others = np.where(pole, 0, u).sum(axis=1) / np.maximum((~pole).sum(axis=1), 1)
    return np.where(pole, others[:, None], u), pole


def around_an_axis(p: np.ndarray, face: np.ndarray, gradient: np.ndarray, discs: dict[int, int]) -> Corners:
    """Corners of a solid of revolution: its side, face 0, has ``gradient`` and (azimuth, z), its discs {face: side}
    have (x, y) in the unit square.
    """
    normals = gradient.copy()
    u, pole = azimuth(p)
    uv = np.stack([u, p[..., 2]], axis=2)
    for number, side in discs.items():
        normals[face == number] = [0, 0, side]
    flat = face > 0
    uv[flat] = p[flat][..., :2] / 2 + 0.5
    return Corners(normals, uv, pole & ~flat[:, None])
