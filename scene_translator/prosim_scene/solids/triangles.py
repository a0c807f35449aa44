"""The triangles of the whole scene, with the normals and surface parameters of the primitives that they come from."""

import warnings
from collections.abc import Callable, Hashable
from dataclasses import dataclass

import numpy as np

from ..model import Leaf, Scene
from ..view import Camera
from . import coincidence, csg, media, parts, tree
from .leaves import Leaves
from .primitives import PRIMITIVES

TOLERANCE = 0.1  # chord error in pixels
CHUNK = 1 << 18  # triangles at a time


@dataclass
class Triangles:
    """Triangles of one material, corner by corner: positions (n, 3, 3), unit normals (n, 3, 3), uv (n, 3, 2), and a key
    (n, 3) that is equal for equal corners."""

    positions: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    keys: np.ndarray


def tessellate(scene: Scene, camera: Camera, tolerance: float, medium: Callable[[Leaf], Hashable],
               material: Callable[[Leaf], Hashable]) -> dict[Hashable, Triangles]:
    """The surfaces of the scene: {material: Triangles}.

    ``medium(leaf)`` is a dielectric's medium or None, ``material(leaf)`` a hashable key: leaves with the same key
    share a mesh.
    """
    leaves = tree.leaves(scene.csg)
    if not leaves:
        return {}
    table = Leaves(scene, camera, tolerance)
    base = parts.reserve_ids(len(leaves))

    def leaf_value(number, leaf):
        linear, offset = table.matrix[number, :, :3], table.matrix[number, :, 3]
        vertices, faces = PRIMITIVES[leaf.shape].mesh(table.rounds[number])
        if np.linalg.det(linear) < 0:  # a mirrored solid is inside out
            faces = faces[:, ::-1]
        return {medium(leaf): parts.solid(vertices @ linear.T + offset, faces, base + number,
                                          frozenset(table.surfaces[number]))}

    value = csg.evaluate(scene.csg, leaf_value)
    order = media.precedence(map(medium, leaves))
    rank = np.array([order.index(medium(leaf)) for leaf in leaves])

    materials: dict[Hashable, int] = {}
    material_of = np.array([materials.setdefault(material(leaf), len(materials)) for leaf in leaves])
    seen = np.zeros(len(leaves), bool)
    collected: dict[int, list] = {}
    offset = 0
    for own, vertices, faces, ids in media.shells(value, order):
        before = ids - base
        vertices, faces, before = coincidence.cut_shared_faces(table, vertices, faces, before)
        leaf = coincidence.owners(table, scene.csg, vertices, faces, before)
        if len(order) > 1:
            # A face that coincides with one of another medium's solid is part of that one's shell, if it has precedence.
            other = (leaf != before) & (table.sign[leaf] > 0) & (rank[leaf] != order.index(own))
            kept = ~other | (rank[leaf] > order.index(own))
            leaf, faces = np.where(other, before, leaf)[kept], faces[kept]
        seen[leaf] = True
        for start in range(0, len(faces), CHUNK):
            part = slice(start, start + CHUNK)
            corners = table.corners(vertices[faces[part]], faces[part] + offset, leaf[part])
            group = material_of[leaf[part]]
            for m in np.unique(group):
                chosen = group == m
                collected.setdefault(m, []).append([a[chosen] for a in corners])
        offset += len(vertices)
    _report_vanished(scene, leaves, seen)
    keys = list(materials)
    return {keys[m]: Triangles(*map(np.concatenate, zip(*collected[m]))) for m in sorted(collected)}


def _report_vanished(scene: Scene, leaves: list[Leaf], seen: np.ndarray) -> None:
    gone = [leaf for leaf, s in zip(leaves, seen) if not s]
    if len(gone) == len(leaves):
        warnings.warn(scene.source.warning(scene.places["CSG_TREE"], "the tree's result is empty: nothing is left to see"),
                      stacklevel=2)
    elif gone:
        names = [f"{leaf.shape.upper()} {leaf.index} (line {scene.source.line(leaf.at)})" for leaf in gone[:10]]
        more = f" and {len(gone) - 10} more" if len(gone) > 10 else ""
        warnings.warn(scene.source.warning(
            gone[0].at, f"nothing is seen of {', '.join(names)}{more}: no face of it is left in the result"), stacklevel=2)
