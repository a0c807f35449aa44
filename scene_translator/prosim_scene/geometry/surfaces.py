"""The triangles of the result, in one mesh for each material and pair of media, with normals and (u, v) of their
primitives.
"""

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np
from manifold3d import Manifold, Mesh64

from ..camera import Camera
from ..collector import paused
from ..language.document import Document
from ..model import Leaf
from . import csg, media
from .grouping import components
from .leaves import Leaves
from .primitives import Corners, Mesh, Primitive


class MeshKey(NamedTuple):
    """Triangles with the same key share a mesh: the material of their primitive, and the media on both sides.

    The normal points to ``outside``; None is air. An opaque primitive has ``inside`` None, and ``outside`` None too
    unless it reflects by Fresnel's equations.
    """

    material: Hashable
    inside: Hashable = None
    outside: Hashable = None


@dataclass(eq=False)
class Triangles:
    """Triangles of one material: the numbers ``index`` (n, 3) of their corners' ``vertices`` (k, 3), which have unit
    ``normals`` (k, 3) and ``uv`` (k, 2). Equal corners are one vertex.
    """

    vertices: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    index: np.ndarray

    @property
    def positions(self) -> np.ndarray:
        """Where the corners are (n, 3, 3)."""
        return np.asarray(self.vertices[self.index])


def corner_keys(of: np.ndarray, face: np.ndarray, corners: Corners, first: int = 0) -> np.ndarray:
    """Keys (n, 3), equal for equal corners: those ``of`` (n, 3) the same number, ``face`` (n,) and turn of uv. Those
    that stand alone have keys of their own, which are numbered from ``first``.
    """
    wrapped = (np.floor(corners.uv[..., 0]) > 0).astype(int)
    keys = np.asarray((of * 8 + face[:, None]) * 2 + wrapped)
    keys[corners.alone] = -1 - np.arange(first, first + corners.alone.sum())
    return keys


@dataclass(eq=False)
class SurfaceMesh:
    """The boundary of a tree's result, without materials: all triangles, the number ``kind`` (n,) of each triangle's
    kind, and the same of each vertex, ``vertex_kind`` (k,).

    ``kinds`` are the numbers of their leaf and of the media that lie inside and outside. ``seen`` (kinds,) says of
    which there is more than seams of no width.
    """

    triangles: Triangles
    kind: np.ndarray
    vertex_kind: np.ndarray
    kinds: list[tuple[int, int, int]]
    seen: np.ndarray
    _chosen: dict[tuple[int, ...], Triangles] = field(default_factory=dict)

    def chosen(self, groups: list[tuple[int, ...]]) -> list[Triangles]:
        """The triangles of groups of kinds; a group of the last call has the same ones again."""
        group_of = np.full(len(self.kinds), len(groups))
        for number, kinds in enumerate(groups):
            group_of[list(kinds)] = number
        triangles, begins = _sorted(group_of[self.kind], len(groups))
        vertices, firsts = _sorted(group_of[self.vertex_kind], len(groups))
        of = self.triangles
        place = np.empty(len(vertices), int)
        place[vertices] = np.arange(len(vertices))

        def chosen(group: int) -> Triangles:
            some = vertices[firsts[group] : firsts[group + 1]]
            index = place[of.index[triangles[begins[group] : begins[group + 1]]]] - firsts[group]
            return Triangles(of.vertices[some], of.normals[some], of.uv[some], index)

        self._chosen = {kinds: self._chosen.get(kinds) or chosen(group) for group, kinds in enumerate(groups)}
        return list(self._chosen.values())


