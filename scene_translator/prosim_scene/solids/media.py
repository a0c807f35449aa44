"""How optics are kept: solids of different media are kept apart.

Media are the opaque one, and one for every index of refraction of a dielectric. Every occurrence of a primitive has its own
id, which manifold3d carries to the triangles of the result.
"""

from collections.abc import Hashable, Iterable

import numpy as np
from manifold3d import Manifold, Mesh64

from .csg import Value
from .parts import as_parts, reserve_ids, union

OPAQUE = None  # the medium of everything that is not a dielectric


def precedence(media: Iterable[Hashable]) -> list[Hashable]:
    """Media, each before those that give way to it: the opaque one, then dielectrics in the given order."""
    return sorted(dict.fromkeys(media), key=lambda medium: medium is not OPAQUE)  # stable


def shells(value: Value, media: list[Hashable]) -> list[tuple[Hashable, np.ndarray, np.ndarray, np.ndarray]]:
    """The surfaces to render: a list of (medium, vertices, triangles, original id of each triangle).

    ``media`` are those of the scene in their order of precedence.

    An opaque solid is bounded by its whole surface. A dielectric gives way to opaque solids, and to dielectrics that
    stand before it in the tree: of its surface there remains what bounds the union of all up to it. So every interface
    exists exactly once, and from inside a dielectric every way out leads through its own surface or onto another's.
    """
    meshes, before = [], []
    for medium in media:
        parts = value.get(medium, [])
        if not parts:
            continue
        if not before:
            before = parts
            meshes += [(medium, *_arrays(p.manifold)) for p in parts]
            continue
        own, originals = _renamed(parts)
        before = union([before, own])
        for part in before:
            vertices, triangles, ids = _arrays(part.manifold)
            names = np.array(sorted(originals), dtype=np.int64)
            at = np.searchsorted(names, ids)
            mine = (at < len(names)) & (names[np.minimum(at, len(names) - 1)] == ids) if len(names) else ids < 0
            if mine.any():
                real = np.array([originals[i] for i in names])
                meshes.append((medium, vertices, triangles[mine], real[at[mine]]))
    return meshes


def _arrays(manifold):
    mesh = manifold.to_mesh64()
    runs = np.diff(np.asarray(mesh.run_index, dtype=np.int64)) // 3
    ids = np.repeat(np.asarray(mesh.run_original_id, dtype=np.int64), runs)
    return np.array(mesh.vert_properties)[:, :3], np.array(mesh.tri_verts, dtype=np.int64), ids


def _renamed(parts):
    """The parts with fresh ids, and a dictionary from these to the old ones: tells one medium's triangles from another's
    even where one primitive has cut both."""
    renamed, originals = [], {}
    for part in parts:
        vertices, triangles, ids = _arrays(part.manifold)
        old, index = np.unique(ids, return_inverse=True)
        base = reserve_ids(len(old))
        originals.update(zip(range(base, base + len(old)), old.tolist()))
        order = np.argsort(index, kind="stable")
        run_index = np.concatenate([[0], np.cumsum(np.bincount(index))]).astype(np.uint64) * np.uint64(3)
        renamed += as_parts(Manifold(Mesh64(
            np.ascontiguousarray(vertices), np.ascontiguousarray(triangles[order], dtype=np.uint64), run_index=run_index,
            run_original_id=np.arange(base, base + len(old), dtype=np.uint32))), part.surfaces)
    return renamed, originals
