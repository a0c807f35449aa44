"""Defines the primitives of the scene language, each in its own coordinates, and makes their meshes.

CUBE is [0, 1]^3. SPHERE is the unit ball. CYLINDER is x^2 + y^2 <= 1, 0 <= z <= 1. CONE is x^2 + y^2 <= z^2, 0 <= z <=
1, with its apex at the origin. A CONE with a radius r is the part r <= z of this cone, which begins at z = 0 in the
coordinates of the scene's text. TORUS is a tube around the unit circle. PLANE is z <= 0.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import ClassVar

import numpy as np
from manifold3d import Manifold
from numpy.typing import ArrayLike

from ..view import Camera

MIN_SEGMENTS, MAX_SEGMENTS = 16, 512  # the limits for the number of segments around a circle
#: For a solid outside the window: the factor of the tolerance, and the largest number of segments. The solid is
#: tessellated more coarsely, but not omitted, because it may be visible in a mirror or cast a shadow.
OUTSIDE_TOLERANCE, OUTSIDE_SEGMENTS = 10.0, 128
#: The number of segments of an ellipsoid grows with its aspect ratio up to this value. The mesh of a longer ellipsoid
#: is too coarse, but only near its ends. With more triangles, manifold3d would take minutes for two such ellipsoids.
MAX_ASPECT = 16.0
ON_AXIS = 1e-6  # a corner that is nearer than this to the axis or the apex has no azimuth


@dataclass(frozen=True)
class Mesh:
    """A closed mesh with ``vertices`` (n, 3) and with ``triangles`` (m, 3), which are consistently oriented.

    A facet of a mesh is a flat polygon of one or more triangles; ``facets`` (m,) has the facet number of each triangle.
    ``faces`` (k,) has, for each of the k facets, the number of the primitive's face on which the facet lies. A flat
    face is one facet; many facets approximate a curved face.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    facets: np.ndarray
    faces: np.ndarray


@dataclass(frozen=True)
class CornerAttributes:
    """Outward ``normals`` (n, 3, 3) of any length and ``uv`` (n, 3, 2) at the corners of triangles; ``unshared`` (n, 3)
    where a vertex must not be shared with other triangles.
    """

    normals: np.ndarray
    uv: np.ndarray
    unshared: np.ndarray


