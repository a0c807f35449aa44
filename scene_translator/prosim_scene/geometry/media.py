"""How optics are kept: solids of different media are kept apart.

Media are numbers: the opaque one's, and one for every kind of dielectric. Every occurrence of a primitive has its own
id, which manifold3d carries to the triangles of the result.
"""

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from manifold3d import Manifold, Mesh64

from ..model import Leaf
from . import csg
from .csg import Body, Value, beneath, checked, combined
from .primitives import Mesh

OPAQUE = 0  # the medium of everything that is not a dielectric
AIR = -1  # what is outside of all


@dataclass
class Boundary:
    """Triangles of a result: ``vertices`` (n, 3), ``triangles`` (m, 3), and for each the original id of its primitive,
    the number of its facet, and a ``sign``, -1 where it is the surface of a primitive that was taken away.
    ``inside`` and ``outside`` (m,) are the media on the two sides of each triangle, the latter being where its normal
    points.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    ids: np.ndarray
    facets: np.ndarray
    sign: np.ndarray
    inside: np.ndarray
    outside: np.ndarray

    def between(self, inside: int, outside: int) -> "Boundary":
        """The same with these media on its sides."""
        return replace(self, inside=np.full(len(self.ids), inside), outside=np.full(len(self.ids), outside))

    def bearing(self, ids: np.ndarray, originals: np.ndarray) -> "Boundary":
        """The triangles that bear one of some ``ids``, which ascend, with the ``originals`` of these in their place."""
        at = np.searchsorted(ids, self.ids)
        chosen = np.flatnonzero(ids[np.minimum(at, len(ids) - 1)] == self.ids)
        triangles, facets, sign = self.triangles[chosen], self.facets[chosen], self.sign[chosen]
        sides = self.inside[chosen], self.outside[chosen]
        return Boundary(self.vertices, triangles, originals[at[chosen]], facets, sign, *sides)

    def turned(self) -> "Boundary":
        """Its back side."""
        return replace(
            self, triangles=self.triangles[:, ::-1], sign=-self.sign, inside=self.outside, outside=self.inside
        )


def whole(mesh: Mesh, original_id: int, first: int, medium: int) -> Boundary:
    """The surface of a primitive that nothing touches; its facets are numbered from ``first``."""
    count = len(mesh.triangles)
    ids, inside, outside = (np.full(count, number) for number in (original_id, medium, AIR))
    return Boundary(mesh.vertices, mesh.triangles, ids, first + mesh.facets, np.ones(count), inside, outside)


def cutters(nodes: csg.Nodes, media_of: list[int]) -> np.ndarray:
    """Which leaves may leave their faces on several media, which then coincide there: those that cut them at once."""
    result = np.zeros(len(media_of), bool)

    def leaf(number: int, _: Leaf) -> tuple[set[int], int, int]:
        return {media_of[number]}, number, number + 1

    def combine(
        symbol: str, first: tuple[set[int], int, int], second: tuple[set[int], int, int]
    ) -> tuple[set[int], int, int]:
        if symbol != "+" and len(first[0]) > 1:
            result[second[1] : second[2]] = True
        return first[0] | second[0] if symbol == "+" else first[0], first[1], second[2]

    csg.fold(nodes, leaf, combine)
    return result


@dataclass
class _Layer:
    """A medium: the ids of its faces and the original ones of these, the union of all media up to it, and where it
    touches later ones.
    """

    medium: int
    ids: np.ndarray
    originals: np.ndarray
    total: Body
    interfaces: list[Boundary]


def boundaries(value: Value, fresnel: Collection[int] = ()) -> list[Boundary]:
    """The surfaces to render. Media are numbers in their order of precedence, OPAQUE first.

    An opaque solid is bounded by its whole surface. A dielectric gives way to opaque solids, and to dielectrics that
    stand before it in the tree: of its surface there remains what bounds the union of all up to it. So every interface
    exists exactly once, and from inside a dielectric every way out leads through its own surface or onto another's.
    What another dielectric touches of this surface is an interface between the two. ``fresnel`` are the original ids of
    opaque primitives that reflect by Fresnel's equations: where a dielectric touches one, what it touches of the opaque
    solid is an interface too.
    """
    bodies = [(m, body) for m, body in sorted(value.items()) if not checked(body.manifold).is_empty()]
    if not bodies:
        return []
    (first, body), *others = bodies
    none = np.empty(0, np.int64)
    layers = [_Layer(first, none, none, body, [])]
    if others:
        layers[0].ids = layers[0].originals = np.unique(_ids(body))
    for medium, body in others:
        own, ids, originals = _renamed(body)
        total = layers[-1].total
        known = [layer for layer in layers if layer.medium != OPAQUE or fresnel]
        if known:
            boundary = _boundary(beneath(total, own))
            for layer in known:
                face = boundary.between(medium, layer.medium).bearing(layer.ids, layer.originals).turned()
                layer.interfaces += [face] if len(face.ids) else []
        layers.append(_Layer(medium, ids, originals, combined("+", total, own), []))
    result: list[Boundary] = []
    for layer in layers:
        width = 2 * layer.total.planes.step
        touched = any(  # and not in seams alone
            (
                (heights(face.vertices, face.triangles) > width)
                & (layer.medium != OPAQUE or np.isin(face.ids, list(fresnel)))
            ).any()
            for face in layer.interfaces
        )
        found = [_boundary((layers[-1] if touched else layer).total).between(layer.medium, AIR)]
        if touched or layer is not layers[0]:
            found = [boundary.bearing(layer.ids, layer.originals) for boundary in found]
        result += [boundary for boundary in found + layer.interfaces * touched if len(boundary.ids)]
    return result


def _ids(part: Body) -> list[int]:
    return [int(i) for i in part.manifold.to_mesh64().run_original_id]


def batches(boundaries: Iterable[Boundary], size: int) -> Iterator[Boundary]:
    """The same triangles in few boundaries: small ones are put together until they have ``size`` triangles."""
    waiting: list[Boundary] = []
    count = 0
    for boundary in boundaries:
        waiting.append(boundary)
        count += len(boundary.triangles)
        if count >= size:
            yield _joined(waiting)
            waiting, count = [], 0
    if waiting:
        yield _joined(waiting)


def _joined(boundaries: list[Boundary]) -> Boundary:
    begin = np.cumsum([0, *(len(b.vertices) for b in boundaries)])
    triangles = np.concatenate([b.triangles + first for b, first in zip(boundaries, begin)])
    columns = zip(*((b.vertices, b.ids, b.facets, b.sign, b.inside, b.outside) for b in boundaries))
    vertices, *others = map(np.concatenate, columns)
    return Boundary(vertices, triangles, *others)


def heights(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Heights of triangles (n, 3) over their longest sides: those in a seam of coincident faces have none."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    longest = np.sqrt(np.max([np.sum(d * d, axis=1) for d in (b - a, c - b, a - c)], axis=0))
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / np.maximum(longest, 1e-300))


def _boundary(part: Body) -> Boundary:
    mesh = checked(part.planes.snap(checked(part.manifold), part.surfaces)).to_mesh64()
    ends = np.asarray(mesh.run_index, dtype=np.int64) // 3
    runs = ends[1:] - ends[:-1]
    ids = np.repeat(np.asarray(mesh.run_original_id, dtype=np.int64), runs)
    nowhere = np.full(len(ids), AIR)
    return Boundary(
        np.array(mesh.vert_properties)[:, :3],
        np.array(mesh.tri_verts, dtype=np.int64),
        ids,
        np.asarray(mesh.face_id, dtype=np.int64),
        np.where(part.planes.backs(mesh), -1.0, 1.0),
        nowhere,
        nowhere,
    )


def _renamed(part: Body) -> tuple[Body, np.ndarray, np.ndarray]:
    """The parts with fresh ids, these in ascending order, and the old ones: tells one medium's triangles from another's
    even where one primitive has cut both.
    """
    mesh = part.manifold.to_mesh64()
    runs = len(mesh.run_original_id)
    base = Manifold.reserve_ids(runs)
    originals = np.array(mesh.run_original_id)
    flags = np.asarray(mesh.run_flags).tolist()  # of which manifold3d knows nothing in a mesh that is given to it
    part.planes.turned.update(i for i, flag in zip(range(base, base + runs), flags) if flag & 1)
    fresh = Mesh64(
        np.array(mesh.vert_properties, float),
        np.array(mesh.tri_verts, np.uint64),
        run_index=np.array(mesh.run_index, np.uint64),
        run_original_id=np.arange(base, base + runs, dtype=np.uint32),
        face_id=np.array(mesh.face_id, np.uint64),
    )
    return replace(part, manifold=Manifold(fresh)), np.arange(base, base + runs), originals
