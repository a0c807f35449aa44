"""Coincident faces: common planes are perturbed before a Boolean operation, relaxed after it, and snapped at the end.

If two faces lie on the same plane except for rounding, an operation on their meshes leaves films without thickness, and
faces of the wrong owner. So every facet on a surface that several primitives share has the number of its plane, and its
vertices are snapped onto that plane. Before an operation the first solid's facets on common planes are perturbed: they
move by a distance that is large against rounding and small against everything else. After the operation they are
relaxed, almost back to their places. The final result is snapped onto the planes:

- in A + B, A grows: faces that look to the same side belong to A, faces that look to opposite sides vanish;
- in A - B and A * B, A shrinks: a flush cut is open, faces that touch leave no film, and faces that look to the same
  side belong to A.

So the first primitive in the tree owns a common face, and the result is regularized (Requicha and Voelcker 1985): it
has no film and no dangling face. Facets of curved faces are treated in the same way; all solids on one quadric have the
same facets, see :mod:`.leaves`.

Equal surfaces differ by the rounding of transforms and of decimal fractions. Their equations are compared in the space
of one of the two primitives, where rounding is small and a visible difference is large.
"""

from __future__ import annotations

from collections.abc import Callable, Collection

import numpy as np
from manifold3d import Manifold, Mesh64

SAME = 1e-7  # tolerance of a quadric's coefficients in a primitive's own space
NEAR = 1e-6  # tolerance of its coefficients in the scene's space, at first; only surfaces within it are compared