class Primitive(ABC):
    """A primitive in its own coordinates. A primitive with a curved face is convex, and is bounded by planes and one
    quadric; a torus is neither.
    """

    #: The name of the primitive in the language; for a mesh file, a digest of the content.
    name: str
    #: The surface of each face as a quadric p^T Q p = 0, p = (x, y, z, 1). Empty if no face can coincide with a face of
    #: another solid.
    quadrics: np.ndarray
    #: The minimum and the maximum corner of the bounding box.
    box: np.ndarray
    #: Maps the coordinates of the primitive to those of the scene's text (4, 4).
    placement: np.ndarray = np.eye(4)
    #: The number of the curved face; None if all faces are flat.
    curved: ClassVar[int | None] = None
    #: The number of axes along which the curved face is scaled: 2 for the side of a cylinder or a cone, otherwise 3.
    axes: ClassVar[int] = 2
    #: The convex hull of the curved face is the sum of a disc across z and of a ball with these radii.
    hull: tuple[float, float] = (0, 1)
    #: Lines (k, 2, 3) on the curved face. The distance of each point of this face from the nearest line is at most
    #: ``gap`` times the longest semi-axis of the face.
    surface_lines: np.ndarray
    gap: ClassVar[float] = 0.08
    #: The number of segments that a chord error requires, relative to the number for a circle.
    segment_factor: float = 1.0

    @abstractmethod
    def mesh(self, segments: int, facet_map: np.ndarray) -> Mesh:
        """Returns a mesh that approximates a full circle by ``segments`` line segments; the vertices of a curved face
        lie on the face's quadric.

        The matrix ``facet_map`` (4, 4) maps the quadric of the curved face to itself, or another primitive's coincident
        quadric to the quadric of this primitive. ``facet_map`` moves the facets of the curved face, and keeps the order
        of these facets. For a sphere, ``facet_map`` may be projective.
        """

    @abstractmethod
    def corner_attributes(self, p: np.ndarray, face: np.ndarray) -> CornerAttributes:
        """Returns the normals and uv at the corners ``p`` (n, 3, 3) of n triangles, which lie on the faces with the
        numbers ``face`` (n,); all coordinates are those of the primitive.
        """

    def implicit(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns values (...) and gradients (..., 3) of a function that is 0 on the curved face."""
        form = np.diag(self.quadrics[self.curved])
        return p**2 @ form[:3] + form[3], 2 * p * form[:3]

    def scaled(self, vertices: np.ndarray, scale: float) -> np.ndarray:
        """Returns the vertices of a mesh (n, 3), whose curved face becomes smaller by ``scale``."""
        return vertices * np.where(np.arange(3) < self.axes, scale, 1.0)

    @cached_property
    def box_corners(self) -> np.ndarray:
        """The corners (8, 3) of the primitive's bounding box."""
        return box_corners(self.box)

    def ball(self, to_world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns, for each of n transforms (n, 4, 4), the size of the transformed curved face (n,), and a bounding
        ball of the transformed primitive.

        The size is about the longest semi-axis of the curved face; for a primitive without a curved face, the size is
        the radius of the ball. The bounding balls are an array (n, 4); each row has the centre and the radius of a
        ball, in world coordinates.
        """
        corners = self.box_corners @ to_world[:, :3, :3].transpose(0, 2, 1) + to_world[:, None, :3, 3]
        center = corners.mean(axis=1)
        radius = np.linalg.norm(corners - center[:, None], axis=2).max(axis=1)
        return radius, np.append(center, radius[:, None], axis=1)

    def pixel(self, to_world: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        """Returns the width of a pixel at the nearest point, relative to the curved face, and whether the primitive may
        be in the window; for each transform (n, 4, 4).
        """
        linear, offset = to_world[:, :3, :3], to_world[:, :3, 3]
        size, ball = self.ball(to_world)
        visible = camera.may_see(self.box_corners @ linear.transpose(0, 2, 1) + offset[:, None])
        distance = np.linalg.norm(ball[:, :3] - camera.eye, axis=1) - ball[:, 3]
        for i in np.flatnonzero(distance < ball[:, 3]).tolist():
            # The eye is near the bounding ball, but perhaps not near the surface: lines on it give a better bound.
            a, b = (self.surface_lines[:, end] @ linear[i].T + offset[i] for end in range(2))
            distance[i] = max(distance[i], distance_to_segments(a, b, camera.eye) - self.gap * size[i])
        return camera.footprint(distance) / size, visible

    def segments(self, to_world: np.ndarray, camera: Camera, tolerance: float | np.ndarray) -> np.ndarray:
        """Returns, for each transform (n, 4, 4), the number of line segments by which the mesh must approximate a full
        circle: a multiple of 4. For a primitive without a curved face, the number is 4.

        With the returned number of segments, the chord error is below ``tolerance`` pixels if MAX_SEGMENTS allows it,
        except near the ends of an ellipsoid whose longest semi-axis is more than MAX_ASPECT times the second longest.
        For a primitive outside the window, the tolerance is OUTSIDE_TOLERANCE times larger, and the maximum is
        OUTSIDE_SEGMENTS.
        """
        if self.curved is None:
            return np.full(len(to_world), 4)
        pixel, visible = self.pixel(to_world, camera)
        error = np.where(visible, 1, OUTSIDE_TOLERANCE) * tolerance * pixel  # relative
        n = math.pi / np.arccos(1 - np.clip(error, 1e-9, 0.5)) * self.segment_factor
        n = np.clip(n, MIN_SEGMENTS, np.where(visible, MAX_SEGMENTS, OUTSIDE_SEGMENTS))
        return np.asarray(4 * np.ceil(n / 4), int)


def box_corners(box: np.ndarray) -> np.ndarray:
    """Returns the corners (8, 3) of a box (2, 3)."""
    return np.array([[box[i][0], box[j][1], box[k][2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)], float)


def distance_to_segments(a: np.ndarray, b: np.ndarray, point: np.ndarray) -> float:
    """Returns the distance from a point to the nearest of the line segments from a (n, 3) to b (n, 3)."""
    along, length = b - a, np.maximum(np.sum((b - a) ** 2, axis=1), 1e-300)
    t = np.clip(np.sum((point - a) * along, axis=1) / length, 0, 1)
    return float(np.sqrt(np.min(np.sum((a + t[:, None] * along - point) ** 2, axis=1))))


def plane(*nd: float) -> np.ndarray:
    """Returns the quadric (4, 4) of the plane n.p + d = 0, from the numbers n and d."""
    return np.outer(nd, nd).astype(float)


def circle(segments: int) -> np.ndarray:
    """Returns the corners (segments, 2) of a regular polygon that is inscribed in the unit circle."""
    angle = 2 * math.pi * np.arange(segments) / segments
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def azimuth(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the azimuth of corners (n, 3, 3) as a fraction of a turn, and which corners are on the axis: these have
    the mean azimuth of the other corners. In a triangle across the seam at 0, azimuths below 0.5 are increased by 1.
    """
    on_axis = np.hypot(p[..., 0], p[..., 1]) < ON_AXIS
    u = np.arctan2(p[..., 1], p[..., 0]) / (2 * math.pi) % 1.0
    width = np.where(on_axis, -np.inf, u).max(axis=1) - np.where(on_axis, np.inf, u).min(axis=1)
    u = np.where((width > 0.5)[:, None] & (u < 0.5), u + 1, u)
    mean_of_others = np.where(on_axis, 0, u).sum(axis=1) / np.maximum((~on_axis).sum(axis=1), 1)
    return np.where(on_axis, mean_of_others[:, None], u), on_axis


class Cube(Primitive):
    """Face 0, 1 or 2 is the side x = 0, y = 0 or z = 0 of the cube; face 3, 4 or 5 is the side x = 1, y = 1 or z =
    1. A PLANE is a cube with another ``box``.
    """

    #: The corners of each face, counter-clockwise from outside; the corner (x, y, z) has the number 4 x + 2 y + z.
    squares = np.array([(0, 1, 3, 2), (0, 4, 5, 1), (0, 2, 6, 4), (4, 6, 7, 5), (2, 3, 7, 6), (1, 5, 7, 3)])
    #: The corners of a rectangle on the side z = 1, and of the four facets around it.
    frame = np.array([(8, 9, 10, 11), (1, 5, 9, 8), (5, 7, 10, 9), (7, 3, 11, 10), (3, 1, 8, 11)])

    def __init__(
        self, name: str = "cube", box: ArrayLike = ((0, 0, 0), (1, 1, 1)), rectangle: ArrayLike | None = None
    ) -> None:
        """Makes a cube with the corners ``box``. Where small solids need it, ``rectangle`` (2, 2) divides the side z =
        1: long narrow triangles would have holes in single precision.
        """
        self.name, self.box = name, np.array(box, float)
        self.vertices, self.faces = box_corners(self.box), np.arange(6)
        if rectangle is not None:
            (x0, y0), (x1, y1), z = *np.array(rectangle), self.box[1, 2]
            self.vertices = np.append(self.vertices, [(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)], axis=0)
            self.squares, self.faces = np.append(self.squares[:5], self.frame, axis=0), np.minimum(np.arange(10), 5)
        self.quadrics = np.array([plane(*n, -corner @ n) for corner in self.box for n in np.eye(3)])

    def mesh(self, segments: int, facet_map: np.ndarray) -> Mesh:
        triangles = self.squares[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
        return Mesh(self.vertices, triangles, np.repeat(np.arange(len(self.faces)), 2), self.faces)

    def corner_attributes(self, p: np.ndarray, face: np.ndarray) -> CornerAttributes:
        normals = np.zeros_like(p)
        axis = face % 3
        normals[np.arange(len(p)), :, axis] = np.where(face < 3, -1, 1)[:, None]
        across = np.array([[1, 2], [0, 2], [0, 1]])[axis]  # (y, z), (x, z), (x, y)
        uv = np.take_along_axis(p, np.repeat(across[:, None], 3, axis=1), axis=2)
        return CornerAttributes(normals, uv, np.zeros(p.shape[:2], bool))


def _subdivided_octahedron(segments: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns vertices, on the unit sphere, and triangles of an evenly subdivided octahedron."""
    mesh = Manifold.sphere(1.0, segments).to_mesh64()
    vertices = np.array(mesh.vert_properties)[:, :3]
    return vertices / np.linalg.norm(vertices, axis=1, keepdims=True), np.array(mesh.tri_verts, dtype=np.int64)


class Sphere(Primitive):
    """The unit ball. The only face of the ball is curved, and every triangle of its mesh is a facet."""

    name = "sphere"
    quadrics = np.diag([1.0, 1, 1, -1])[None]
    box = np.array([[-1.0, -1, -1], [1, 1, 1]])
    curved = 0
    axes = 3
    surface_lines = np.repeat(_subdivided_octahedron(64)[0][:, None], 2, axis=1)  # points, less than 0.05 apart
    segment_factor = 1.64  # the largest triangles lie at the centres of the octahedron's faces

    def mesh(self, segments: int, facet_map: np.ndarray) -> Mesh:
        vertices, triangles = _subdivided_octahedron(segments)
        mapped = np.append(vertices, np.ones((len(vertices), 1)), axis=1) @ facet_map.T  # homogeneous coordinates
        return Mesh(mapped[:, :3] / mapped[:, 3:], triangles, np.arange(len(triangles)), np.zeros(len(triangles), int))

    def ball(self, to_world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        # See MAX_ASPECT.
        longest, second, _ = np.linalg.svd(to_world[:, :3, :3], compute_uv=False).T
        return np.minimum(longest, MAX_ASPECT * second), np.append(to_world[:, :3, 3], longest[:, None], axis=1)

    def corner_attributes(self, p: np.ndarray, face: np.ndarray) -> CornerAttributes:
        """Returns normals and uv; u is the azimuth, as :func:`azimuth` returns it, and v is the polar angle, scaled to
        [0, 1]. A corner at a pole does not share its vertex with other triangles.
        """
        radius = np.linalg.norm(p, axis=2)
        u, on_axis = azimuth(p)
        v = np.arccos(np.clip(p[..., 2] / radius, -1, 1)) / math.pi
        return CornerAttributes(p, np.stack([u, v], axis=2), on_axis)


class OfRevolution(Primitive):
    """A slice of a cylinder or a cone about z, from a disc at z = ``low`` to a disc with radius 1 at z = 1. Face 0 is
    the curved side, face 1 is the disc at z = 1, and face 2 is the disc at z = ``low``, if its radius is not 0.
    """

    curved = 0

    def __init__(self, name: str, narrow: float, low: float, quadric: Sequence[float]) -> None:
        """Makes a slice of the surface x^2 + y^2 + ... = 0, whose coefficients of x^2, y^2, z^2 and 1 are ``quadric``.

        ``narrow`` is the radius of the disc at z = ``low``.
        """
        self.name, self.narrow, self.low = name, narrow, low
        self.quadrics = np.array([np.diag(quadric), plane(0, 0, 1, -1), plane(0, 0, 1, -low)])[: 3 if narrow else 2]
        self.box = np.array([[-1.0, -1, low], [1, 1, 1]])
        self.placement = np.diag([1, 1, 1 / (1 - low), 1])
        self.placement[2, 3] = -low / (1 - low)
        ends = [np.append(circle(64) * radius, np.full((64, 1), z), axis=1) for radius, z in ((narrow, low), (1, 1))]
        self.surface_lines = np.stack(ends, axis=1)

    def mesh(self, segments: int, facet_map: np.ndarray) -> Mesh:
        """Returns the mesh: one or two discs, and for each segment of the side a facet of two triangles, or of one that
        ends at the apex. ``facet_map`` moves the corners of the discs along their circles; an apex is the last vertex.
        """
        # facet_map keeps the lines of the side: they are parallel to z, or meet at the apex of the cone.
        slope = -self.quadrics[0, 2, 2]  # 0 for a cylinder, 1 for a cone
        lines = np.append(circle(segments), np.full((segments, 1), slope), axis=1) @ facet_map[:3, :3].T
        around = lines[:, :2] / (lines[:, 2:] if slope else np.linalg.norm(lines[:, :2], axis=1, keepdims=True))
        ring = np.append(around, np.ones((segments, 1)), axis=1)
        upper, disc, corners = np.arange(segments), fan(segments), segments if self.narrow else 1
        following, lower = (upper + 1) % segments, upper % corners + segments
        discs, sides = [disc], [(upper, lower, following)]
        if self.narrow:
            discs.append(disc[:, ::-1] + segments)
            sides.append((following, lower, lower[following]))
        facets = [np.repeat(np.arange(len(discs)), segments - 2), *[upper + len(discs)] * len(sides)]
        faces = np.append([1, 2][: len(discs)], np.zeros(segments, int))
        vertices = np.concatenate([ring, (ring * [self.narrow, self.narrow, self.low])[:corners]])
        triangles = np.concatenate([*discs, *(np.stack(side, axis=1) for side in sides)])
        return Mesh(vertices, triangles, np.concatenate(facets), faces)

    def ball(self, to_world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        size = np.linalg.norm(to_world[:, :3, :2], 2, axis=(1, 2))  # the longest semi-axis of the discs
        axis = to_world[:, :3, 2]
        radius = np.linalg.norm(axis, axis=1) * (1 - self.low) / 2 + size
        center = to_world[:, :3, 3] + axis * (1 + self.low) / 2
        return size, np.append(center, radius[:, None], axis=1)

    def corner_attributes(self, p: np.ndarray, face: np.ndarray) -> CornerAttributes:
        """Returns normals and uv: uv is (azimuth, z of the scene) on the side, and (x, y) mapped to the unit square on
        a disc. At an apex, each triangle has the side's normal at the midpoint of the other two corners.
        """
        u, on_axis = azimuth(p)
        v = (p[..., 2] - self.low) / (1 - self.low)
        normals, uv = p * np.diag(self.quadrics[0])[:3], np.stack([u, v], axis=2)
        on_disc = face > 0
        normals[on_disc] = np.where(face[on_disc] == 1, 1, -1)[:, None, None] * [0, 0, 1]
        uv[on_disc] = p[on_disc][..., :2] / 2 + 0.5
        apex = (np.linalg.norm(p, axis=2) < ON_AXIS) & ~on_disc[:, None]
        tips = apex.any(axis=1)
        middle = np.where(apex[..., None], 0, p)[tips].sum(axis=1) * [1, 1, 0]
        middle /= np.maximum(np.linalg.norm(middle, axis=1, keepdims=True), 1e-300)
        middle[:, 2] = -1
        normals[tips] = np.where(apex[tips][..., None], middle[:, None], normals[tips])
        return CornerAttributes(normals, uv, apex | on_axis & ~on_disc[:, None])


def fan(segments: int) -> np.ndarray:
    """Returns the triangles of a disc with ``segments`` corners, counter-clockwise if seen from +z."""
    i = np.arange(1, segments - 1)
    return np.stack([np.zeros_like(i), i, i + 1], axis=1)


def cone(radius: float = 0.0) -> Primitive:
    """Returns the cone with its apex at the origin; or, with a ``radius``, its part above the disc of this radius."""
    return OfRevolution("cone", radius, radius, (1, 1, -1, 0))


class Torus(Primitive):
    """A torus about z, whose tube has the radius ``radius`` and its centre at the distance 1 from z. Its only face is
    curved. Its facets are those of a torus with the radius ``pattern``, moved to its surface.
    """

    name = "torus"
    curved = 0
    axes = 3

    def __init__(self, radius: float = 0.25, pattern: float | None = None) -> None:
        self.radius, self.pattern, self.hull = radius, pattern or radius, (1, radius)
        # The chord errors around z and around the tube are added.
        self.segment_factor = math.sqrt(1 + radius / (1 + radius) * (1 + self.pattern) / self.pattern)
        # Not its surface, but a quadric with the same symmetries, which no torus with another decimal radius has.
        self.quadrics = np.diag([1, 1, -math.exp(radius), -1])[None]
        self.box = np.array([1 + radius, 1 + radius, radius]) * [[-1], [1]]
        self.surface_lines = np.repeat(self.mesh(64, np.eye(4)).vertices[:, None], 2, axis=1)  # points

    def mesh(self, segments: int, facet_map: np.ndarray) -> Mesh:
        """Returns a facet of two triangles for each pair of segments, around z and of the tube. ``facet_map`` maps the
        space of the torus with the same facets to the space of this one.
        """
        of_tube = 4 * math.ceil(segments * math.sqrt(self.pattern / (1 + self.pattern)) / 4)  # an equal chord error
        x, z = ((1, 0) + self.pattern * circle(of_tube)).T
        around = circle(segments)[:, None] * x[:, None]
        vertices = np.concatenate([around, np.broadcast_to(z[:, None], (segments, of_tube, 1))], axis=2).reshape(-1, 3)
        number = np.arange(segments * of_tube).reshape(segments, of_tube)
        a, b, c, d = (np.roll(number, (-i, -j), (0, 1)).ravel() for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
        triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
        vertices = vertices @ facet_map[:3, :3].T + facet_map[:3, 3]
        if self.pattern != self.radius or not np.array_equal(facet_map, np.eye(4)):
            vertices = self.scaled(vertices, 1)
        return Mesh(vertices, triangles, np.tile(a, 2), np.zeros(len(a), int))

    def scaled(self, vertices: np.ndarray, scale: float) -> np.ndarray:
        center = vertices * [1, 1, 0] / np.linalg.norm(vertices[:, :2], axis=1, keepdims=True)
        outwards = (vertices - center) / np.linalg.norm(vertices - center, axis=1, keepdims=True)
        return np.asarray(center + max(self.radius - (1 - scale) * (1 + self.radius), 1e-3 * self.radius) * outwards)

    def ball(self, to_world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        size = (1 + self.radius) * np.linalg.norm(to_world[:, :3, :3], 2, axis=(1, 2))
        return size, np.append(to_world[:, :3, 3], size[:, None], axis=1)

    def implicit(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns the squared distance from the centre of the tube less the radius squared, and gradients."""
        distance = np.linalg.norm(p[..., :2], axis=-1)
        from_center = p * np.stack([1 - 1 / np.maximum(distance, 1e-300)] * 2 + [np.ones_like(distance)], axis=-1)
        return (distance - 1) ** 2 + p[..., 2] ** 2 - self.radius**2, 2 * from_center

    def corner_attributes(self, p: np.ndarray, face: np.ndarray) -> CornerAttributes:
        """Returns normals and uv; u is the azimuth, and v is the angle around the tube, which is 0 on the outside."""
        u, on_axis = azimuth(p)
        v, _ = azimuth(np.stack([np.linalg.norm(p[..., :2], axis=2) - 1, p[..., 2]], axis=2))
        return CornerAttributes(self.implicit(p)[1], np.stack([u, v], axis=2), on_axis | (v >= 1))


#: Name of a primitive, which is the :attr:`prosim_scene.model.Leaf.shape` -> the primitive.
PRIMITIVES: dict[str, Primitive] = {
    primitive.name: primitive
    for primitive in (
        *(Cube(), Sphere(), OfRevolution("cylinder", 1, 0, (1, 1, 0, -1))),
        *(cone(), Torus(), Cube("plane", np.zeros((2, 3)))),
    )
}


@lru_cache(maxsize=1024)
def primitive_of(shape: str, radius: float | None = None, pattern: float | None = None) -> Primitive:
    """Returns the primitive with the name ``shape``; a CONE or a TORUS may have a ``radius``, a TORUS a ``pattern``."""
    if radius is None:
        return PRIMITIVES[shape]
    return Torus(radius, pattern) if shape == "torus" else cone(radius)
