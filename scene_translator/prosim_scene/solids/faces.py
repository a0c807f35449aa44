"""The triangles of a whole result, and those of them that look alike."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np


class Skin(NamedTuple):
    """What triangles look alike by: the material of their primitive, and the media on both sides.

    ``outside`` is where the normal points, None is air. Of what is opaque ``inside`` is None, and ``outside`` too if it
    does not reflect by Fresnel's equations.
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


@dataclass(eq=False)
class Piece:
    """Triangles of a result, with the codes of the kinds of each, ``kind`` (n,), and of each vertex, ``vertex_kind``
    (k,). No vertex is of two kinds. Those that are not ``high`` (n,) are seams of no width.
    """

    triangles: Triangles
    kind: np.ndarray
    vertex_kind: np.ndarray
    high: np.ndarray


def corner_keys(of: np.ndarray, face: np.ndarray, uv: np.ndarray, alone: np.ndarray, first: int = 0) -> np.ndarray:
    """Keys (n, 3), equal for equal corners: those ``of`` (n, 3) the same number, ``face`` (n,) and turn of ``uv``
    (n, 3, 2). Those that stand ``alone`` (n, 3) have keys of their own, which are numbered from ``first``.
    """
    wrapped = (np.floor(uv[..., 0]) > 0).astype(int)
    keys = np.asarray((of * 8 + face[:, None]) * 2 + wrapped)
    keys[alone] = -1 - np.arange(first, first + alone.sum())
    return keys


def heights(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Heights of triangles (n, 3) over their longest sides: those in a seam of coincident faces have none."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    longest = np.sqrt(np.max([np.sum(d * d, axis=1) for d in (b - a, c - b, a - c)], axis=0))
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / np.maximum(longest, 1e-300))


#: No triangles.
NOTHING = Piece(
    Triangles(np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 2)), np.empty((0, 3), int)),
    *(np.empty(0, int), np.empty(0, int), np.empty(0, bool)),
)


@dataclass(eq=False)
class Faces:
    """What a tree comes to, whatever it looks like: all triangles, and the numbers of the kinds of each, ``kind`` (n,),
    and of each vertex, ``vertex_kind`` (k,).

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


def joined(pieces: Sequence[Piece], media: int) -> Faces:
    """All pieces. A kind's code is (leaf m + inside + 1) m + outside + 1, m being ``media``."""
    begin = np.cumsum([0, *(len(piece.vertex_kind) for piece in pieces)])
    columns = zip(*((p.triangles.vertices, p.triangles.normals, p.triangles.uv) for p in pieces))
    vertices, normals, uv = map(np.concatenate, columns)
    index = np.concatenate([p.triangles.index + first for p, first in zip(pieces, begin)])
    codes, kind = np.unique(np.concatenate([p.kind for p in pieces]), return_inverse=True)
    vertex_kind = np.searchsorted(codes, np.concatenate([p.vertex_kind for p in pieces]))
    leaf, sides = np.divmod(codes, media**2)
    kinds = list(zip(leaf.tolist(), (sides // media - 1).tolist(), (sides % media - 1).tolist()))
    high = np.concatenate([p.high for p in pieces])
    seen = np.bincount(kind[high], minlength=len(kinds)) > 0
    return Faces(Triangles(vertices, normals, uv, index), kind, vertex_kind, kinds, seen)


def _sorted(groups: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The numbers of what is of some group, group by group, and where each of ``count`` groups begins and ends."""
    return np.argsort(groups, kind="stable"), np.cumsum(np.bincount(groups + 1, minlength=count + 2))[: count + 1]
