"""The primitives of the language, each in its own space.

CUBE is [0, 1]^3; SPHERE the unit ball; CYLINDER x^2 + y^2 <= 1, 0 <= z <= 1; CONE x^2 + y^2 <= z^2, 0 <= z <= 1, with
its apex at the origin.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from manifold3d import Manifold

from ..view import Camera

MIN_SEGMENTS, MAX_SEGMENTS = 16, 512  # around a circle
#: The tolerance of a solid outside the window is larger by this factor, and it has at most this number of segments; a
#: mirror or a shadow may still show it.
OUTSIDE_TOLERANCE, OUTSIDE_SEGMENTS = 10.0, 128
#: The largest aspect ratio of an ellipsoid that increases its segments. A longer one is too coarse near its ends only;
#: with more triangles, manifold3d takes minutes for two of them.
MAX_ASPECT = 16.0
ON_AXIS = 1e-6  # distance from the axis or the apex below which the azimuth of a corner is undefined


@dataclass(frozen=True)
class Mesh:
    """A closed mesh: ``vertices`` (n, 3), ``triangles`` (m, 3) with one orientation, the plane facet ``facets`` (m,) of
    each triangle, and the face ``faces`` (k,) of each facet.

    A flat face is one facet; many facets approximate a curved one.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    facets: np.ndarray
    faces: np.ndarray


@dataclass(frozen=True)
class CornerAttributes:
    """Normals and uv at the corners of n triangles on a primitive.

    ``normals`` (n, 3, 3) point outwards and have any length, ``uv`` is (n, 3, 2), and ``unshared`` (n, 3) is true where
    triangles may not share the corner.
    """

    normals: np.ndarray
    uv: np.ndarray
    unshared: np.ndarray


