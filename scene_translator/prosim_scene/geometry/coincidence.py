"""Separates coincident faces before a Boolean operation, and snaps faces onto their planes after the operations.

If faces of two solids lie on the same plane except for rounding, a Boolean operation on the meshes leaves films without
thickness, and faces with the wrong owner. Therefore every facet on a surface that several primitives share has the
number of its plane, and the vertices of the facet are snapped: each vertex moves to the nearest point of the facet's
plane. Before a Boolean operation on two solids, the facets of the first solid on shared planes move away from these
planes by a gap. The gap is large compared with rounding, but smaller than manifold3d's tolerance, so manifold3d merges
the vertices on the two sides of a gap. Before the next Boolean operation, and after the last operation, the vertices of
the result are snapped onto the planes again.

- Before A + B, the solid A grows by the gap. Coincident faces of A and B with the same orientation then belong to A,
  and coincident faces with opposite orientations vanish.
- Before A - B and A * B, the solid A shrinks by the gap. If A and B have coincident faces with the same orientation,
  then A - B is open at these faces, and in A * B these faces belong to A. If A and B only touch, no film remains.

Therefore the first primitive in the CSG tree owns a face that several primitives have in common. The result of a
Boolean operation is regularized (Requicha and Voelcker 1985): the result has no films and no dangling faces. The facets
of coincident curved faces are separated as plane facets are, because all solids on one quadric have the same facets
(see :mod:`.leaves`).

Two surfaces that are equal in the scene language differ by the rounding of transforms and of decimal fractions.
Therefore the equations of two surfaces are compared in the space of one of the two primitives, where rounding errors
are small and visible differences are large.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from manifold3d import Manifold, Mesh64

from .grouping import components

SAME = 1e-7  # tolerance of a quadric's coefficients in a primitive's own space
ROUNDING = 1e-8  # surfaces that are taken for equal and differ by more cause a warning
NEAR = 1e-6  # tolerance of the coefficients in the scene's space, which selects the surfaces to compare


def same_surfaces(
    quadrics: np.ndarray, matrices: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, tuple[float, int, int]]:
    """Returns, for each of n faces, the number of a face that represents all faces connected with this face: the face
    of the largest primitive. Also returns the difference and the numbers of the two connected faces that differ most;
    if none differ by more than ROUNDING, the difference is 0.

    Two faces are connected if their surfaces are equal and their boxes touch, or by way of other faces. The surface of
    face i is the quadric ``quadrics[i]`` (n, 4, 4) in the space of the primitive of face i. ``matrices[i]`` (n, 4, 4)
    maps the space of this primitive to the world. The box of face i in the world has the corners ``low[i]`` and
    ``high[i]`` (n, 3). A face that represents other faces also represents itself.
    """
    sizes = np.linalg.norm(matrices[:, :3, :3], axis=(1, 2))
    features, inverse = _features(quadrics, matrices), np.linalg.inv(matrices[:, :3, :3])
    worst = 0.0, 0, 0

    def equal(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        nonlocal worst
        large = np.where(sizes[first] < sizes[second], second, first)
        small = first + second - large
        relative = np.zeros((len(small), 4, 4))  # from the space of the small primitive to that of the large one
        relative[:, :3, :3] = inverse[large] @ matrices[small, :3, :3]
        relative[:, :3, 3:] = inverse[large] @ (matrices[small] - matrices[large])[:, :3, 3:]
        relative[:, 3, 3] = 1
        compared = np.stack([relative.transpose(0, 2, 1) @ quadrics[large] @ relative, quadrics[small]])
        compared /= np.linalg.norm(compared, axis=(2, 3), keepdims=True)
        difference = np.abs(compared[0] - compared[1]).max(axis=(1, 2))
        for i in np.flatnonzero((difference > ROUNDING) & (difference < SAME)).tolist():
            worst = max(worst, (float(difference[i]), int(first[i]), int(second[i])))
        return np.asarray(difference < SAME)

    # An offset along x separates the boxes of different surfaces, so one call finds the components of all surfaces.
    offset = np.outer(_clusters(features) * 2 * np.ptp([low[:, 0], high[:, 0]]), [1, 0, 0])
    group = components(low + offset, high + offset, equal)
    order = np.argsort(-sizes, kind="stable")
    _, largest = np.unique(group[order], return_index=True)
    _, number = np.unique(group, return_inverse=True)
    return order[largest][number], worst


def _features(quadrics: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """Returns the 10 coefficients of the quadric of each surface (n, 10), in a space in which the scene has about the
    size 1. Equal surfaces have equal coefficients, except for rounding.
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
    """Returns a label for each row of a table: rows that differ by at most NEAR in every column have the same label, as
    their projections on a line are near; few others have, because the line is parallel to nothing.
    """
    direction = np.sin(np.arange(1, rows.shape[1] + 1))
    projections = rows @ direction
    order, label = np.argsort(projections), np.zeros(len(rows), int)
    label[order[1:]] = np.cumsum(np.diff(projections[order]) > NEAR * np.abs(direction).sum())
    return label


THICKNESS = 2.0**-26  # the largest distance of coincident facets, relative to the scene's size (a power of two)
#: The gap between coincident facets in an operation, relative to manifold3d's tolerance, which is 1e-12 of the size of
#: the solids. Facets on both sides of three planes move apart by less than the tolerance.
GAP = 1 / 8


