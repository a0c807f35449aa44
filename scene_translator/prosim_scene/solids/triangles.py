"""The triangles of the whole scene, with the normals and surface parameters of the primitives that they come from."""

from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass

import numpy as np

from ..language.document import Document
from ..model import Leaf, Operator
from . import csg, media, parts, tree
from .leaves import Leaves
from .sight import Sight
from .values import Value

CHUNK = 1 << 18  # triangles at a time


@dataclass
class Triangles:
    """Triangles of one material, corner by corner: positions (n, 3, 3), unit normals (n, 3, 3), uv (n, 3, 2), and a key
    (n, 3) that is equal for equal corners.
    """

    positions: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    keys: np.ndarray


#: The triangles of each material, by its number, and which leaves are seen.
Found = tuple[dict[int, Triangles], np.ndarray]


def anew(_: Hashable, make: Callable[[], Found]) -> Found:
    """Keeps nothing."""
    return make()


def tessellate(
    document: Document,
    camera: Sight,
    tolerance: float,
    medium: Callable[[Leaf], Hashable],
    material: Callable[[Leaf], Hashable],
    kept: Callable[[Hashable, Callable[[], Found]], Found] = anew,
) -> dict[Hashable, Triangles]:
    """The surfaces of a document's scene: {material: Triangles}.

    ``tolerance`` is the largest chord error of curved faces in pixels; ``medium(leaf)`` is a dielectric's medium or
    None, ``material(leaf)`` a hashable key: leaves with the same key share a mesh. ``kept(key, make)`` may give
    what ``make`` has made for an equal key before. Raises :class:`SceneError` for a transform that cannot be inverted
    and for more triangles than memory is provided for.
    """
    nodes = document.scene.csg
    leaves = tree.leaves(nodes)
    if not leaves:
        return {}
    table = Leaves(document, camera, tolerance)
    media_of = _numbered([None, *map(medium, leaves)])[1:]
    materials = list(map(material, leaves))
    material_of = np.array(_numbered(materials))
    symbols = tuple(node.symbol if isinstance(node, Operator) else "" for node in nodes)
    key = symbols, tuple(media_of), material_of.tobytes(), table.content()
    triangles, seen = kept(key, lambda: _found(nodes, table, media_of, material_of))
    _report_vanished(document, seen)
    names = dict(zip(material_of.tolist(), materials))
    shown = np.unique(material_of[seen]).tolist()  # of others there are seams of no width at most
    return {names[m]: triangles[m] for m in shown}


def _numbered(keys: Iterable[Hashable]) -> list[int]:
    """Keys numbered from 0, in the order in which they are met first."""
    numbers: dict[Hashable, int] = {}
    return [numbers.setdefault(key, len(numbers)) for key in keys]


def _found(nodes: tree.Nodes, table: Leaves, media_of: list[int], material_of: np.ndarray) -> Found:
    """The tree evaluated. Leaf i is of the medium ``media_of[i]``, OPAQUE where it is no dielectric."""
    table.make_meshes()
    base = parts.reserve_ids(len(media_of))

    def leaf_value(number: int, leaf: Leaf) -> Value:
        i = table.of_leaf[number]
        solid, mesh = table.solids[i], table.meshes[i]
        return {
            media_of[number]: parts.solid(
                mesh.vertices,
                mesh.triangles,
                table.first[i] + mesh.facets,
                base + number,
                table.planes,
                frozenset(solid.surfaces[solid.surfaces >= 0].tolist()),
                solid.key,
                solid.curved_surface < 0,
            )
        }

    value = csg.evaluate(nodes, leaf_value)
    seen = np.zeros(len(media_of), bool)
    collected: dict[int, list[list[np.ndarray]]] = {}
    vertices = alone = 0  # so far: what keys are made of
    for shell in media.batches(media.shells(value), CHUNK, table.planes):
        for start in range(0, len(shell.triangles), CHUNK):
            part = slice(start, start + CHUNK)
            leaf, corner = shell.ids[part] - base, shell.triangles[part]
            positions = shell.vertices[corner]
            seen[leaf[_height(positions) > 2 * table.planes.step]] = True
            found = table.surface(positions, leaf, shell.facets[part], shell.sign[part])
            wrapped = (np.floor(found.uv[..., 0]) > 0).astype(int)
            keys = (((corner + vertices) * len(media_of) + leaf[:, None]) * 8 + found.face[:, None]) * 2 + wrapped
            keys[found.alone] = -1 - np.arange(alone, alone + found.alone.sum())
            alone += int(found.alone.sum())
            order = np.argsort(material_of[leaf], kind="stable")
            group = material_of[leaf][order]
            begins = np.flatnonzero(np.append(True, np.diff(group) != 0))
            columns = [
                np.split(a[order], begins[1:]) for a in (positions + table.origin, found.normals, found.uv, keys)
            ]
            for m, *arrays in zip(group[begins].tolist(), *columns):
                collected.setdefault(m, []).append(arrays)
        vertices += len(shell.vertices)
    return {m: Triangles(*map(np.concatenate, zip(*arrays))) for m, arrays in collected.items()}, seen


def _height(positions: np.ndarray) -> np.ndarray:
    """Heights of triangles (n, 3, 3) over their longest sides: those in a seam of coincident faces have none."""
    a, b, c = (positions[:, i] for i in range(3))
    longest = np.sqrt(np.max([np.sum(d * d, axis=1) for d in (b - a, c - b, a - c)], axis=0))
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / np.maximum(longest, 1e-300))


def _report_vanished(document: Document, seen: np.ndarray) -> None:
    leaves = [(n, leaf) for n, leaf in enumerate(document.scene.csg) if isinstance(leaf, Leaf)]
    gone = [leaf for leaf, s in zip(leaves, seen) if not s]
    if len(gone) == len(leaves):
        document.warn("the tree's result is empty: nothing is left to see", "csg")
    elif gone:
        names = [f"{leaf.shape.upper()} {leaf.index} (line {document.line('csg', n)})" for n, leaf in gone[:10]]
        more = f" and {len(gone) - 10} more" if len(gone) > 10 else ""
        document.warn(
            f"nothing is seen of {', '.join(names)}{more}: no face of it is left in the result", "csg", gone[0][0]
        )