class Primitive(ABC):
    """A solid. If it has a curved face, it is convex, and planes and one quadric bound it."""

    #: Its name in the language; for a mesh file a digest of the content.
    name: str
    #: The surfaces of its faces as quadrics p^T Q p = 0, p = (x, y, z, 1), by the number of the face. Empty if no face
    #: can coincide with another solid's face.
    quadrics: ClassVar[np.ndarray]
    #: Its bounding box, min and max corner.
    box: np.ndarray
    #: The curved face, if it has one.
    curved: ClassVar[int | None] = None
    #: The number of axes in which it is round: 2 about z, 3 about the origin.
    axes: ClassVar[int] = 2
    #: Whether its quadric has a second sheet, at z < 0.
    two_sheets: ClassVar[bool] = False
    #: Lines (k, 2, 3) on the curved face: each of its points is within ``gap`` times its longest semi-axis of a line.
    lines: ClassVar[np.ndarray]
    gap: ClassVar[float] = 0.08
    #: The number of segments for a chord error, relative to that of a circle.
    segment_factor: ClassVar[float] = 1.0

    @abstractmethod
    def mesh(self, segments: int, facet_map: np.ndarray) -> Mesh:
        """The solid with ``segments`` around a circle; the vertices of a curved face lie on the quadric.

        ``facet_map`` (4, 4) maps the quadric to itself, or another primitive's equal quadric to this one. It moves the
        facets of the curved face, in the same order. For a sphere it may be a projective map.
        """

    @abstractmethod
    def count(self, segments: int) -> int:
        """The number of triangles of :meth:`mesh`, for MIN_SEGMENTS at least."""

    @abstractmethod
    def corner_attributes(self, p: np.ndarray, face: np.ndarray) -> CornerAttributes:
        """Normals and surface parameters of triangles (n, 3, 3) on its faces with the numbers ``face`` (n,)."""

    @cached_property
    def box_corners(self) -> np.ndarray:
        """The corners (8, 3) of its bounding box."""
        return box_corners(self.box)

    def ball(self, linear: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Size of its curved face, centre and radius of a bounding ball, under linear maps (..., 3, 3)."""
        corners = self.box_corners @ np.swapaxes(linear, -1, -2)
        center = corners.mean(axis=-2)
        radius = np.linalg.norm(corners - center[..., None, :], axis=-1).max(axis=-1)
        return radius, center, radius

    def segments(self, to_world: np.ndarray, camera: Camera, tolerance: float) -> list[int]:
        """Segments around a circle for each transform (n, 4, 4), with a chord error below ``tolerance`` pixels."""
        if self.curved is None:
            return [4] * len(to_world)
        linear, offset = to_world[:, :3, :3], to_world[:, :3, 3]
        size, center, radius = self.ball(linear)
        visible = camera.may_see(self.box_corners @ linear.transpose(0, 2, 1) + offset[:, None])
        distance = np.linalg.norm(center + offset - camera.eye, axis=1) - radius
        for i in np.flatnonzero(distance < radius).tolist():
            # The eye is near the bounding ball, but maybe not near the surface.
            a, b = (self.lines[:, end] @ linear[i].T + offset[i] for end in range(2))
            distance[i] = max(distance[i], distance_to_segments(a, b, camera.eye) - self.gap * size[i])
        error = np.where(visible, 1, OUTSIDE_TOLERANCE) * tolerance * camera.footprint(distance) / size
        max_segments = np.where(visible, MAX_SEGMENTS, OUTSIDE_SEGMENTS)
        return [self.segments_for(*of) for of in zip(error.tolist(), max_segments.tolist())]

    def segments_for(self, error: float, max_segments: int = MAX_SEGMENTS) -> int:
        """Segments around a circle for a chord error relative to the radius of the curved face, at most
        ``max_segments``.
        """
        n = math.pi / math.acos(1 - min(error, 0.5)) if error > 1e-9 else max_segments
        n = min(max(n * self.segment_factor, MIN_SEGMENTS), max_segments)
        return 4 * math.ceil(n / 4)


def box_corners(box: np.ndarray) -> np.ndarray:
    """The corners (8, 3) of a box (2, 3), its min and max corner."""
    return np.array([[box[i][0], box[j][1], box[k][2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)], float)


def longest_axis(linear: np.ndarray) -> np.ndarray:
    """The longest semi-axis of the unit ball's image under linear maps (..., m, n)."""
    return np.asarray(np.linalg.svd(linear, compute_uv=False)[..., 0])


def distance_to_segments(a: np.ndarray, b: np.ndarray, point: np.ndarray) -> float:
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
    """Azimuth of the corners in [0, 1], or up to 2 in triangles across the seam, and which corners are on the axis.

    The azimuth of a corner on the axis is the mean of the others.
    """
    pole = np.hypot(p[..., 0], p[..., 1]) < ON_AXIS
    u = np.arctan2(p[..., 1], p[..., 0]) / (2 * math.pi) % 1.0
    width = np.where(pole, -np.inf, u).max(axis=1) - np.where(pole, np.inf, u).min(axis=1)
    u = np.where((width > 0.5)[:, None] & (u < 0.5), u + 1, u)
    mean_of_others = np.where(pole, 0, u).sum(axis=1) / np.maximum((~pole).sum(axis=1), 1)
    return np.where(pole, mean_of_others[:, None], u), pole


class Cube(Primitive):
    """Face 0, 1 or 2 is the side x = 0, y = 0 or z = 0; face 3, 4 or 5 is x = 1, y = 1 or z = 1."""

    name = "cube"
    quadrics = np.array([plane(*n, d) for d in (0, -1) for n in np.eye(3)])
    box = np.array([[0.0, 0, 0], [1, 1, 1]])
    #: Each face's corners, counter-clockwise from outside; corner 4 x + 2 y + z is (x, y, z).
    squares: ClassVar[list[tuple[int, int, int, int]]] = [
        (0, 1, 3, 2),
        (0, 4, 5, 1),
        (0, 2, 6, 4),
        (4, 6, 7, 5),
        (2, 3, 7, 6),
        (1, 5, 7, 3),
    ]

    def mesh(self, segments: int, facet_map: np.ndarray) -> Mesh:
        triangles = np.array([t for a, b, c, d in self.squares for t in ((a, b, c), (a, c, d))])
        return Mesh(box_corners(self.box), triangles, np.repeat(np.arange(6), 2), np.arange(6))

    def count(self, segments: int) -> int:
        return 12

    def corner_attributes(self, p: np.ndarray, face: np.ndarray) -> CornerAttributes:
        normals = np.zeros_like(p)
        axis = face % 3
        normals[np.arange(len(p)), :, axis] = np.where(face < 3, -1, 1)[:, None]
        across = np.array([[1, 2], [0, 2], [0, 1]])[axis]  # (y, z), (x, z), (x, y)
        uv = np.take_along_axis(p, np.repeat(across[:, None], 3, axis=1), axis=2)
        return CornerAttributes(normals, uv, np.zeros(p.shape[:2], bool))


def _subdivided_octahedron(segments: int) -> tuple[np.ndarray, np.ndarray]:
    """The unit sphere as an octahedron whose faces are divided into equal triangles."""
    mesh = Manifold.sphere(1.0, segments).to_mesh64()
    vertices = np.array(mesh.vert_properties)[:, :3]
    return vertices / np.linalg.norm(vertices, axis=1, keepdims=True), np.array(mesh.tri_verts, dtype=np.int64)


class Sphere(Primitive):
    """Its one face is curved, and every triangle of its mesh is a facet."""

    name = "sphere"
    quadrics = np.diag([1.0, 1, 1, -1])[None]
    box = np.array([[-1.0, -1, -1], [1, 1, 1]])
    curved = 0
    axes = 3
    lines = np.repeat(_subdivided_octahedron(64)[0][:, None], 2, axis=1)  # points, less than 0.05 apart
    segment_factor = 1.64  # the largest triangles lie in the middles of the octahedron's faces

    def mesh(self, segments: int, facet_map: np.ndarray) -> Mesh:
        vertices, triangles = _subdivided_octahedron(segments)
        placed = vertices @ facet_map[:3, :3].T
        if facet_map[3, :3].any():  # a projective map
            placed = (placed + facet_map[:3, 3]) / (vertices @ facet_map[3, :3] + facet_map[3, 3])[:, None]
        return Mesh(placed, triangles, np.arange(len(triangles)), np.zeros(len(triangles), int))

    def count(self, segments: int) -> int:
        return max(segments, MIN_SEGMENTS) ** 2 // 2

    def ball(self, linear: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        longest, second = np.moveaxis(np.linalg.svd(linear, compute_uv=False)[..., :2], -1, 0)
        return np.minimum(longest, MAX_ASPECT * second), np.zeros(linear.shape[:-1]), longest

    def corner_attributes(self, p: np.ndarray, face: np.ndarray) -> CornerAttributes:
        radius = np.linalg.norm(p, axis=2)
        u, pole = azimuth(p)
        v = np.arccos(np.clip(p[..., 2] / radius, -1, 1)) / math.pi
        return CornerAttributes(p, np.stack([u, v], axis=2), pole)


class _OfRevolution(Primitive):
    """A solid of revolution about z, of radius 1. Face 0 is its side, 1 the disc at z = 1, 2 the disc at z = 0."""

    box = np.array([[-1.0, -1, 0], [1, 1, 1]])
    curved = 0

    def ball(self, linear: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        size = longest_axis(linear[..., :2])
        center = linear[..., 2] / 2
        return size, center, np.linalg.norm(center, axis=-1) + size

    def corner_attributes(self, p: np.ndarray, face: np.ndarray) -> CornerAttributes:
        """On the side uv = (azimuth, z), on a disc (x, y) in the unit square."""
        u, pole = azimuth(p)
        normals, uv = p * np.diag(self.quadrics[0])[:3], np.stack([u, p[..., 2]], axis=2)
        flat = face > 0
        normals[flat] = np.where(face[flat] == 1, 1, -1)[:, None, None] * [0, 0, 1]
        uv[flat] = p[flat][..., :2] / 2 + 0.5
        return CornerAttributes(normals, uv, pole & ~flat[:, None])


def fan(segments: int) -> np.ndarray:
    """The triangles of a disc with ``segments`` corners, counter-clockwise from above."""
    i = np.arange(1, segments - 1)
    return np.stack([np.zeros_like(i), i, i + 1], axis=1)


class Cylinder(_OfRevolution):
    """A cylinder with two discs."""

    name = "cylinder"
    quadrics = np.array([np.diag([1.0, 1, 0, -1]), plane(0, 0, 1, -1), plane(0, 0, 1, 0)])
    lines = np.stack([np.append(circle(64), np.full((64, 1), z), axis=1) for z in (0, 1)], axis=1)

    def mesh(self, segments: int, facet_map: np.ndarray) -> Mesh:
        around = circle(segments) @ facet_map[:2, :2].T  # the quadric's generators are parallel to z in either space
        ring = np.append(around / np.linalg.norm(around, axis=1, keepdims=True), np.ones((segments, 1)), axis=1)
        upper, disc = np.arange(segments), fan(segments)
        following, lower = (upper + 1) % segments, upper + segments
        sides = [upper, lower, following], [following, lower, following + segments]
        triangles = [disc, disc[:, ::-1] + segments, *(np.stack(side, axis=1) for side in sides)]
        facets = np.concatenate([np.repeat([0, 1], segments - 2), upper + 2, upper + 2])
        faces = np.append([1, 2], np.zeros(segments, int))
        return Mesh(np.concatenate([ring, ring * [1, 1, 0]]), np.concatenate(triangles), facets, faces)

    def count(self, segments: int) -> int:
        return 4 * max(segments, MIN_SEGMENTS) - 4


class Cone(_OfRevolution):
    """A cone with its apex at the origin, and one disc."""

    name = "cone"
    quadrics = np.array([np.diag([1.0, 1, -1, 0]), plane(0, 0, 1, -1)])
    two_sheets = True
    lines = np.stack([np.append(circle(64), np.ones((64, 1)), axis=1) * z for z in (0, 1)], axis=1)

    def mesh(self, segments: int, facet_map: np.ndarray) -> Mesh:
        generators = np.append(circle(segments), np.ones((segments, 1)), axis=1) @ facet_map[:3, :3].T
        ring = np.append(generators[:, :2] / generators[:, 2:], np.ones((segments, 1)), axis=1)
        i = np.arange(segments)
        side = np.stack([i, np.full(segments, segments), (i + 1) % segments], axis=1)
        facets = np.concatenate([np.zeros(segments - 2, int), i + 1])
        faces = np.append([1], np.zeros(segments, int))
        return Mesh(np.append(ring, np.zeros((1, 3)), axis=0), np.append(fan(segments), side, axis=0), facets, faces)

    def count(self, segments: int) -> int:
        return 2 * max(segments, MIN_SEGMENTS) - 2

    def corner_attributes(self, p: np.ndarray, face: np.ndarray) -> CornerAttributes:
        side = super().corner_attributes(p, face)
        apex = (np.linalg.norm(p, axis=2) < ON_AXIS) & (face == 0)[:, None]
        tips = apex.any(axis=1)
        # The apex has no normal: a triangle takes that of the generator through the middle of its other corners.
        middle = np.where(apex[..., None], 0, p)[tips].sum(axis=1) * [1, 1, 0]
        middle /= np.maximum(np.linalg.norm(middle, axis=1, keepdims=True), 1e-300)
        middle[:, 2] = -1
        side.normals[tips] = np.where(apex[tips][..., None], middle[:, None], side.normals[tips])
        return CornerAttributes(side.normals, side.uv, side.unshared | apex)


#: Primitives by name, the :attr:`prosim_scene.model.Leaf.shape`.
PRIMITIVES: dict[str, Primitive] = {primitive.name: primitive for primitive in (Cube(), Sphere(), Cylinder(), Cone())}
