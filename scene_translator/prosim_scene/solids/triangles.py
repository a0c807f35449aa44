"""The triangles of the whole scene, with the normals and surface parameters of the primitives that they come from."""

from collections.abc import Callable, Hashable
from dataclasses import dataclass

import numpy as np

from ..language.document import Document
from ..model import Leaf, Operator, Scene
from . import csg, media, parts, tree
from .leaves import Leaves
from .sight import Sight

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
    scene = document.scene
    leaves = tree.leaves(scene.csg)
    if not leaves:
        return {}
    table = Leaves(document, camera, tolerance)
    materials: dict[Hashable, int] = {}
    material_of = np.array([materials.setdefault(material(leaf), len(materials)) for leaf in leaves])
    # All that the result depends on.
    key = (
        tuple(node.symbol if isinstance(node, Operator) else medium(node) for node in scene.csg),
        tuple((s.primitive.name, s.segments, s.to_world.tobytes()) for s in table.solids),
        (table.of_leaf.tobytes(), material_of.tobytes(), table.origin.tobytes()),
    )
    triangles, seen = kept(key, lambda: _found(scene, table, medium, material_of))
    _report_vanished(document, seen)
    names = list(materials)
    shown = np.unique(material_of[seen]).tolist()  # of others there are seams of no width at most
    return {names[m]: triangles[m] for m in shown}


def _found(scene: Scene, table: Leaves, medium: Callable[[Leaf], Hashable], material_of: np.ndarray) -> Found:
    """The tree evaluated."""
    leaves = tree.leaves(scene.csg)
    base = parts.reserve_ids(len(leaves))

    def leaf_value(number: int, leaf: Leaf) -> csg.Value:
        i = table.of_leaf[number]
        solid, mesh = table.solids[i], table.meshes[i]
        return {
            medium(leaf): parts.solid(
                mesh.vertices,
                mesh.triangles,
                table.first[i] + mesh.facets,
                base + number,
                table.planes,
                frozenset(solid.surfaces[solid.surfaces >= 0].tolist()),
                solid.key,
            )
        }

    value = csg.evaluate(scene.csg, leaf_value)
    seen = np.zeros(len(leaves), bool)
    collected: dict[int, list[list[np.ndarray]]] = {}
    vertices = alone = 0  # so far: what keys are made of
    for shell in media.shells(value, media.precedence(map(medium, leaves))):
        for start in range(0, len(shell.triangles), CHUNK):
            part = slice(start, start + CHUNK)
            leaf, corner = shell.ids[part] - base, shell.triangles[part]
            positions = shell.vertices[corner]
            seen[leaf[_height(positions) > 2 * table.planes.step]] = True
            found = table.surface(positions, leaf, shell.facets[part], shell.sign[part])
            wrapped = (np.floor(found.uv[..., 0]) > 0).astype(int)
            keys = (((corner + vertices) * len(leaves) + leaf[:, None]) * 8 + found.face[:, None]) * 2 + wrapped
            keys[found.alone] = -1 - np.arange(alone, alone + found.alone.sum())
            alone += int(found.alone.sum())
            placed = positions + table.origin
            group = material_of[leaf]
            for m in np.unique(group):
                chosen = group == m
                collected.setdefault(m, []).append([a[chosen] for a in (placed, found.normals, found.uv, keys)])
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
