"""The boundaries between media: opaque solids, dielectrics and air.

A medium is a number: OPAQUE, or one for each kind of dielectric. Each pair of a leaf and a medium has an original id,
which manifold3d propagates to the triangles of the result.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from .coincidence import per_triangle, signs
from .csg import Body, checked, combined, remainder
from .primitives import Mesh

OPAQUE = 0
AIR = -1


#: A triangle of a result: the numbers of its vertices, of its leaf and of its facet, a sign, -1 on a subtracted
#: primitive, and the media on its two sides; its normal points to ``outside``.
TRIANGLE = np.dtype([("index", "i4", 3), *((name, "i4") for name in ("leaf", "facet", "sign", "inside", "outside"))])


class Boundary(NamedTuple):
    """Triangles of a result: ``vertices`` (n, 3), and a table ``triangles`` of the type TRIANGLE."""

    vertices: np.ndarray
    triangles: np.ndarray

    @classmethod
    def from_columns(cls, vertices: np.ndarray, **columns: np.ndarray | int) -> Boundary:
        """The boundary with these columns of the table."""
        triangles = np.empty(len(np.asarray(columns["index"])), TRIANGLE)
        for name, values in columns.items():
            triangles[name] = values
        return cls(vertices, triangles)

    def reversed_side(self, outside: int) -> Boundary:
        """The boundary with reversed orientation, and a medium outside."""
        columns = {name: self.triangles[name] for name in ("leaf", "facet", "inside")}
        index, sign = self.triangles["index"][:, ::-1], -self.triangles["sign"]
        return Boundary.from_columns(self.vertices, index=index, sign=sign, outside=outside, **columns)


def primitive_boundary(mesh: Mesh, leaf: int, first: int, medium: int) -> Boundary:
    """The boundary of a primitive that touches no other; ``first`` is the number of its first facet."""
    columns = {"index": mesh.triangles, "facet": first + mesh.facets}
    return Boundary.from_columns(mesh.vertices, leaf=leaf, sign=1, inside=medium, outside=AIR, **columns)


def concatenated(boundaries: Sequence[Boundary]) -> Boundary:
    """The triangles of all ``boundaries``."""
    if len(boundaries) == 1:
        return boundaries[0]  # saves memory
    starts = np.cumsum([0, *(len(one.vertices) for one in boundaries)])[:-1]
    triangles = np.concatenate([np.empty(0, TRIANGLE), *(one.triangles for one in boundaries)], dtype=TRIANGLE)
    triangles["index"] += np.repeat(starts, np.array([len(one.triangles) for one in boundaries], int))[:, None]
    return Boundary(np.concatenate([np.empty((0, 3)), *(one.vertices for one in boundaries)]), triangles)


class OriginalIds:
    """The original ids of pairs of a leaf and a medium: numbers from ``base``, ``leaves`` of them for each medium."""

    def __init__(self, base: int, leaves: int) -> None:
        self.base, self.leaves = base, leaves

    def id_of(self, leaf: int, medium: int) -> int:
        """The id of a leaf's faces in the solid of a medium."""
        return self.base + medium * self.leaves + leaf

    def boundary(self, body: Body) -> Boundary:
        """The boundary of a body, snapped onto the shared planes. A triangle's id gives its leaf and medium."""
        mesh = checked(body.planes.snap(checked(body.manifold()), body.surfaces)).to_mesh64()
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


def boundaries(bodies: dict[int, Body], ids: OriginalIds, fresnel: Collection[int]) -> list[Boundary]:
    """The surfaces to render, of ``bodies`` by medium. A medium with a lower number has precedence.

    An opaque solid keeps its whole surface. A dielectric yields to opaque solids, and to dielectrics before it in the
    tree: its remaining surface is its part of the boundary of the union of all media up to it. So each interface exists
    exactly once, and every ray that leaves a dielectric crosses its own surface or an interface. The part of this
    surface that another dielectric touches becomes an interface between the two. ``fresnel`` are the opaque leaves that
    reflect by Fresnel's equations: the part that a dielectric touches becomes an interface too.
    """
    total: Body | None = None
    layers: list[tuple[int, Body]] = []  # a medium, and the union of all media up to it
    interfaces: dict[int, list[Boundary]] = {medium: [] for medium in bodies}
    for medium, body in sorted(bodies.items()):
        if checked(body.manifold()).is_empty():
            continue
        neighbours = [other for other, _ in layers if other != OPAQUE or fresnel]
        if total and neighbours:
            found = ids.boundary(remainder(total, body))
            for other in neighbours:
                face = Boundary(found.vertices, found.triangles[found.triangles["inside"] == other])
                interfaces[other] += [face.reversed_side(medium)] if len(face.triangles) else []
        total = combined("+", total, body) if total else body
        layers.append((medium, total))
    result: list[Boundary] = []
    for medium, body in layers:
        width = 2 * body.planes.step
        touched = any(  # beyond seams of no width
            (
                (heights(face.vertices[face.triangles["index"]]) > width)
                & (medium != OPAQUE or np.isin(face.triangles["leaf"], list(fresnel)))
            ).any()
            for face in interfaces[medium]
        )
        assert total
        found = ids.boundary(total if touched else body)
        result.append(Boundary(found.vertices, found.triangles[found.triangles["inside"] == medium]))
        result += interfaces[medium] * touched
    return result


def heights(triangles: np.ndarray) -> np.ndarray:
    """Heights of triangles (n, 3, 3) over their longest sides; about 0 in a seam of coincident faces."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    longest = np.sqrt(np.max([np.sum(d * d, axis=1) for d in (b - a, c - b, a - c)], axis=0))
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / np.maximum(longest, 1e-300))
