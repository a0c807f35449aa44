"""Separates coincident faces before a Boolean operation, and snaps faces onto their planes at the end.

If two faces lie on the same plane except for rounding, a Boolean operation on their meshes leaves films without
thickness, and faces with the wrong owner. Therefore every facet on a surface that several primitives share has the
number of its plane, and the vertices of the facet are snapped onto this plane: they move to the nearest point of the
plane. Before an operation, the facets of the two solids on common planes move apart by a gap. The gap is large compared
with rounding, and small compared with all other lengths. Thus the facets on one plane form layers, whose order never
changes. At the end, the vertices of the result are snapped onto the planes.

- In A + B, A grows. Faces with the same orientation belong to A, and faces with opposite orientations vanish.
- In A - B and A * B, A shrinks. A flush cut is open, faces that touch leave no film, and faces with the same
  orientation belong to A.

Therefore the first primitive in the CSG tree owns a common face. The result is regularized (Requicha and Voelcker
1985): it has no films and no dangling faces. Facets of curved faces are treated in the same way, because all solids on
one quadric have the same facets (see :mod:`.leaves`).

Two equal surfaces differ by the rounding of transforms and of decimal fractions. The equations of two surfaces are
compared in the space of one of the two primitives, where rounding is small and a visible difference is large.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from manifold3d import Manifold, Mesh64

from .grouping import components

SAME = 1e-7  # tolerance of a quadric's coefficients in a primitive's own space
NEAR = 1e-6  # tolerance of the coefficients in the scene's space, which selects the surfaces to compare


def same_surfaces(quadrics: np.ndarray, matrices: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Returns a representative of each of n faces: the face of the largest primitive among the connected faces.

    Two faces are connected if their surfaces are equal and their boxes touch. The surface of face i is the quadric
    ``quadrics[i]`` (n, 4, 4) in the space of a primitive, which ``matrices[i]`` (n, 4, 4) maps to the world; its box in
    the world has the corners ``low[i]`` and ``high[i]`` (n, 3). A representative represents itself.
    """
    sizes = np.linalg.norm(matrices[:, :3, :3], axis=(1, 2))
    features, inverse = _features(quadrics, matrices), np.linalg.inv(matrices[:, :3, :3])

    def equal(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Whether pairs of faces have equal surfaces; compares them in the space of the larger primitive."""
        large = np.where(sizes[first] < sizes[second], second, first)
        small = first + second - large
        relative = np.zeros((len(small), 4, 4))  # from the space of the small primitive to that of the large one
        relative[:, :3, :3] = inverse[large] @ matrices[small, :3, :3]
        relative[:, :3, 3:] = inverse[large] @ (matrices[small] - matrices[large])[:, :3, 3:]
        relative[:, 3, 3] = 1
        compared = np.stack([relative.transpose(0, 2, 1) @ quadrics[large] @ relative, quadrics[small]])
        compared /= np.linalg.norm(compared, axis=(2, 3), keepdims=True)
        return np.asarray(np.abs(compared[0] - compared[1]).max(axis=(1, 2)) < SAME)

    # An offset along x separates the boxes of different surfaces, so one call finds the components of all surfaces.
    offset = np.outer(_clusters(features) * 2 * np.ptp([low[:, 0], high[:, 0]]), [1, 0, 0])
    group = components(low + offset, high + offset, equal)
    order = np.argsort(-sizes, kind="stable")
    _, largest, number = np.unique(group[order], return_index=True, return_inverse=True)
    result = np.empty_like(order)
    result[order] = order[largest][number]
    return result


def _features(quadrics: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """Returns coefficients (n, 10) of the surfaces in a space in which the scene has about the size 1.

    Equal surfaces have equal coefficients, except for rounding.
    """
    to_unit = np.eye(4)
    center = matrices[:, :3, 3].mean(axis=0)
    scale = max(np.abs(matrices[:, :3, 3] - center).max(), np.abs(matrices[:, :3, :3]).max())
    to_unit[:3] = np.append(np.eye(3), -center[:, None], axis=1) / scale
    inverse = np.linalg.inv(to_unit @ matrices)
    world = inverse.transpose(0, 2, 1) @ quadrics @ inverse
    world /= np.linalg.norm(world[:, :3, :3], axis=(1, 2))[:, None, None]
    row, column = np.triu_indices(4)
    return np.asarray(world[:, row, column])


def _clusters(rows: np.ndarray) -> np.ndarray:
    """Labels the rows of an array: rows that differ by less than NEAR in every column have the same label."""
    label = np.zeros(len(rows), int)
    count = 0
    while count < label.max() + 1:
        count = label.max() + 1
        for column in rows.T:
            order = np.lexsort([column, label])
            new = (np.diff(label[order]) != 0) | (np.diff(column[order]) > NEAR)
            label[order] = np.concatenate([[0], np.cumsum(new)])
    return label


THICKNESS = 2.0**-26  # about the thickness of all layers on a plane, relative to the scene's size (a power of two)
GAP = 2.0**-10  # the distance of two layers, relative to THICKNESS; manifold3d's tolerance is 1e-12 of the scene's size


class Facets(NamedTuple):
    """The k triangles of a solid that lie on shared planes.

    ``corners`` (k, 3) are the numbers of the triangles' corners in ``vertices`` (n, 3). ``plane`` (k,) is the number of
    the plane of each triangle. ``side`` (k,) is 1 if the triangle's outward normal is the normal of the plane, and -1
    if it is the opposite. ``height`` (k, 3) are the signed distances of the corners from the plane.
    """

    vertices: np.ndarray
    corners: np.ndarray
    plane: np.ndarray
    side: np.ndarray
    height: np.ndarray


class Planes:
    """The planes that facets share.

    ``planes`` (n, 4) are unit normals and offsets of planes n.p + d = 0. ``surface`` (n,) is the number of the surface
    to which each plane belongs. Facet f lies on the plane ``of_facet[f]`` (-1: on no shared plane). Its outward normal
    is ``side[f]`` (1 or -1) times the normal of this plane. ``thickness`` is THICKNESS in the unit of the scene,
    ``gap`` is GAP times ``thickness``.
    """

    def __init__(
        self, triangles: np.ndarray, facets: np.ndarray, surface: np.ndarray, rank: np.ndarray, thickness: float
    ) -> None:
        """Computes the planes on which ``triangles`` (m, 3, 3) lie; ``facets`` (m,) are the numbers of their facets.

        ``surface`` (n,) has the surface of each facet, ``rank`` (n,) has the rank of the facet's face. Faces on one
        surface have equally many facets. The i-th facets of all these faces get one plane, that of the face with the
        lowest rank. ``thickness`` is THICKNESS in the unit of the scene.
        """
        shared = np.unique(facets)
        shared = shared[np.argsort(rank[shared], kind="stable")]
        face_starts = np.flatnonzero(np.diff(rank[shared], prepend=-1))  # the first facet of each face
        number_in_face = np.arange(len(shared)) - np.repeat(face_starts, np.diff(np.append(face_starts, len(shared))))
        keys = surface[shared] * (number_in_face.max(initial=0) + 1) + number_in_face
        _, first, plane = np.unique(keys, return_index=True, return_inverse=True)
        position = np.empty(len(surface), int)
        position[shared] = np.arange(len(shared))
        own = _planes(triangles, position[facets])
        self.planes, self.surface = own[first], surface[shared[first]]
        self.thickness, self.gap = thickness, thickness * GAP
        self.of_facet, self.side = np.full(len(surface), -1), np.ones(len(surface))
        self.of_facet[shared] = plane
        self.side[shared] = np.sign(np.einsum("ij,ij->i", own[:, :3], own[first[plane], :3]))

    def separate(self, first: Manifold, second: Manifold, outwards: int) -> list[Manifold]:
        """Moves the facets of two solids apart on their common planes; returns the moved solids.

        The first solid grows (``outwards`` 1) or shrinks (-1) relative to the second. For each plane this decides which
        facets of the first solid must be above all facets of the second solid, and which below; above is the direction
        of the plane's normal. The facets of the second solid move into the room between. If the room is too small, the
        facets above it move up. Distances are at least ``gap``. The solid with fewer triangles on shared planes moves.
        """
        a, b = self._facets(first), self._facets(second)
        low, high = self._extremes(b.plane, b.vertices[b.corners])
        points, margin = a.vertices[a.corners], 8 * self.thickness
        near = (points.min(axis=1) <= high[a.plane] + margin) & (points.max(axis=1) >= low[a.plane] - margin)
        near, upper = near.all(axis=1), a.side * outwards > 0
        bottom, _ = self._extremes(a.plane[near & upper], a.height[near & upper])
        _, top = self._extremes(a.plane[near & ~upper], a.height[near & ~upper])
        lowest, highest = self._extremes(b.plane, b.height)
        least, most = top + self.gap - lowest, bottom - self.gap - highest  # limits for the move of the second solid
        move, raised = np.maximum(np.minimum(most, 0), least), np.maximum(least - most, 0)
        by_first, by_second = np.where(upper, raised[a.plane], 0.0), move[b.plane]
        if len(b.plane) > len(a.plane):  # the first solid moves instead of the second
            by_first, by_second = by_first - move[a.plane], np.zeros(len(b.plane))
        return [self._moved(first, a, by_first[:, None]), self._moved(second, b, by_second[:, None])]

    def _extremes(self, plane: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns the minima and the maxima, for each plane, of the ``values`` (k, 3, ...) of the corners of triangles.

        ``plane`` (k,) is the plane of each triangle. A plane without triangles has the minimum inf and the maximum
        -inf.
        """
        low = np.full((len(self.planes), *values.shape[2:]), np.inf)
        high = -low
        np.minimum.at(low, plane, values.min(axis=1))
        np.maximum.at(high, plane, values.max(axis=1))
        return low, high

    def snap(self, solid: Manifold) -> Manifold:
        """Returns the solid with its facets on shared planes moved exactly onto these planes."""
        facets = self._facets(solid)
        return self._moved(solid, facets, -facets.height)

    def _facets(self, solid: Manifold) -> Facets:
        """Returns the triangles of a solid that lie on shared planes."""
        mesh = solid.to_mesh64()
        facets = np.asarray(mesh.face_id, dtype=np.int64)
        on = self.of_facet[facets] >= 0
        facets, corners = facets[on], np.asarray(mesh.tri_verts, dtype=np.int64)[on]
        vertices, plane = np.array(mesh.vert_properties)[:, :3], self.of_facet[facets]
        height = np.einsum("tij,tj->ti", vertices[corners], self.planes[plane, :3]) + self.planes[plane, 3, None]
        return Facets(vertices, corners, plane, self.side[facets] * signs(mesh)[on], height)

    def _moved(self, solid: Manifold, facets: Facets, by: np.ndarray) -> Manifold:
        """Returns a solid with the corners of its ``facets`` moved along the normals of their planes.

        ``by`` are the signed distances of the corners (k, 3), or of the triangles (k, 1).
        """
        touched = np.zeros(len(facets.vertices), bool)
        touched[facets.corners[(by != 0).any(axis=1)]] = True
        if not touched.any():
            return solid
        triangle, corner = np.nonzero(touched[facets.corners])
        by, vertex = np.broadcast_to(by, facets.corners.shape)[triangle, corner], facets.corners[triangle, corner]
        points = self._move_points(facets.vertices, vertex, facets.plane[triangle], by)
        return solid.warp_batch(lambda _: points)

    def snap_vertices(self, vertices: np.ndarray, triangles: np.ndarray, facets: np.ndarray) -> np.ndarray:
        """Returns the vertices (n, 3), moved onto the planes of the facets of which they are corners.

        ``triangles`` (m, 3) are triangles of these vertices, ``facets`` (m,) is the facet of each triangle.
        """
        if not len(facets):
            return vertices
        pairs = np.unique(triangles * len(self.planes) + self.of_facet[facets, None])
        vertex, plane = np.divmod(pairs, len(self.planes))
        height = np.einsum("ij,ij->i", self.planes[plane, :3], vertices[vertex]) + self.planes[plane, 3]
        return self._move_points(vertices, vertex, plane, -height)

    def one_sided(self, surfaces: Collection[int], boxes: np.ndarray) -> bool:
        """Whether all ``boxes`` (see :class:`.Body`) are certainly on the same side of each of the ``surfaces``."""
        planes = self.planes[np.isin(self.surface, list(surfaces))]
        if len(planes) > len(surfaces):  # a surface with several planes is curved
            return False
        height = boxes[:, 2:].reshape(-1, 3) @ planes[:, :3].T + planes[:, 3]
        return bool(((height <= 8 * self.thickness).all(axis=0) | (height >= -8 * self.thickness).all(axis=0)).all())

    def _move_points(self, points: np.ndarray, vertex: np.ndarray, plane: np.ndarray, by: np.ndarray) -> np.ndarray:
        """Moves points by given signed distances along normals of planes; changes ``points`` and returns it.

        For each i, the point ``vertex[i]`` moves by ``by[i]`` along the normal of the plane ``plane[i]``. Each point
        moves by the shortest way that satisfies all its planes.
        """
        touched, index = np.unique(vertex, return_inverse=True)
        normal = self.planes[plane, :3]
        normals, heights = np.zeros((len(touched), 3, 3)), np.zeros((len(touched), 3, 1))
        np.add.at(normals, index, normal[:, :, None] * normal[:, None])
        np.add.at(heights, index, (normal * by[:, None])[:, :, None])
        # Tikhonov's regularisation: fewer than three planes leave directions free, more than three are overdetermined.
        points[touched] += np.linalg.solve(normals + 1e-12 * np.eye(3), heights)[..., 0]
        return points


def per_triangle(mesh: Mesh64, values: np.ndarray) -> np.ndarray:
    """Repeats ``values`` (runs,), one for each run of triangles of a mesh, for each triangle of the run."""
    ends = np.asarray(mesh.run_index, dtype=np.int64) // 3
    return np.repeat(values, ends[1:] - ends[:-1])


def signs(mesh: Mesh64) -> np.ndarray:
    """Returns 1 for each triangle, but -1 on the faces of subtracted solids, whose normals point inwards."""
    return per_triangle(mesh, 1 - 2 * (np.asarray(mesh.run_flags, dtype=np.int64) & 1))


def _planes(triangles: np.ndarray, facet: np.ndarray) -> np.ndarray:
    """Returns the planes (k, 4) of facets: unit outward normals and offsets, which are means over the triangles of a
    facet.

    ``triangles`` has the shape (m, 3, 3); ``facet`` (m,) is the number of the facet of each triangle.
    """
    a, b, c = np.moveaxis(triangles, 1, 0)
    cross = np.cross(b - a, c - a)
    weight = np.linalg.norm(cross, axis=1)
    middles = weight[:, None] * (a + b + c) / 3
    normal = np.stack([np.bincount(facet, cross[:, i]) for i in range(3)], axis=1)
    middle = np.stack([np.bincount(facet, middles[:, i]) for i in range(3)], axis=1)
    unit = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    offset = np.einsum("ij,ij->i", unit, middle / np.maximum(np.bincount(facet, weight), 1e-300)[:, None])
    return np.append(unit, -offset[:, None], axis=1)