class Facets(NamedTuple):
    """The k triangles of a solid that lie on planes that several solids share.

    ``vertices`` (n, 3) are all vertices of the solid. ``corners`` (k, 3) has the numbers of the vertices of each
    triangle. ``plane`` (k,) is the number of the shared plane on which each triangle lies. ``side`` (k,) is 1 if the
    outward normal of the triangle is the normal of its plane, and -1 if the outward normal is opposite to the normal of
    the plane.
    """

    vertices: np.ndarray
    corners: np.ndarray
    plane: np.ndarray
    side: np.ndarray


class Planes:
    """The planes that facets of several solids share.

    Each row of ``planes`` (n, 4) is the unit normal n and the offset d of a plane n.p + d = 0. Facet f lies on the
    plane with the number ``of_facet[f]``, which is -1 if facet f lies on no shared plane. The outward normal of facet f
    is ``side[f]`` (1 or -1) times the normal of the plane ``of_facet[f]``.
    """

    def __init__(self, triangles: np.ndarray, facets: np.ndarray, surface: np.ndarray, rank: np.ndarray) -> None:
        """Computes the planes on which ``triangles`` (m, 3, 3) lie. ``facets`` (m,) has the number of the facet to
        which each triangle belongs.

        ``surface`` (n,) has, for each facet, the number of the surface on which the facet lies. ``rank`` (n,) has, for
        each facet, the rank of the facet's face. All faces on one surface have the same number of facets. The i-th
        facets of all faces on one surface get the same plane: the plane of the i-th facet of the face with the lowest
        rank.
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
        self.planes = own[first]
        self.of_facet, self.side = np.full(len(surface), -1), np.ones(len(surface))
        self.of_facet[shared] = plane
        self.side[shared] = np.sign(np.einsum("ij,ij->i", own[:, :3], own[first[plane], :3]))

    def separate(self, first: Manifold, second: Manifold, outwards: int) -> list[Manifold]:
        """Returns the two solids with a gap, :data:`GAP` times manifold3d's tolerance, between facets on common planes:
        the facets of the first solid move outwards (1) or inwards (-1); those of the second lie exactly on the planes.
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
        mesh = solid.to_mesh64()
        facets = np.asarray(mesh.face_id, dtype=np.int64)
        on = self.of_facet[facets] >= 0
        facets, corners = facets[on], np.asarray(mesh.tri_verts, dtype=np.int64)[on]
        vertices = np.array(mesh.vert_properties)[:, :3]
        return Facets(vertices, corners, self.of_facet[facets], self.side[facets] * signs(mesh)[on])

    def _moved(self, solid: Manifold, facets: Facets, heights: np.ndarray) -> Manifold:
        points = self._points_at(facets.vertices, facets.corners, facets.plane, heights)
        return solid if np.array_equal(points, facets.vertices) else solid.warp_batch(lambda _: points)

    def snap_vertices(self, vertices: np.ndarray, triangles: np.ndarray, facets: np.ndarray) -> np.ndarray:
        """Returns ``vertices`` moved onto the planes of all ``facets`` (m,) of the ``triangles`` (m, 3)."""
        return self._points_at(vertices, triangles, self.of_facet[facets], np.zeros(len(facets)))

    def _points_at(self, points: np.ndarray, corners: np.ndarray, plane: np.ndarray, heights: np.ndarray) -> np.ndarray:
        """Returns the ``points`` (n, 3); those points that are corners of k triangles are moved to given distances from
        the planes of the triangles.

        ``corners`` (k, 3) has the numbers of the points that are the corners of each triangle. ``plane`` (k,) is the
        number of the plane of each triangle, and ``heights`` (k,) are signed distances from the planes. A point moves
        by the shortest vector that leads to the given distances from all its planes. If triangles of one plane have
        different heights, a common corner of these triangles moves to the mean of the smallest and the largest height.
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
    """Returns a value for each triangle, from the ``values`` of the runs of the original meshes."""
    ends = np.asarray(mesh.run_index, dtype=np.int64) // 3
    return np.repeat(values, ends[1:] - ends[:-1])


def signs(mesh: Mesh64) -> np.ndarray:
    """Returns a sign for each triangle of a mesh: -1 if the triangle comes from a subtracted solid and so has a normal
    that points into this solid, and otherwise 1.
    """
    return per_triangle(mesh, 1 - 2 * (np.asarray(mesh.run_flags, dtype=np.int64) & 1))


def _planes(triangles: np.ndarray, facet: np.ndarray) -> np.ndarray:
    a, b, c = np.moveaxis(triangles, 1, 0)
    cross = np.cross(b - a, c - a)
    weight = np.linalg.norm(cross, axis=1)
    middles = weight[:, None] * (a + b + c) / 3
    normal = np.stack([np.bincount(facet, cross[:, i]) for i in range(3)], axis=1)
    middle = np.stack([np.bincount(facet, middles[:, i]) for i in range(3)], axis=1)
    unit = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    offset = np.einsum("ij,ij->i", unit, middle / np.maximum(np.bincount(facet, weight), 1e-300)[:, None])
    return np.append(unit, -offset[:, None], axis=1)
