"""How optics are kept: solids of different media are kept apart.

Media are the opaque one, and one for every index of refraction of a dielectric. Every occurrence of a primitive has its own
id, which manifold3d carries to the triangles of the result.
"""

from collections.abc import Hashable, Iterable
from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold, Mesh64

from .csg import Value
from .parts import Part, as_parts, reserve_ids, union

OPAQUE = None  # the medium of everything that is not a dielectric


@dataclass
class Shell:
    """Triangles of a result: ``vertices`` (n, 3), ``triangles`` (m, 3), and for each the original id of its primitive, the
    number of its facet, and a ``sign``, -1 where it is the surface of a primitive that was taken away."""

    vertices: np.ndarray
    triangles: np.ndarray
    ids: np.ndarray
    facets: np.ndarray
    sign: np.ndarray


def precedence(media: Iterable[Hashable]) -> list[Hashable]:
    """Media, each before those that give way to it: the opaque one, then dielectrics in the given order."""
    return sorted(dict.fromkeys(media), key=lambda medium: medium is not OPAQUE)  # stable


def shells(value: Value, media: list[Hashable]) -> list[Shell]:
    """The surfaces to render; ``media`` are those of the scene in their order of precedence.

    An opaque solid is bounded by its whole surface. A dielectric gives way to opaque solids, and to dielectrics that
    stand before it in the tree: of its surface there remains what bounds the union of all up to it. So every interface
    exists exactly once, and from inside a dielectric every way out leads through its own surface or onto another's.
    """
    result: list[Shell] = []
    before: list[Part] = []
    for medium in media:
        parts = value.get(medium, [])
        if not before:
            before = parts
            result += [_shell(p.manifold) for p in parts]
        elif parts:
            own, originals = _renamed(parts)
            before = union([before, own])
            for part in before:
                shell = _shell(part.manifold)
                mine = np.isin(shell.ids, list(originals))
                if mine.any():
                    ids = np.array([originals[i] for i in shell.ids[mine].tolist()])
                    result.append(Shell(shell.vertices, shell.triangles[mine], ids, shell.facets[mine], shell.sign[mine]))
    return result


def _shell(manifold: Manifold) -> Shell:
    mesh = manifold.to_mesh64()
    ends = np.asarray(mesh.run_index, dtype=np.int64) // 3
    runs = ends[1:] - ends[:-1]
    ids = np.repeat(np.asarray(mesh.run_original_id, dtype=np.int64), runs)
    back = np.repeat(np.asarray(mesh.run_flags, dtype=np.int64) & 1, runs)
    return Shell(np.array(mesh.vert_properties)[:, :3], np.array(mesh.tri_verts, dtype=np.int64), ids,
                 np.asarray(mesh.face_id, dtype=np.int64), 1.0 - 2 * back)


def _renamed(parts: list[Part]) -> tuple[list[Part], dict[int, int]]:
    """The parts with fresh ids, and a dictionary from these to the old ones: tells one medium's triangles from another's
    even where one primitive has cut both."""
    renamed: list[Part] = []
    originals: dict[int, int] = {}
    for part in parts:
        mesh = part.manifold.to_mesh64()
        runs = len(mesh.run_original_id)
        base = reserve_ids(runs)
        originals.update(zip(range(base, base + runs), np.asarray(mesh.run_original_id).tolist()))
        fresh = Mesh64(
            np.array(mesh.vert_properties, float), np.array(mesh.tri_verts, np.uint64),
            run_index=np.array(mesh.run_index, np.uint64), run_flags=np.array(mesh.run_flags, np.uint8),
            run_original_id=np.arange(base, base + runs, dtype=np.uint32), face_id=np.array(mesh.face_id, np.uint64))
        renamed += as_parts(Manifold(fresh), part.planes, part.surfaces)
    return renamed, originals
