"""How optics are kept: solids of different media are kept apart.

Media are numbers: the opaque one's, and one for every index of refraction of a dielectric. Every occurrence of a
primitive has its own id, which manifold3d carries to the triangles of the result.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold, Mesh64

from .coincidence import Planes
from .parts import Part, as_parts, reserve_ids, union
from .values import Value

OPAQUE = 0  # the medium of everything that is not a dielectric


@dataclass
class Shell:
    """Triangles of a result: ``vertices`` (n, 3), ``triangles`` (m, 3), and for each the original id of its primitive,
    the number of its facet, and a ``sign``, -1 where it is the surface of a primitive that was taken away. It is
    ``settled`` when its vertices lie on the planes of its facets.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    ids: np.ndarray
    facets: np.ndarray
    sign: np.ndarray
    settled: bool = True


def shells(value: Value) -> list[Shell]:
    """The surfaces to render. Media are numbers in their order of precedence, OPAQUE first.

    An opaque solid is bounded by its whole surface. A dielectric gives way to opaque solids, and to dielectrics that
    stand before it in the tree: of its surface there remains what bounds the union of all up to it. So every interface
    exists exactly once, and from inside a dielectric every way out leads through its own surface or onto another's.
    """
    result: list[Shell] = []
    before: list[Part] = []
    for _, parts in sorted(value.items()):
        if not before:
            before = parts
            result += [_shell(p) for p in parts]
        elif parts:
            own, originals = _renamed(parts)
            before = union([before, own])
            for part in before:
                shell = _shell(part)
                mine = np.isin(shell.ids, list(originals))
                if mine.any():
                    ids = np.array([originals[i] for i in shell.ids[mine].tolist()])
                    result.append(
                        Shell(shell.vertices, shell.triangles[mine], ids, shell.facets[mine], shell.sign[mine])
                    )
    return result


def batches(shells: Iterable[Shell], size: int, planes: Planes) -> Iterator[Shell]:
    """The same triangles in few shells, all settled: small ones are put together until they have ``size`` triangles."""
    waiting: list[Shell] = []
    count = 0
    for shell in shells:
        waiting.append(shell)
        count += len(shell.triangles)
        if count >= size:
            yield _joined(waiting, planes)
            waiting, count = [], 0
    if waiting:
        yield _joined(waiting, planes)


def _joined(shells: list[Shell], planes: Planes) -> Shell:
    vertices = np.concatenate([s.vertices for s in shells])
    begin = np.cumsum([0, *(len(s.vertices) for s in shells)])
    triangles = np.concatenate([s.triangles + first for s, first in zip(shells, begin)])
    facets = np.concatenate([s.facets for s in shells])
    unsettled = np.repeat([not s.settled for s in shells], [len(s.triangles) for s in shells])
    return Shell(
        planes.settled(vertices, triangles[unsettled], facets[unsettled]),
        triangles,
        np.concatenate([s.ids for s in shells]),
        facets,
        np.concatenate([s.sign for s in shells]),
    )


def _shell(part: Part) -> Shell:
    # Plain primitives are brought onto their planes many at a time, see batches; elsewhere that is not idempotent.
    mesh = (part.manifold if part.plain else part.planes.together(part.manifold, part.surfaces)).to_mesh64()
    ends = np.asarray(mesh.run_index, dtype=np.int64) // 3
    runs = ends[1:] - ends[:-1]
    ids = np.repeat(np.asarray(mesh.run_original_id, dtype=np.int64), runs)
    back = np.repeat(np.asarray(mesh.run_flags, dtype=np.int64) & 1, runs)
    return Shell(
        np.array(mesh.vert_properties)[:, :3],
        np.array(mesh.tri_verts, dtype=np.int64),
        ids,
        np.asarray(mesh.face_id, dtype=np.int64),
        1.0 - 2 * back,
        not part.plain,
    )


def _renamed(parts: list[Part]) -> tuple[list[Part], dict[int, int]]:
    """The parts with fresh ids, and a dictionary from these to the old ones: tells one medium's triangles from
    another's even where one primitive has cut both.
    """
    renamed: list[Part] = []
    originals: dict[int, int] = {}
    for part in parts:
        mesh = part.manifold.to_mesh64()
        runs = len(mesh.run_original_id)
        base = reserve_ids(runs)
        originals.update(zip(range(base, base + runs), np.asarray(mesh.run_original_id).tolist()))
        fresh = Mesh64(
            np.array(mesh.vert_properties, float),
            np.array(mesh.tri_verts, np.uint64),
            run_index=np.array(mesh.run_index, np.uint64),
            run_flags=np.array(mesh.run_flags, np.uint8),
            run_original_id=np.arange(base, base + runs, dtype=np.uint32),
            face_id=np.array(mesh.face_id, np.uint64),
        )
        renamed += as_parts(Manifold(fresh), part.planes, part.surfaces)
    return renamed, originals
