"""The triangles of the whole scene, with the normals and surface parameters of the primitives that they come from."""

from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import TypeVar

import numpy as np
from manifold3d import Manifold, Mesh64

from ..collector import still
from ..language.document import Document
from ..model import Leaf, Operator
from . import csg, media, tree
from .faces import NOTHING, Faces, Piece, Skin, Triangles, corner_keys, heights, joined
from .leaves import Leaves
from .primitives import Mesh
from .sight import Sight
from .sweep import components

Number = TypeVar("Number", int, np.ndarray)
CHUNK = 1 << 16  # triangles at a time


def anew(_: Hashable, make: Callable[[], Faces]) -> Faces:
    """Keeps nothing."""
    return make()


@still()
def tessellate(
    document: Document,
    camera: Sight,
    tolerance: float,
    medium: Callable[[Leaf], Hashable],
    material: Callable[[Leaf], Hashable],
    fresnel: Callable[[Leaf], bool],
    kept: Callable[[Hashable, Callable[[], Faces]], Faces] = anew,
) -> dict[Skin, Triangles]:
    """The surfaces of a document's scene.

    ``tolerance`` is the largest chord error of curved faces in pixels; ``medium(leaf)`` is a dielectric's medium or
    None, ``material(leaf)`` a hashable key: faces with the same one, between the same media, share a mesh.
    ``fresnel(leaf)`` says whether an opaque primitive reflects by Fresnel's equations, to which its outside matters.
    ``kept(key, make)`` may give what ``make`` has made for an equal key before. Raises :class:`SceneError` for a
    transform that cannot be inverted and for more triangles than memory is provided for.
    """
    nodes = document.scene.csg
    leaves = tree.leaves(nodes)
    if not leaves:
        return {}
    names = [None, *map(medium, leaves)]
    media_of = _numbered(names)[1:]
    table = Leaves(document, camera, tolerance, media.cutters(nodes, media_of))
    symbols = tuple(node.symbol if isinstance(node, Operator) else "" for node in nodes)
    reflects = tuple(number == media.OPAQUE and fresnel(leaf) for number, leaf in zip(media_of, leaves))
    faces = kept(
        (symbols, tuple(media_of), reflects, table.content()), lambda: _faces(nodes, table, media_of, reflects)
    )
    seen, lining = np.zeros(len(leaves), bool), np.zeros(len(leaves), bool)
    alike: dict[Skin, list[int]] = {}
    of_number = dict(zip([media.OPAQUE, *media_of, media.AIR], [*names, None]))
    filling: set[int] = set()  # media that are seen behind faces of other media's
    for number, (leaf, inside, outside) in enumerate(faces.kinds):
        seen[leaf] |= faces.seen[number]
        filling |= {inside, outside} - {media_of[leaf]} if faces.seen[number] else set()
        lining[leaf] |= faces.seen[number] and (inside == media.OPAQUE) != (media_of[leaf] == media.OPAQUE)
        inside, outside = _sides(media_of[leaf], inside, outside, reflects[leaf])
        alike.setdefault(Skin(material(leaves[leaf]), of_number[inside], of_number[outside]), []).append(number)
    # What fills a hollow has left its face to what has cut it, and is seen all the same.
    filling -= {media.OPAQUE, media.AIR}
    _report_vanished(document, seen | np.isin(media_of, list(filling)))
    _report_lining(document, lining, np.array(media_of) == media.OPAQUE)
    shown = {skin: tuple(some) for skin, some in alike.items() if faces.seen[some].any()}
    return dict(zip(shown, faces.chosen(list(shown.values()))))


def _numbered(keys: Iterable[Hashable]) -> list[int]:
    """Keys numbered from 0, in the order in which they are met first."""
    numbers: dict[Hashable, int] = {}
    return [numbers.setdefault(key, len(numbers)) for key in keys]


def _faces(nodes: tree.Nodes, table: Leaves, media_of: list[int], reflects: Sequence[bool]) -> Faces:
    """The tree evaluated. Leaf i is of the medium ``media_of[i]``, OPAQUE where it is no dielectric; ``reflects[i]``:
    it is opaque, and reflects by Fresnel's equations.
    """
    table.make_meshes()
    base = int(Manifold.reserve_ids(len(media_of)))
    boxes = table.boxes[table.of_leaf] + table.planes.step * np.array([[-1.0], [1.0]])
    groups = components(boxes[:, 0], boxes[:, 1])
    single = np.bincount(groups, minlength=len(groups)) == 1

    def value(number: int) -> csg.Value:
        if single[groups[number]]:
            return {}
        i = int(table.of_leaf[number])
        surfaces = table.solids[i].surfaces
        mesh = manifold(table.meshes[i], table.first[i], base + number)
        shared = frozenset(surfaces[surfaces >= 0].tolist())
        return {media_of[number]: csg.Body(mesh, boxes[number : number + 1], shared, table.planes, i)}

    fresnel = {base + number for number, reflecting in enumerate(reflects) if reflecting}
    shells: list[media.Shell] = []
    for group, result in csg.evaluate(nodes, groups.tolist(), value).items():
        if single[group]:
            i = table.of_leaf[group]
            shells.append(media.whole(table.meshes[i], base + group, table.first[i], media_of[group]))
        else:
            shells += media.shells(result, fresnel)
    count = max(media_of) + 2
    pieces = [_piece(table, shell, shell.ids - base, count) for shell in media.batches(shells, CHUNK, table.planes)]
    return joined([NOTHING, *pieces], count)


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


def _piece(table: Leaves, shell: media.Shell, leaf: np.ndarray, count: int) -> Piece:
    """A shell with the normals and surface parameters of the leaves (n,) that its triangles come from."""
    kind = _kind(leaf, shell.inside, shell.outside, count)
    codes, number = np.unique(kind, return_inverse=True)
    corner = shell.triangles
    columns = []
    alone = 0  # so far
    for start in range(0, len(corner), CHUNK):
        part = slice(start, start + CHUNK)
        positions = shell.vertices[corner[part]]
        found = table.surface(positions, leaf[part], shell.facets[part], shell.sign[part])
        of = corner[part] * len(codes) + number[part, None]
        keys = corner_keys(of, found.face, found.uv, found.alone, alone)
        alone += int(found.alone.sum())
        columns.append([keys, positions + table.origin, found.normals, found.uv, heights(shell.vertices, corner[part])])
    keys, positions, normals, uv, height = map(np.concatenate, zip(*columns))
    _, first, index = np.unique(keys, return_index=True, return_inverse=True)
    triangle, at = np.divmod(first, 3)
    triangles = Triangles(positions[triangle, at], normals[triangle, at], uv[triangle, at], index.reshape(-1, 3))
    return Piece(triangles, kind, kind[triangle], height > 2 * table.planes.step)


def _kind(leaf: Number, inside: Number, outside: Number, count: int) -> Number:
    """The code of a kind of triangles, see :func:`.faces.joined`."""
    result: Number = (leaf * count + inside + 1) * count + outside + 1
    return result


def _sides(own: int, inside: int, outside: int, reflects: bool) -> tuple[int, int]:
    """What a face tells of the media on its sides: ``own`` is its leaf's. What is opaque tells where it lies if it
    ``reflects`` by Fresnel's equations. A dielectric that has cut what is opaque is a dielectric's face all the same.
    """
    if own == media.OPAQUE:
        return own, outside if reflects else media.AIR
    return own if inside == media.OPAQUE else inside, outside


def _report_lining(document: Document, lining: np.ndarray, opaque: np.ndarray) -> None:
    """Warns of what is opaque and has cut glass, which it lines with its own surface; and of glass in its place."""
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
