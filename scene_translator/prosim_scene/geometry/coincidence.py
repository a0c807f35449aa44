"""Separates coincident faces before a Boolean operation, and snaps faces onto their planes at the end.

If two faces lie on the same plane except for rounding, a Boolean operation on their meshes leaves films without
thickness, and faces with the wrong owner. Therefore every facet on a surface that several primitives share has the
number of its plane, and the vertices of the facet are snapped onto this plane: they move to the nearest point of the
plane. Before an operation, the facets of the first solid move away from the planes that it shares with the second
solid, by a gap. The gap is large compared with rounding, but smaller than manifold3d's tolerance, so that manifold3d
merges the vertices on both sides of a gap. Before the next operation, and at the end, the vertices of the result are
snapped onto the planes again.

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
    _, largest = np.unique(group[order], return_index=True)
    _, number = np.unique(group, return_inverse=True)
    return np.asarray(order[largest][number])


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


THICKNESS = 2.0**-26  # the largest distance of coincident facets, relative to the scene's size (a power of two)
#: The gap between coincident facets in an operation, relative to manifold3d's tolerance, which is 1e-12 of the size of
#: the solids. Facets on both sides of three planes move apart by less than the tolerance.
GAP = 1 / 8


class Facets(NamedTuple):
    """The k triangles of a solid that lie on shared planes.

    ``corners`` (k, 3) are the numbers of the triangles' corners in ``vertices`` (n, 3). ``plane`` (k,) is the number of
    the plane of each triangle. ``side`` (k,) is 1 if the triangle's outward normal is the normal of the plane, and -1
    if it is the opposite.
    """

    vertices: np.ndarray
    corners: np.ndarray
    plane: np.ndarray
    side: np.ndarray


class Planes:
    """The planes that facets share.

    ``planes`` (n, 4) are unit normals and offsets of planes n.p + d = 0. ``surface`` (n,) is the number of the surface
    to which each plane belongs. Facet f lies on the plane ``of_facet[f]`` (-1: on no shared plane). Its outward normal
    is ``side[f]`` (1 or -1) times the normal of this plane. ``thickness`` is THICKNESS in the unit of the scene.
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
        self.thickness = thickness
        self.of_facet, self.side = np.full(len(surface), -1), np.ones(len(surface))
        self.of_facet[shared] = plane
        self.side[shared] = np.sign(np.einsum("ij,ij->i", own[:, :3], own[first[plane], :3]))

    def separate(self, first: Manifold, second: Manifold, outwards: int) -> list[Manifold]:
        """Returns two solids whose facets on common planes are apart.

        The facets of the first solid move outwards (``outwards`` 1) or inwards (-1) by a gap: :data:`GAP` times
        manifold3d's tolerance. The facets of the second solid lie on the planes.
        """
        a, b = self._facets(first), self._facets(second)
        gap = GAP * max(first.get_tolerance(), second.get_tolerance())
        heights = np.where(np.isin(a.plane, b.plane), outwards * gap * a.side, 0.0)
        return [self._moved(first, a, heights), self._moved(second, b, np.zeros(len(b.plane)))]

    def snap(self, solid: Manifold) -> Manifold:
        """Returns the solid with its facets on shared planes moved exactly onto these planes."""
        facets = self._facets(solid)
        return self._moved(solid, facets, np.zeros(len(facets.plane)))

    def _facets(self, solid: Manifold) -> Facets:
        """Returns the triangles of a solid that lie on shared planes."""
        mesh = solid.to_mesh64()
        facets = np.asarray(mesh.face_id, dtype=np.int64)
        on = self.of_facet[facets] >= 0
        facets, corners = facets[on], np.asarray(mesh.tri_verts, dtype=np.int64)[on]
        vertices = np.array(mesh.vert_properties)[:, :3]
        return Facets(vertices, corners, self.of_facet[facets], self.side[facets] * signs(mesh)[on])

    def _moved(self, solid: Manifold, facets: Facets, heights: np.ndarray) -> Manifold:
        """Returns a solid with its ``facets`` moved to the ``heights`` (k,) over their planes."""
        points = self._points_at(facets.vertices, facets.corners, facets.plane, heights)
        return solid if np.array_equal(points, facets.vertices) else solid.warp_batch(lambda _: points)

    def snap_vertices(self, vertices: np.ndarray, triangles: np.ndarray, facets: np.ndarray) -> np.ndarray:
        """Returns the vertices (n, 3), moved onto the planes of the facets of which they are corners.

        ``triangles`` (m, 3) are triangles of these vertices, ``facets`` (m,) is the facet of each triangle.
        """
        return self._points_at(vertices, triangles, self.of_facet[facets], np.zeros(len(facets)))

    def one_sided(self, surfaces: Collection[int], boxes: np.ndarray) -> bool:
        """Whether all ``boxes`` (see :class:`.Body`) are certainly on the same side of each of the ``surfaces``."""
        planes = self.planes[np.isin(self.surface, list(surfaces))]
        if len(planes) > len(surfaces):  # a surface with several planes is curved
            return False
        height = boxes[:, 2:].reshape(-1, 3) @ planes[:, :3].T + planes[:, 3]
        return bool(((height <= 8 * self.thickness).all(axis=0) | (height >= -8 * self.thickness).all(axis=0)).all())

    def _points_at(self, points: np.ndarray, corners: np.ndarray, plane: np.ndarray, heights: np.ndarray) -> np.ndarray:
        """Returns points (n, 3) with the corners of k triangles moved to given heights over the triangles' planes.

        ``corners`` (k, 3) are the numbers of the corners; each triangle has a ``plane`` (k,) and a height (k,). Each
        point moves by the shortest way that satisfies all its planes. If triangles of one plane have different heights,
        a common corner moves to the mean of the smallest and the largest height.
        """
        keys, index = np.unique(corners * len(self.planes) + plane[:, None], return_inverse=True)
        low, high = np.full(len(keys), np.inf), np.full(len(keys), -np.inf)
        np.minimum.at(low, index.reshape(-1, 3), heights[:, None])
        np.maximum.at(high, index.reshape(-1, 3), heights[:, None])
        vertex, plane = np.divmod(keys, len(self.planes))
        normal = self.planes[plane, :3]
        by = (low + high) / 2 - np.einsum("ij,ij->i", normal, points[vertex]) - self.planes[plane, 3]
        touched, index = np.unique(vertex, return_inverse=True)
        normals, moves = np.zeros((len(touched), 3, 3)), np.zeros((len(touched), 3, 1))
        np.add.at(normals, index, normal[:, :, None] * normal[:, None])
        np.add.at(moves, index, (normal * by[:, None])[:, :, None])
        result = np.array(points)
        # Tikhonov's regularisation: fewer than three planes leave directions free, more than three are overdetermined.
        result[touched] += np.linalg.solve(normals + 1e-12 * np.eye(3), moves)[..., 0]
        return result


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