def _sorted(groups: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The numbers of what is of some group, group by group, and where each of ``count`` groups begins and ends."""
    return np.argsort(groups, kind="stable"), np.cumsum(np.bincount(groups + 1, minlength=count + 2))[: count + 1]


CHUNK = 1 << 16  # triangles at a time


@paused()
def tessellate(
    document: Document,
    camera: Camera,
    tolerance: float,
    medium: Callable[[Leaf], Hashable],
    material: Callable[[Leaf], Hashable],
    fresnel: Callable[[Leaf], bool],
    kept: Callable[[Hashable, Callable[[], SurfaceMesh]], SurfaceMesh] = lambda _, make: make(),
    meshes: Mapping[str, Primitive] | None = None,
) -> dict[MeshKey, Triangles]:
    """The surfaces of a document's scene.

    ``tolerance`` is the largest chord error of curved faces in pixels; ``medium(leaf)`` is a dielectric's medium or
    None, ``material(leaf)`` a hashable key: faces with the same one, between the same media, share a mesh.
    ``fresnel(leaf)`` says whether an opaque primitive reflects by Fresnel's equations, to which its outside matters.
    ``kept(key, make)`` returns ``make()``, or its earlier result for an equal key. ``meshes``: the solids in
    files, by the names of these. Raises :class:`SceneError` for a transform that cannot be inverted, and for too many
    triangles.
    """
    leaves = [node for node in document.scene.csg if isinstance(node, Leaf)]
    if not leaves:
        return {}
    tree = csg.tree_of(document.scene.csg)
    names = [None, *map(medium, leaves)]
    media_of = _numbered(names)[1:]
    cut, cut_several = csg.cutters(tree, media_of)
    table = Leaves(document, camera, tolerance, cut_several, meshes)
    reflects = tuple(number == media.OPAQUE and fresnel(leaf) for number, leaf in zip(media_of, leaves))
    faces = kept(
        (tuple(tree), tuple(media_of), reflects, table.content()), lambda: _faces(tree, table, media_of, reflects, cut)
    )
    seen, lining = np.zeros(len(leaves), bool), np.zeros(len(leaves), bool)
    alike: dict[MeshKey, list[int]] = {}
    of_number = dict(zip([media.OPAQUE, *media_of, media.AIR], [*names, None]))
    filling: set[int] = set()  # media that are seen behind faces of other media's
    for number, (leaf, inside, outside) in enumerate(faces.kinds):
        seen[leaf] |= faces.seen[number]
        filling |= {inside, outside} - {media_of[leaf]} if faces.seen[number] else set()
        lining[leaf] |= faces.seen[number] and (inside == media.OPAQUE) != (media_of[leaf] == media.OPAQUE)
        inside, outside = _sides(media_of[leaf], inside, outside, reflects[leaf])
        alike.setdefault(MeshKey(material(leaves[leaf]), of_number[inside], of_number[outside]), []).append(number)
    # A medium that fills a hollow has no face of its own, which belongs to the cutter, but it is visible.
    filling -= {media.OPAQUE, media.AIR}
    _report_vanished(document, seen | np.isin(media_of, list(filling)))
    _report_lining(document, lining, np.array(media_of) == media.OPAQUE)
    shown = {key: tuple(some) for key, some in alike.items() if faces.seen[some].any()}
    return dict(zip(shown, faces.chosen(list(shown.values()))))


def _numbered(keys: Iterable[Hashable]) -> list[int]:
    """Keys numbered from 0, in the order in which they are met first."""
    numbers: dict[Hashable, int] = {}
    return [numbers.setdefault(key, len(numbers)) for key in keys]


def _faces(
    tree: csg.Tree, table: Leaves, media_of: list[int], reflects: Sequence[bool], cut: np.ndarray
) -> SurfaceMesh:
    """The tree evaluated. Leaf i is of the medium ``media_of[i]``, OPAQUE where it is no dielectric; ``reflects[i]``:
    it is opaque, and reflects by Fresnel's equations; ``cut[i]``: it is in the second operand of - or *.
    """
    table.make_meshes()
    ids = media.Ids(Manifold.reserve_ids(len(media_of) * (max(media_of) + 1)), len(media_of))
    boxes = table.boxes[table.of_leaf] + table.step * np.array([[-1.0], [1.0]])
    fresnel = np.flatnonzero(reflects).tolist()

    def body(number: int, medium: int) -> csg.Body | None:
        if medium != media_of[number] and not cut[number]:
            return None
        i = int(table.of_leaf[number])
        mesh = manifold(table.meshes[i], table.first[i], ids.of(number, medium))
        surfaces = frozenset(table.solids[i].surfaces.tolist()) - {-1}
        return csg.Body(mesh, boxes[number : number + 1], surfaces, table.planes, i)

    boundaries: list[media.Boundary] = []
    for part in csg.split(tree, components(boxes[:, 0], boxes[:, 1]).tolist()).values():
        some = [number for number in part if not isinstance(number, str)]
        if len(some) == 1:
            i = table.of_leaf[some[0]]
            boundaries.append(media.whole(table.meshes[i], some[0], table.first[i], media_of[some[0]]))
            continue
        present = {media_of[number] for number in some if not cut[number]}
        boundaries += media.boundaries({m: csg.evaluate(part, partial(body, medium=m)) for m in present}, ids, fresnel)
    if not boundaries:
        nothing = Triangles(np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 2)), np.empty((0, 3), int))
        return SurfaceMesh(nothing, np.empty(0, int), np.empty(0, int), [], np.empty(0, bool))
    return _surface_mesh(table, media.joined(boundaries), max(media_of) + 2)


def manifold(mesh: Mesh, first: int, original_id: int) -> Manifold:
    """A primitive's mesh whose triangles bear an id and the numbers of their facets, which begin with ``first``."""
    bearing = Mesh64(
        mesh.vertices.astype(np.float64, copy=False),
        mesh.triangles.astype(np.uint64),
        run_index=np.array([0, 3 * len(mesh.triangles)], np.uint64),
        run_original_id=np.array([original_id], np.uint32),
        face_id=(first + mesh.facets).astype(np.uint64),
    )
    return csg.checked(Manifold(bearing))


def _surface_mesh(table: Leaves, boundary: media.Boundary, count: int) -> SurfaceMesh:
    """A boundary with the normals and surface parameters of its leaves. ``count`` are the media, with air."""
    codes = (boundary.leaf * count + boundary.inside + 1) * count + boundary.outside + 1
    codes, kind = np.unique(codes, return_inverse=True)
    columns = []
    alone = 0  # so far
    for start in range(0, len(kind), CHUNK):
        some = boundary.chosen(slice(start, start + CHUNK))
        positions = some.vertices[some.triangles]
        face = table.faces[some.facet]
        found = table.corners(positions, some.leaf, face)
        keys = corner_keys(some.triangles * len(codes) + kind[start : start + CHUNK, None], face, found, alone)
        alone += int(found.alone.sum())
        normals = found.normals * some.sign[:, None, None]
        columns.append([keys, normals.astype("f4"), found.uv.astype("f4"), media.heights(positions) > 2 * table.step])
    keys, normals, uv, high = map(np.concatenate, zip(*columns))
    _, first, index = np.unique(keys, return_index=True, return_inverse=True)
    triangle, at = np.divmod(first, 3)
    positions = boundary.vertices[boundary.triangles[triangle, at]] + table.origin
    triangles = Triangles(positions, normals[triangle, at], uv[triangle, at], index.reshape(-1, 3))
    seen = np.bincount(kind[high], minlength=len(codes)) > 0
    leaf, sides = np.divmod(codes, count**2)
    kinds = list(zip(leaf.tolist(), (sides // count - 1).tolist(), (sides % count - 1).tolist()))
    return SurfaceMesh(triangles, kind, kind[triangle], kinds, seen)


def _sides(own: int, inside: int, outside: int, reflects: bool) -> tuple[int, int]:
    """The media on the sides of a face in its :class:`MeshKey`; ``own`` is the medium of its leaf. An opaque face has
    the outer medium if it ``reflects`` by Fresnel's equations. A dielectric's face stays one where it cuts an opaque
    solid.
    """
    if own == media.OPAQUE:
        return own, outside if reflects else media.AIR
    return own if inside == media.OPAQUE else inside, outside


def _report_lining(document: Document, lining: np.ndarray, opaque: np.ndarray) -> None:
    """Warns of opaque leaves that cut glass, whose faces line it, and of glass that cuts opaque solids."""
    numbers = [n for n, node in enumerate(document.scene.csg) if isinstance(node, Leaf)]
    said = set()
    for leaf in np.flatnonzero(lining).tolist():
        node = document.scene.csg[numbers[leaf]]
        if isinstance(node, Leaf) and (node.shape, node.index) not in said:
            said.add((node.shape, node.index))
            document.warn(
                f"{node.shape.upper()} {node.index} cuts glass, and the faces of the cut are its own: SURFACE "
                f"{node.index} is opaque, and lines the glass; expected material dieletrico in SURFACE {node.index}"
                if opaque[leaf]
                else f"{node.shape.upper()} {node.index} cuts what is opaque, and the faces of the cut are its own: "
                f"SURFACE {node.index} is a dieletrico, through which one looks into the solid; expected another "
                f"material in SURFACE {node.index}",
                "csg",
                numbers[leaf],
            )


def _report_vanished(document: Document, seen: np.ndarray) -> None:
    leaves = [(n, leaf) for n, leaf in enumerate(document.scene.csg) if isinstance(leaf, Leaf)]
    gone = [leaf for leaf, s in zip(leaves, seen) if not s]
    if len(gone) == len(leaves):
        document.warn("the tree's result is empty: nothing is left to see", "csg")
    elif gone:
        names = [f"{leaf.shape.upper()} {leaf.index} (line {document.line('csg', n)})" for n, leaf in gone[:10]]
        more = f" and {len(gone) - 10} more" if len(gone) > 10 else ""
        reason = f"nothing is seen of {', '.join(names)}{more}: no face of it is left in the result"
        document.warn(reason + document.operation(gone[0][0]), "csg", gone[0][0])
