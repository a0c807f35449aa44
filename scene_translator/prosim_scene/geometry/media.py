"""The boundaries between media: opaque solids, dielectrics and air.

A medium is a number: OPAQUE, or one for each kind of dielectric. Each pair of a leaf and a medium has an original id,
which manifold3d propagates to the triangles of the result.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .coincidence import per_triangle, signs
from .csg import Body, checked, combined, remainder
from .primitives import Mesh

OPAQUE = 0
AIR = -1


@dataclass
class Boundary:
    """Triangles of a result: ``vertices`` (n, 3), ``triangles`` (m, 3), and for each triangle the number of its
    ``leaf`` and of its ``facet``, and a ``sign``, -1 on a subtracted primitive. ``inside`` and ``outside`` (m,) are the
    media on its two sides; its normal points to ``outside``.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    leaf: np.ndarray
    facet: np.ndarray
    sign: np.ndarray
    inside: np.ndarray
    outside: np.ndarray

    def chosen(self, which: np.ndarray | slice) -> Boundary:
        """The triangles that an index array, a mask or a slice selects."""
        arrays = (self.triangles, self.leaf, self.facet, self.sign, self.inside, self.outside)
        return Boundary(self.vertices, *(column[which] for column in arrays))

    def reversed_side(self, outside: int) -> Boundary:
        """The boundary with reversed orientation, and a medium outside."""
        return replace(
            self, triangles=self.triangles[:, ::-1], sign=-self.sign, outside=np.full_like(self.outside, outside)
        )


def primitive_boundary(mesh: Mesh, leaf: int, first: int, medium: int) -> Boundary:
    """The boundary of a primitive that touches no other; ``first`` is the number of its first facet."""
    numbers = (np.full(len(mesh.triangles), number) for number in (leaf, 1, medium, AIR))
    leaves, sign, inside, outside = numbers
    return Boundary(mesh.vertices, mesh.triangles, leaves, first + mesh.facets, sign, inside, outside)


def concatenated(boundaries: Sequence[Boundary]) -> Boundary:
    """The triangles of all ``boundaries``, which are not empty."""
    if len(boundaries) == 1:
        return boundaries[0]
    starts = np.cumsum([0, *(len(b.vertices) for b in boundaries)])
    triangles = np.concatenate([b.triangles + first for b, first in zip(boundaries, starts)])
    arrays = zip(*((b.vertices, b.leaf, b.facet, b.sign, b.inside, b.outside) for b in boundaries))
    vertices, *others = map(np.concatenate, arrays)
    return Boundary(vertices, triangles, *others)


class Ids:
    """The original ids of pairs of a leaf and a medium: numbers from ``base``, ``leaves`` of them for each medium."""

    def __init__(self, base: int, leaves: int) -> None:
        self.base, self.leaves = base, leaves

    def of(self, leaf: int, medium: int) -> int:
        """The id of a leaf's faces in the solid of a medium."""
        return self.base + medium * self.leaves + leaf

    def boundary(self, body: Body) -> Boundary:
        """The triangles of a body, with the medium of their id inside and air outside."""
        mesh = checked(body.planes.snap(checked(body.manifold), body.surfaces)).to_mesh64()
        ids = per_triangle(mesh, np.asarray(mesh.run_original_id, dtype=np.int64))
        medium, leaf = np.divmod(ids - self.base, self.leaves)
        return Boundary(
            np.array(mesh.vert_properties)[:, :3],
            np.array(mesh.tri_verts, dtype=np.int64),
            leaf,
            np.asarray(mesh.face_id, dtype=np.int64),
            signs(mesh),
            medium,
            np.full_like(medium, AIR),
        )


def boundaries(bodies: dict[int, Body], ids: Ids, fresnel: Collection[int]) -> list[Boundary]:
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
        if checked(body.manifold).is_empty():
            continue
        neighbours = [other for other, _ in layers if other != OPAQUE or fresnel]
        if total and neighbours:
            found = ids.boundary(remainder(total, body))
            for other in neighbours:
                face = found.chosen(found.inside == other)
                interfaces[other] += [face.reversed_side(medium)] if len(face.leaf) else []
        total = combined("+", total, body) if total else body
        layers.append((medium, total))
    result: list[Boundary] = []
    for medium, body in layers:
        width = 2 * body.planes.step
        touched = any(  # beyond seams of no width
            (
                (heights(face.vertices[face.triangles]) > width)
                & (medium != OPAQUE or np.isin(face.leaf, list(fresnel)))
            ).any()
            for face in interfaces[medium]
        )
        assert total
        found = ids.boundary(total if touched else body)
        result.append(found.chosen(found.inside == medium))
        result += interfaces[medium] * touched
    return result


def heights(triangles: np.ndarray) -> np.ndarray:
    """Heights of triangles (n, 3, 3) over their longest sides; about 0 in a seam of coincident faces."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    longest = np.sqrt(np.max([np.sum(d * d, axis=1) for d in (b - a, c - b, a - c)], axis=0))
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / np.maximum(longest, 1e-300))
