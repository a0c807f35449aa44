"""Coincident faces: solids that have planes in common are moved apart before an operation, and back together after it.

Where two faces lie on the same plane but for rounding, an operation on their meshes leaves films of no thickness, and
faces of the wrong owner, at the whim of the last digit. So every facet that lies on a surface that several primitives have
in common is given the number of its plane, and the vertices are brought onto these planes. Before an operation the first
solid's facets on the planes that it has in common with the second are moved by a distance that is large against rounding
and small against all else, and afterwards all go back:

- in A + B, A grows: faces to the same side become A's, touching ones are swallowed;
- in A - B and A * B, A shrinks: a flush cut goes through, touching ones leave no film, and faces to the same side (of A
  and of what is kept of it) become A's.

So the primitive that stands first in the tree wins, as Requicha and Voelcker (1985) regularize: no film, no dangling face.
Facets of curved faces are treated likewise; those of one quadric are the same for all its bearers, see :mod:`.leaves`.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from manifold3d import Manifold

from .primitives import Mesh

STEP = 2.0**-32  # of the scene's size; manifold3d takes 1e-12 of it for rounding


class Planes:
    """The planes that facets have in common.

    ``planes`` (n, 4) are unit normals and offsets, n.p + d = 0; ``surface`` (n,) is the number of the surface that a plane
    is (a part of). A facet with the number f lies on the plane ``of_facet[f]``, on none that is shared where that is -1,
    and looks to the side ``side[f]`` of it (1 or -1). ``step`` is the distance by which solids are moved apart.
    """

    def __init__(self, planes: np.ndarray, surface: np.ndarray, of_facet: np.ndarray, side: np.ndarray, step: float) -> None:
        self.planes, self.surface, self.of_facet, self.side, self.step = planes, surface, of_facet, side, step

    def apart(self, solid: Manifold, surfaces: Iterable[int], outwards: int) -> Manifold:
        """A solid whose facets on some surfaces are moved by a step, outwards or (-1) inwards."""
        return self._moved(solid, surfaces, outwards * self.step)

    def together(self, solid: Manifold, surfaces: Iterable[int]) -> Manifold:
        """A solid with its vertices brought back onto their planes, as far as they lie on some surfaces."""
        return self._moved(solid, surfaces, 0.0)

    def adjusted(self, mesh: Mesh, first: int) -> Mesh:
        """A primitive's mesh, whose facets are numbered from ``first``, with its vertices brought onto their planes."""
        plane = self.of_facet[first + mesh.facets]
        pairs = np.unique((mesh.triangles * len(self.planes) + plane[:, None])[plane >= 0])
        vertex, on = np.divmod(pairs, len(self.planes))
        return replace(mesh, vertices=self.onto(mesh.vertices.copy(), vertex, on, 0.0))

    def _moved(self, solid: Manifold, surfaces: Iterable[int], step: float) -> Manifold:
        mesh = solid.to_mesh64()
        facets = np.asarray(mesh.face_id, dtype=np.int64)
        plane, shift = self.of_facet[facets], step * self.side[facets]
        flags = np.asarray(mesh.run_flags, dtype=np.int64) & 1  # 1: the back side, of a solid that was taken away
        runs = np.asarray(mesh.run_index, dtype=np.int64) // 3
        shift = np.where(np.repeat(flags, runs[1:] - runs[:-1]) == 1, -shift, shift)
        concerned = np.isin(self.surface, list(surfaces))
        chosen = (plane >= 0) & concerned[plane]
        triangles = np.asarray(mesh.tri_verts, dtype=np.int64)
        if not chosen.any():
            return solid
        touched = np.zeros(solid.num_vert(), bool)
        touched[triangles[chosen]] = True
        near = (plane >= 0) & touched[triangles].any(axis=1)
        pairs = triangles[near].ravel() * len(self.planes) + np.repeat(plane[near], 3)
        shifts = np.repeat(np.where(chosen, shift, 0.0)[near], 3)
        pairs, first = np.unique(pairs, return_index=True)
        vertex, on = np.divmod(pairs, len(self.planes))
        kept = touched[vertex]

        def warp(points: np.ndarray) -> np.ndarray:
            return self.onto(np.array(points), vertex[kept], on[kept], shifts[first][kept])

        return solid.warp_batch(warp)

    def onto(self, points: np.ndarray, vertex: np.ndarray, plane: np.ndarray, shift: np.ndarray | float) -> np.ndarray:
        """Points moved as little as possible so that point ``vertex[i]`` has the height ``shift[i]`` over ``plane[i]``."""
        touched, index = np.unique(vertex, return_inverse=True)
        normal, offset = self.planes[plane, :3], self.planes[plane, 3]
        height = shift - (np.einsum("ij,ij->i", normal, points[vertex]) + offset)
        normals = np.zeros((len(touched), 3, 3))  # sums of n n^T
        heights = np.zeros((len(touched), 3, 1))
        for i in range(3):
            heights[:, i, 0] = np.bincount(index, normal[:, i] * height)
            for j in range(3):
                normals[:, i, j] = np.bincount(index, normal[:, i] * normal[:, j])
        # The least of the least squares' solutions (Tikhonov): few planes leave directions free, many meet in one point.
        points[touched] += np.linalg.solve(normals + 1e-12 * np.eye(3), heights)[..., 0]
        return points
