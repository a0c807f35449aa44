"""The triangles of the whole scene, with the normals and surface parameters of the primitives that they come from."""

from collections.abc import Callable, Hashable
from dataclasses import dataclass

import numpy as np

from ..language.document import Document
from ..model import Leaf, Operator
from . import csg, media, parts, tree
from .kept import Faces, Kept
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


def tessellate(
    document: Document,
    camera: Sight,
    tolerance: float,
    medium: Callable[[Leaf], Hashable],
    material: Callable[[Leaf], Hashable],
    kept: Kept | None = None,
) -> dict[Hashable, Triangles]:
    """The surfaces of a document's scene: {material: Triangles}.

    ``tolerance`` is the largest chord error of curved faces in pixels; ``medium(leaf)`` is a dielectric's medium or
    None, ``material(leaf)`` a hashable key: leaves with the same key share a mesh. What is ``kept`` from earlier scenes
    is not computed again. Raises :class:`SceneError` for a transform that cannot be inverted and for more triangles
    than memory is provided for.
    """
    nodes = document.scene.csg
    leaves = tree.leaves(nodes)
    if not leaves:
        return {}
    table = Leaves(document, camera, tolerance)
    names: dict[Hashable, int] = {None: media.OPAQUE}
    media_of = [names.setdefault(medium(leaf), len(names)) for leaf in leaves]
    symbols = tuple(node.symbol if isinstance(node, Operator) else "" for node in nodes)
    faces = (kept or Kept()).faces(
        (symbols, tuple(media_of), table.content()), lambda: _evaluated(nodes, table, media_of)
    )
    _report_vanished(document, faces.seen)
    materials: dict[Hashable, int] = {}
    material_of = np.array([materials.setdefault(material(leaf), len(materials)) for leaf in leaves])
    order = np.argsort(material_of[faces.leaf], kind="stable")
    begins = np.searchsorted(material_of[faces.leaf][order], np.arange(len(materials) + 1))
    result: dict[Hashable, Triangles] = {}
    shown = set(material_of[faces.seen].tolist())  # of others there are seams of no width at most
    for name, number in materials.items():
        if number in shown:
            chosen = order[begins[number] : begins[number + 1]]
            result[name] = Triangles(*(a[chosen] for a in (faces.positions, faces.normals, faces.uv, faces.keys)))
    return result


def _evaluated(nodes: tree.Nodes, table: Leaves, media_of: list[int]) -> Faces:
    """The triangles of a tree; the leaf with the number i is of the medium ``media_of[i]``, 0 is the opaque one."""
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
    collected: list[list[np.ndarray]] = []
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
            collected.append([leaf, positions + table.origin, found.normals, found.uv, keys])
        vertices += len(shell.vertices)
    if not collected:
        collected.append([np.empty(0, int), *(np.empty((0, 3, n)) for n in (3, 3, 2)), np.empty((0, 3), int)])
    leaf, positions, normals, uv, keys = map(np.concatenate, zip(*collected))
    return Faces(leaf, positions, normals, uv, keys, seen)


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
