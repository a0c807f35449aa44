"""The boundaries between media: opaque solids, dielectrics and air.

A medium is a number: OPAQUE, or one for each kind of dielectric. Each pair of a leaf and a medium has an original id,
which manifold3d carries to the triangles of the result.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .coincidence import per_triangle, signs
from .csg import Body, beneath, checked, combined
from .primitives import Mesh

OPAQUE = 0
AIR = -1


@dataclass
class Boundary:
    """Triangles of a result: ``vertices`` (n, 3), ``triangles`` (m, 3), and for each the number of its ``leaf``, of its
    ``facet``, and a ``sign``, -1 where it is the surface of a primitive that was taken away.
    ``inside`` and ``outside`` (m,) are the media on the two sides of each triangle, the latter being where its normal
    points.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    leaf: np.ndarray
    facet: np.ndarray
    sign: np.ndarray
    inside: np.ndarray
    outside: np.ndarray

    def chosen(self, which: np.ndarray | slice) -> Boundary:
        """The triangles with these numbers, or where this is true."""
        columns = (self.triangles, self.leaf, self.facet, self.sign, self.inside, self.outside)
        return Boundary(self.vertices, *(column[which] for column in columns))

    def turned(self, outside: int) -> Boundary:
        """Its back side, with a medium outside."""
        return replace(
            self, triangles=self.triangles[:, ::-1], sign=-self.sign, outside=np.full_like(self.outside, outside)
        )


def whole(mesh: Mesh, leaf: int, first: int, medium: int) -> Boundary:
    """The surface of a primitive that nothing touches; its facets are numbered from ``first``."""
    numbers = (np.full(len(mesh.triangles), number) for number in (leaf, 1, medium, AIR))
    leaves, sign, inside, outside = numbers
    return Boundary(mesh.vertices, mesh.triangles, leaves, first + mesh.facets, sign, inside, outside)


def joined(boundaries: Sequence[Boundary]) -> Boundary:
    """All triangles of boundaries, of which there is one at least."""
    if len(boundaries) == 1:
        return boundaries[0]
    begin = np.cumsum([0, *(len(b.vertices) for b in boundaries)])
    triangles = np.concatenate([b.triangles + first for b, first in zip(boundaries, begin)])
    columns = zip(*((b.vertices, b.leaf, b.facet, b.sign, b.inside, b.outside) for b in boundaries))
    vertices, *others = map(np.concatenate, columns)
    return Boundary(vertices, triangles, *others)


class Ids:
    """The original ids of leaves in the solids of media: numbers from ``base``, ``leaves`` of them for each medium."""

    def __init__(self, base: int, leaves: int) -> None:
        self.base, self.leaves = base, leaves

    def of(self, leaf: int, medium: int) -> int:
        """The id of a leaf's faces on the solid of a medium."""
        return self.base + medium * self.leaves + leaf

    def boundary(self, body: Body) -> Boundary:
        """The triangles of a body. Inside is the medium in their id, outside air."""
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


def boundaries(bodies: dict[int, Body | None], ids: Ids, fresnel: Collection[int]) -> list[Boundary]:
    """The surfaces to render, of ``bodies`` by their media. These are numbers in their order of precedence.

    An opaque solid is bounded by its whole surface. A dielectric gives way to opaque solids, and to dielectrics that
    stand before it in the tree: of its surface there remains what bounds the union of all up to it. So every interface
    exists exactly once, and from inside a dielectric every way out leads through its own surface or onto another's.
    What another dielectric touches of this surface is an interface between the two. ``fresnel`` are the opaque leaves
    that reflect by Fresnel's equations: where a dielectric touches one, what it touches of the opaque solid is an
    interface too.
    """
    total: Body | None = None
    layers: list[tuple[int, Body]] = []  # a medium, and the union of all up to it
    interfaces: dict[int, list[Boundary]] = {medium: [] for medium in bodies}
    for medium, body in sorted(bodies.items()):
        if body is None or checked(body.manifold).is_empty():
            continue
        known = [other for other, _ in layers if other != OPAQUE or fresnel]
        if total and known:
            found = ids.boundary(beneath(total, body))
            for other in known:
                face = found.chosen(found.inside == other)
                interfaces[other] += [face.turned(medium)] if len(face.leaf) else []
        total = combined("+", total, body) if total else body
        layers.append((medium, total))
    result: list[Boundary] = []
    for medium, body in layers:
        width = 2 * body.planes.step
        touched = any(  # and not in seams alone
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
    """Heights of triangles (n, 3, 3) over their longest sides: those in a seam of coincident faces have none."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    longest = np.sqrt(np.max([np.sum(d * d, axis=1) for d in (b - a, c - b, a - c)], axis=0))
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / np.maximum(longest, 1e-300))
