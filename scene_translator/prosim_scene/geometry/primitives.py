"""The primitives of the language: what each says about itself, in its own space.

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

from ..camera import Camera

MIN_SEGMENTS, MAX_SEGMENTS = 16, 512  # around a circle
#: A solid outside the window may be visible in a mirror, or by its shadow: its tolerance is larger by this factor, and
#: its segments are at most these.
UNSEEN_TOLERANCE, UNSEEN_SEGMENTS = 10.0, 128
#: A ball that is longer than wide by more than this is as fine as if it were not: that is too coarse near its ends
#: alone, and manifold3d takes minutes for two such balls with many triangles.
NEEDLE = 16.0
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
    """A solid. If it has a curved face, it is convex, and planes and one quadric bound it."""

    #: The name that the language gives it; of a mesh's file, what tells its content from any other's.
    name: str
    #: The surfaces of its faces as quadrics p^T Q p = 0, p = (x, y, z, 1), by the number of the face; none, and face 0
    #: for all triangles, where no face is meant to coincide with another solid's.
    quadrics: ClassVar[np.ndarray]
    #: Its bounding box, min and max corner.
    box: np.ndarray
    #: The curved face, if it has one.
    curved: ClassVar[int | None] = None
    #: The number of axes in which it is round: 2 about z, 3 about the origin.
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
        """Under linear maps (..., 3, 3): the size of its curved face, centre and radius of a ball around it."""
        raise NotImplementedError(f"a {self.name} with a curved face says how large that is")

    def segments(self, to_world: np.ndarray, camera: Camera, tolerance: float) -> list[int]:
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
    """The corners (8, 3) of a box (2, 3), its min and max corner."""
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


class Cube(Primitive):
    """Faces 0 to 2 are those at 0 of the x, y and z axes, 3 to 5 those at 1."""

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

    def mesh(self, segments: int, frame: np.ndarray) -> Mesh:
        triangles = np.array([t for a, b, c, d in self.squares for t in ((a, b, c), (a, c, d))])
        return Mesh(box_corners(self.box), triangles, np.repeat(np.arange(6), 2), np.arange(6))

    def count(self, segments: int) -> int:
        return 12

    def corners(self, p: np.ndarray, face: np.ndarray) -> Corners:
        normals = np.zeros_like(p)
        axis = face % 3
        normals[np.arange(len(p)), :, axis] = np.where(face < 3, -1, 1)[:, None]
        across = np.array([[1, 2], [0, 2], [0, 1]])[axis]  # (y, z), (x, z), (x, y)
        uv = np.take_along_axis(p, np.repeat(across[:, None], 3, axis=1), axis=2)
        return Corners(normals, uv, np.zeros(p.shape[:2], bool))


def _octahedral(segments: int) -> tuple[np.ndarray, np.ndarray]:
    """An octahedron, each face of which is divided into equal triangles, with its vertices on the unit sphere."""
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
    lines = np.repeat(_octahedral(64)[0][:, None], 2, axis=1)  # points, less than 0.05 apart
    segment_factor = 1.64  # the largest triangles lie in the middles of the octahedron's faces

    def mesh(self, segments: int, frame: np.ndarray) -> Mesh:
        vertices, triangles = _octahedral(segments)
        placed = vertices @ frame[:3, :3].T
        if frame[3, :3].any():  # a projective map
            placed = (placed + frame[:3, 3]) / (vertices @ frame[3, :3] + frame[3, 3])[:, None]
        return Mesh(placed, triangles, np.arange(len(triangles)), np.zeros(len(triangles), int))

    def count(self, segments: int) -> int:
        return max(segments, MIN_SEGMENTS) ** 2 // 2

    def ball(self, linear: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        longest, second = np.moveaxis(np.linalg.svd(linear, compute_uv=False)[..., :2], -1, 0)
        return np.minimum(longest, NEEDLE * second), np.zeros(linear.shape[:-1]), longest

    def corners(self, p: np.ndarray, face: np.ndarray) -> Corners:
        radius = np.linalg.norm(p, axis=2)
        u, pole = azimuth(p)
        v = np.arccos(np.clip(p[..., 2] / radius, -1, 1)) / math.pi
        return Corners(p, np.stack([u, v], axis=2), pole)


class _OfRevolution(Primitive):
    """A solid of revolution about z, of radius 1; face 0 is its side."""

    box = np.array([[-1.0, -1, 0], [1, 1, 1]])
    curved = 0

    def ball(self, linear: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        size = longest_axis(linear[..., :2])
        center = linear[..., 2] / 2
        return size, center, np.linalg.norm(center, axis=-1) + size


class Cylinder(_OfRevolution):
    """Face 0 is the side, 1 the disc at z = 1, 2 that at z = 0."""

    name = "cylinder"
    quadrics = np.array([np.diag([1.0, 1, 0, -1]), plane(0, 0, 1, -1), plane(0, 0, 1, 0)])
    lines = np.stack([np.append(circle(64), np.full((64, 1), z), axis=1) for z in (0, 1)], axis=1)

    def mesh(self, segments: int, frame: np.ndarray) -> Mesh:
        i = np.arange(segments)
        around = circle(segments) @ frame[:2, :2].T  # the quadric's generators are parallel to z in either space
        ring = np.append(around / np.linalg.norm(around, axis=1, keepdims=True), np.ones((segments, 1)), axis=1)
        following = (i + 1) % segments
        fan = np.stack([np.zeros(segments - 2, int), i[1:-1], i[2:]], axis=1)  # counter-clockwise seen from above
        low = segments  # ring at z = 1, then at z = 0
        triangles = np.concatenate(
            [
                fan,
                fan[:, ::-1] + low,
                np.stack([i, i + low, following], axis=1),
                np.stack([following, i + low, following + low], axis=1),
            ]
        )
        facets = np.concatenate([np.repeat([0, 1], segments - 2), i + 2, i + 2])
        return Mesh(
            np.concatenate([ring, ring * [1, 1, 0]]), triangles, facets, np.append([1, 2], np.zeros(segments, int))
        )

    def count(self, segments: int) -> int:
        return 4 * max(segments, MIN_SEGMENTS) - 4

    def corners(self, p: np.ndarray, face: np.ndarray) -> Corners:
        return around_an_axis(p, face, p * [1, 1, 0], {1: 1, 2: -1})


class Cone(_OfRevolution):
    """Face 0 is the side, 1 the disc at z = 1."""

    name = "cone"
    quadrics = np.array([np.diag([1.0, 1, -1, 0]), plane(0, 0, 1, -1)])
    two_sheets = True
    lines = np.stack([np.append(circle(64), np.ones((64, 1)), axis=1) * z for z in (0, 1)], axis=1)

    def mesh(self, segments: int, frame: np.ndarray) -> Mesh:
        i = np.arange(segments)
        generators = np.append(circle(segments), np.ones((segments, 1)), axis=1) @ frame[:3, :3].T
        ring = np.append(generators[:, :2] / generators[:, 2:], np.ones((segments, 1)), axis=1)
        fan = np.stack([np.zeros(segments - 2, int), i[1:-1], i[2:]], axis=1)  # counter-clockwise seen from above
        triangles = np.concatenate([fan, np.stack([i, np.full(segments, segments), (i + 1) % segments], axis=1)])
        facets = np.concatenate([np.zeros(segments - 2, int), i + 1])
        return Mesh(
            np.append(ring, np.zeros((1, 3)), axis=0), triangles, facets, np.append([1], np.zeros(segments, int))
        )

    def count(self, segments: int) -> int:
        return 2 * max(segments, MIN_SEGMENTS) - 2

    def corners(self, p: np.ndarray, face: np.ndarray) -> Corners:
        side = around_an_axis(p, face, p * [1, 1, -1], {1: 1})
        apex = (np.linalg.norm(p, axis=2) < ON_AXIS) & (face == 0)[:, None]
        tips = apex.any(axis=1)
        # The apex has no normal: each triangle takes that of the generator through the middle of its other corners.
        middle = np.where(apex[..., None], 0, p)[tips].sum(axis=1) * [1, 1, 0]
        middle /= np.maximum(np.linalg.norm(middle, axis=1, keepdims=True), 1e-300)
        middle[:, 2] = -1
        side.normals[tips] = np.where(apex[tips][..., None], middle[:, None], side.normals[tips])
        return Corners(side.normals, side.uv, side.alone | apex)


#: Every primitive by its name, which is that of :attr:`prosim_scene.model.Leaf.shape`.
PRIMITIVES: dict[str, Primitive] = {primitive.name: primitive for primitive in (Cube(), Sphere(), Cylinder(), Cone())}
