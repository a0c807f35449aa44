"""The triangles of the whole scene, with the normals and surface parameters of the primitives that they come from."""

from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import TypeVar

import numpy as np

from ..collector import still
from ..language.document import Document
from ..model import Leaf, Operator
from . import csg, media, parts, tree, whole
from .faces import NOTHING, Faces, Piece, Skin, Triangles, corner_keys, heights, joined
from .leaves import Leaves
from .results import Content, Results
from .sight import Sight
from .values import Value

Number = TypeVar("Number", int, np.ndarray)
CHUNK = 1 << 18  # triangles at a time


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
    results: Results | None = None,
) -> dict[Skin, Triangles]:
    """The surfaces of a document's scene.

    ``tolerance`` is the largest chord error of curved faces in pixels; ``medium(leaf)`` is a dielectric's medium or
    None, ``material(leaf)`` a hashable key: faces with the same one, between the same media, share a mesh.
    ``fresnel(leaf)`` says whether an opaque primitive reflects by Fresnel's equations, to which its outside matters.
    ``kept(key, make)`` may give what ``make`` has made for an equal key before; ``results`` are those of another tree's
    operations. Raises :class:`SceneError` for a transform that cannot be inverted and for more triangles than memory is
    provided for.
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
        (symbols, tuple(media_of), reflects, table.content()), lambda: _faces(nodes, table, media_of, reflects, results)
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


def _faces(
    nodes: tree.Nodes, table: Leaves, media_of: list[int], reflects: Sequence[bool], results: Results | None
) -> Faces:
    """The tree evaluated. Leaf i is of the medium ``media_of[i]``, OPAQUE where it is no dielectric; ``reflects[i]``:
    it is opaque, and reflects by Fresnel's equations.
    """
    table.make_meshes()
    base = parts.reserve_ids(len(media_of)) if results is None else results.begin(len(media_of))

    def leaf_value(number: int, leaf: Leaf) -> Value:
        i = table.of_leaf[number]
        solid, mesh, surfaces = table.solids[i], table.meshes[i], table.solids[i].surfaces.tolist()
        return {
            media_of[number]: parts.solid(
                parts.Run(mesh.vertices, mesh.triangles, table.first[i] + mesh.facets, base + number),
                table.boxes[i],
                table.planes,
                frozenset(surface for surface in surfaces if surface >= 0),
                solid.key,
                number if solid.curved_surface < 0 else None,
                lambda: table.extent(i),
                Content(lambda: [number.to_bytes(8, "little"), *table.mesh_content(i)], results) if results else None,
            )
        }

    value = csg.evaluate(nodes, leaf_value)
    count = max(media_of) + 2
    fresnel = {base + number for number, reflecting in enumerate(reflects) if reflecting}
    leaves, value = whole.told_apart(value)
    kinds = [_kind(leaf, media_of[leaf], media.AIR, count) for leaf in leaves]
    pieces = [NOTHING, *whole.pieces(table, leaves, kinds)]
    pieces += [
        _piece(table, shell, shell.ids - base, count)
        for shell in media.batches(media.shells(value, fresnel), CHUNK, table.planes)
    ]
    if results:
        results.end()
    return joined(pieces, count)


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