def same_surfaces(quadrics: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """Returns a representative of each of n surfaces: the number of the equal surface that belongs to the largest
    primitive.

    Surface i is the quadric ``quadrics[i]`` (n, 4, 4) in the space of a primitive, which ``matrices[i]`` (n, 4, 4) maps
    to the world. A representative represents itself.
    """
    sizes = np.linalg.norm(matrices[:, :3, :3], axis=(1, 2))
    features, near = _features(quadrics, matrices), NEAR
    order = np.argsort(-sizes, kind="stable")
    result = np.full(len(quadrics), -1)
    canonical = quadrics / np.linalg.norm(quadrics, axis=(1, 2), keepdims=True)
    while len(order):  # each round finds, in each cluster, the surface of the largest primitive
        _, first, cluster = np.unique(_clusters(features[order], near), return_index=True, return_inverse=True)
        near /= 2  # the next round splits clusters of many different surfaces
        representative = order[first][cluster]
        inverse = np.linalg.inv(matrices[order[first], :3, :3])[cluster]
        relative = np.zeros((len(order), 4, 4))  # from the space of each primitive to the space of the representative
        relative[:, :3, :3] = inverse @ matrices[order, :3, :3]
        relative[:, :3, 3:] = inverse @ (matrices[order] - matrices[representative])[:, :3, 3:]
        relative[:, 3, 3] = 1
        transformed = relative.transpose(0, 2, 1) @ quadrics[representative] @ relative
        transformed /= np.linalg.norm(transformed, axis=(1, 2), keepdims=True)
        same = np.abs(transformed - canonical[order]).max(axis=(1, 2)) < SAME
        same |= order == representative
        result[order[same]] = representative[same]
        order = order[~same]
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


def _clusters(rows: np.ndarray, near: float) -> np.ndarray:
    """Labels the rows of an array: rows that differ by less than ``near`` in every column have the same label."""
    label = np.zeros(len(rows), int)
    count = 0
    while count < label.max() + 1:
        count = label.max() + 1
        for column in rows.T:
            order = np.lexsort([column, label])
            new = (np.diff(label[order]) != 0) | (np.diff(column[order]) > near)
            label[order] = np.concatenate([[0], np.cumsum(new)])
    return label


STEP = 2.0**-26  # of the scene's size (a power of two): the perturbation, below single precision
GRAIN = 2.0**-36  # of the same size: the distance of relaxed facets; manifold3d's tolerance is 1e-12

#: Heights of facets over their planes, and the sides that they face -> new heights.
Target = Callable[[np.ndarray, np.ndarray], np.ndarray]


class Planes:
    """The planes that facets share.

    ``planes`` (n, 4) are unit normals and offsets of planes n.p + d = 0. ``surface`` (n,) is the number of the surface
    to which each plane belongs. Facet f lies on the plane ``of_facet[f]`` (-1: on no shared plane), and faces the side
    ``side[f]`` (1 or -1) of this plane. ``step`` is the distance of a perturbation.
    """

    def __init__(
        self, triangles: np.ndarray, facets: np.ndarray, surface: np.ndarray, rank: np.ndarray, step: float
    ) -> None:
        """Computes the planes of the ``facets`` (m,) of ``triangles`` (m, 3, 3).

        ``surface`` (n,) is the surface of each facet, ``rank`` (n,) the rank of the face of each facet. Faces on one
        surface have the same planes, facet by facet: the planes of the face with the lowest rank.
        """
        some = np.unique(facets)
        some = some[np.argsort(rank[some], kind="stable")]
        begins = np.flatnonzero(np.diff(rank[some], prepend=-1))  # of faces
        within = np.arange(len(some)) - np.repeat(begins, np.diff(np.append(begins, len(some))))
        keys = surface[some] * (within.max(initial=0) + 1) + within
        _, first, plane = np.unique(keys, return_index=True, return_inverse=True)
        at = np.empty(len(surface), int)
        at[some] = np.arange(len(some))
        own = _planes(triangles, at[facets])
        self.planes, self.surface, self.step, self.grain = own[first], surface[some[first]], step, step * GRAIN / STEP
        self.of_facet, self.side = np.full(len(surface), -1), np.ones(len(surface))
        self.of_facet[some] = plane
        self.side[some] = np.sign(np.einsum("ij,ij->i", own[:, :3], own[first[plane], :3]))

    def perturb(self, solid: Manifold, surfaces: Collection[int], outwards: int) -> Manifold:
        """A solid with its facets on ``surfaces`` moved by one step, outwards (1) or inwards (-1)."""
        return self._moved(solid, surfaces, lambda height, side: height + outwards * self.step * side)

    def relax(self, solid: Manifold, surfaces: Collection[int]) -> Manifold:
        """The result of an operation on a perturbed solid, with its facets moved back, but still in their order.

        Strips between moved and unmoved facets keep a width, because manifold3d may remove triangles without area.
        """

        def target(height: np.ndarray, side: np.ndarray) -> np.ndarray:
            moved = np.abs(height) > self.step / 2
            drift = np.abs(height[~moved]).max(initial=0.0)
            shortfall = self.step - np.abs(height[moved]).min(initial=np.inf)
            back = self.step - self.grain - drift - max(shortfall, 0.0)
            if drift > self.step / 4 or back < self.step / 2:
                return np.zeros_like(height)  # after hundreds of operations on one plane
            return np.where(moved, height - back * np.sign(height), height)

        return self._moved(solid, surfaces, target)

    def snap(self, solid: Manifold, surfaces: Collection[int]) -> Manifold:
        """A solid with the vertices of its facets on ``surfaces`` snapped onto their planes."""
        return self._moved(solid, surfaces, lambda height, side: np.zeros_like(height))

    def snap_vertices(self, vertices: np.ndarray, triangles: np.ndarray, facets: np.ndarray) -> np.ndarray:
        """Vertices (n, 3) snapped onto the planes of the ``facets`` (m,) of their ``triangles`` (m, 3)."""
        if not len(facets):
            return vertices
        pairs = np.unique(triangles * len(self.planes) + self.of_facet[facets, None])
        return self.move_points(vertices, *np.divmod(pairs, len(self.planes)), 0.0)

    def one_sided(self, surfaces: Collection[int], boxes: np.ndarray) -> bool:
        """Whether all ``boxes``, see :class:`.Body`, are certainly on one side of each of the ``surfaces``."""
        planes = self.planes[np.isin(self.surface, list(surfaces))]
        if len(planes) > len(surfaces):  # a curved surface
            return False
        height = boxes[:, 2:].reshape(-1, 3) @ planes[:, :3].T + planes[:, 3]
        return bool(((height <= 8 * self.step).all(axis=0) | (height >= -8 * self.step).all(axis=0)).all())

    def hold(self, solid: Manifold) -> bool:
        """Whether each facet of a solid on a shared plane is parallel to it."""
        mesh = solid.to_mesh64()
        plane = self.of_facet[np.asarray(mesh.face_id, dtype=np.int64)]
        corners = np.array(mesh.vert_properties)[np.asarray(mesh.tri_verts, dtype=np.int64)[plane >= 0], :3]
        heights = np.einsum("tij,tj->ti", corners, self.planes[plane[plane >= 0], :3])
        return bool((np.ptp(heights, axis=1) < 8 * self.step).all())

    def _moved(self, solid: Manifold, surfaces: Collection[int], target: Target) -> Manifold:
        """A solid with its facets on ``surfaces`` moved to new heights over their planes.

        ``target`` maps their present heights and sides to the new heights. Facets on other shared planes do not move.
        """
        if not surfaces:
            return solid
        mesh = solid.to_mesh64()
        facets = np.asarray(mesh.face_id, dtype=np.int64)
        plane, side = self.of_facet[facets], self.side[facets] * signs(mesh)
        selected_facets = (plane >= 0) & np.isin(self.surface[plane], list(surfaces))
        if not selected_facets.any():
            return solid
        triangles = np.asarray(mesh.tri_verts, dtype=np.int64)
        vertices = np.array(mesh.vert_properties)[:, :3]
        touched = np.zeros(len(vertices), bool)
        touched[triangles[selected_facets]] = True
        close = (plane >= 0) & touched[triangles].any(axis=1)
        triangles, plane, side, selected_facets = triangles[close], plane[close], side[close], selected_facets[close]
        height = (
            np.einsum("tij,tj->ti", vertices[triangles], self.planes[plane, :3]).mean(axis=1) + self.planes[plane, 3]
        )
        height[selected_facets] = target(height[selected_facets], side[selected_facets])
        pairs = triangles.ravel() * len(self.planes) + np.repeat(plane, 3)
        pairs, first = np.unique(pairs, return_index=True)
        vertex, on = np.divmod(pairs, len(self.planes))
        moving = touched[vertex]

        def warp(points: np.ndarray) -> np.ndarray:
            return self.move_points(np.array(points), vertex[moving], on[moving], height[first[moving] // 3])

        return solid.warp_batch(warp)

    def move_points(
        self, points: np.ndarray, vertex: np.ndarray, plane: np.ndarray, distance: np.ndarray | float
    ) -> np.ndarray:
        """Moves each point ``vertex[i]`` by the shortest way to the signed ``distance[i]`` from ``plane[i]``; changes
        ``points`` and returns it.
        """
        touched, index = np.unique(vertex, return_inverse=True)
        normal, offset = self.planes[plane, :3], self.planes[plane, 3]
        height = distance - (np.einsum("ij,ij->i", normal, points[vertex]) + offset)
        normals, heights = np.zeros((len(touched), 3, 3)), np.zeros((len(touched), 3, 1))
        np.add.at(normals, index, normal[:, :, None] * normal[:, None])
        np.add.at(heights, index, (normal * height[:, None])[:, :, None])
        # Tikhonov's regularisation: few planes leave directions free, more than three are overdetermined.
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
