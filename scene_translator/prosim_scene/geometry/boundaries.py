"""Computes the boundaries between media: opaque solids, dielectrics (such as glass) and air.

A medium is represented by a number: OPAQUE, AIR, or the number of a kind of dielectric. Each pair of a leaf of the CSG
tree and a medium has an original id, which is manifold3d's number for the mesh of an operand. manifold3d copies the
original id of a triangle of an operand to the triangles of the result.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .coincidence import per_triangle, signs
from .csg import Body, checked, remainder, union
from .primitives import Mesh

OPAQUE = 0
AIR = -1


#: A triangle of a result: the numbers of its vertices (``index``), of its leaf and of its facet; ``sign``, which is -1
#: if the triangle's normal is opposite to the outward normal of the leaf's primitive, and otherwise 1; the media on its
#: two sides. The triangle's normal points to the medium ``outside``.
TRIANGLE = np.dtype([("index", "i4", 3), *((name, "i4") for name in ("leaf", "facet", "sign", "inside", "outside"))])


class Boundary(NamedTuple):
    """The surface of a solid: ``vertices`` (n, 3), and ``triangles``, a structured array of type TRIANGLE."""

    vertices: np.ndarray
    triangles: np.ndarray

    @classmethod
    def from_columns(cls, vertices: np.ndarray, **columns: np.ndarray | int) -> Boundary:
        """Returns a boundary whose triangles have the fields ``columns``."""
        triangles = np.empty(len(np.asarray(columns["index"])), TRIANGLE)
        for name, values in columns.items():
            triangles[name] = values
        return cls(vertices, triangles)


def primitive_boundary(mesh: Mesh, leaf: int, first: int, medium: int) -> Boundary:
    """Returns the boundary of a leaf that touches no other; ``first`` is the number of its first facet."""
    columns = {"index": mesh.triangles, "facet": first + mesh.facets}
    return Boundary.from_columns(mesh.vertices, leaf=leaf, sign=1, inside=medium, outside=AIR, **columns)


def concatenated(boundaries: Sequence[Boundary]) -> Boundary:
    """Returns one boundary that contains the vertices and the triangles of all ``boundaries``."""
    if len(boundaries) == 1:
        return boundaries[0]  # saves the memory of a copy
    starts = np.cumsum([0, *(len(part.vertices) for part in boundaries)])[:-1]
    triangles = np.concatenate([np.empty(0, TRIANGLE), *(part.triangles for part in boundaries)], dtype=TRIANGLE)
    triangles["index"] += np.repeat(starts, np.array([len(part.triangles) for part in boundaries], int))[:, None]
    return Boundary(np.concatenate([np.empty((0, 3)), *(part.vertices for part in boundaries)]), triangles)


class OriginalIds:
    """The original ids (manifold3d's numbers of meshes) of all pairs of a leaf and a medium: consecutive numbers, which
    start at ``base``. Each medium has ``leaves`` ids, one for each leaf of the CSG tree.
    """

    def __init__(self, base: int, leaves: int) -> None:
        self.base, self.leaves = base, leaves

    def id_of(self, leaf: int, medium: int) -> int:
        """Returns the original id of the faces that a leaf has in the solid of a medium."""
        return self.base + medium * self.leaves + leaf

    def boundary(self, body: Body) -> Boundary:
        """Returns the boundary between a body and air, with facets moved exactly onto planes that solids share."""
        mesh = checked(body.planes.snap(body.manifold()), body.leaf).to_mesh64()
        ids = per_triangle(mesh, np.asarray(mesh.run_original_id, dtype=np.int64))
        medium, leaf = np.divmod(ids - self.base, self.leaves)
        return Boundary.from_columns(
            np.array(mesh.vert_properties)[:, :3],
            index=np.asarray(mesh.tri_verts, dtype=np.int64),
            leaf=leaf,
            facet=np.asarray(mesh.face_id, dtype=np.int64),
            sign=signs(mesh),
            inside=medium,
            outside=AIR,
        )


def boundaries(bodies: dict[int, Body], ids: OriginalIds, fresnel: bool) -> list[Boundary]:
    """Returns the surfaces to render, one list for all media. ``bodies`` has the solid of each medium.

    Where solids of several media overlap, the medium with the lowest number fills the overlap. Opaque solids have the
    medium number 0. Dielectric media are numbered in the order in which they first occur in the CSG tree. Therefore
    opaque solids cut a dielectric, and so do dielectrics with lower numbers. An opaque solid keeps its whole surface. A
    dielectric keeps the part of its surface that lies on the boundary of the union of the dielectric and all media with
    lower numbers. Where a second dielectric with a higher number touches the kept surface of a dielectric, the surface
    is an interface between the two dielectrics. ``fresnel`` is whether opaque solids reflect by Fresnel's equations. If
    ``fresnel``, the surface of an opaque solid is an interface where a dielectric touches the opaque solid. Each
    interface exists exactly once in the result. Every ray that leaves a dielectric crosses the dielectric's own surface
    or an interface.
    """
    total: Body | None = None
    layers: list[tuple[int, Body]] = []  # each medium, and the union of this medium and all media with lower numbers
    interfaces: dict[int, list[Boundary]] = {medium: [] for medium in bodies}
    for medium, body in sorted(bodies.items()):
        if body.manifold().is_empty():
            continue
        neighbours = [other for other, _ in layers if other != OPAQUE or fresnel]
        if total and neighbours:
            boundary = ids.boundary(remainder(total, body))
            for other in neighbours:
                faces = boundary.triangles[boundary.triangles["inside"] == other]
                faces["index"], faces["sign"], faces["outside"] = faces["index"][:, ::-1], -faces["sign"], medium
                interfaces[other] += [Boundary(boundary.vertices, faces)] if len(faces) else []
        total = union([total, body]) or body
        layers.append((medium, total))
    result: list[Boundary] = []
    for medium, body in layers:
        boundary = ids.boundary(total if total and interfaces[medium] else body)
        result.append(Boundary(boundary.vertices, boundary.triangles[boundary.triangles["inside"] == medium]))
        result += interfaces[medium]
    return result


def heights(triangles: np.ndarray) -> np.ndarray:
    """Returns the heights of triangles (n, 3, 3) over their longest sides; about 0 for a sliver."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    longest = np.sqrt(np.max([np.sum(d * d, axis=1) for d in (b - a, c - b, a - c)], axis=0))
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / np.maximum(longest, 1e-300))
