"""The triangles of a whole result, and those of them that look alike."""

from collections.abc import Hashable
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
    """Triangles of one material, corner by corner: positions (n, 3, 3), unit normals (n, 3, 3), uv (n, 3, 2), and a key
    (n, 3) that is equal for equal corners.
    """

    positions: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    keys: np.ndarray


@dataclass(eq=False)
class Faces:
    """What a tree comes to, whatever it looks like: all triangles, and the number of the ``kind`` (n,) of each.

    ``kinds`` are the numbers of their leaf and of the media that lie inside and outside. ``seen`` (kinds,) says of
    which there is more than seams of no width.
    """

    triangles: Triangles
    kind: np.ndarray
    kinds: list[tuple[int, int, int]]
    seen: np.ndarray
    _chosen: dict[tuple[int, ...], Triangles] = field(default_factory=dict)

    def chosen(self, groups: list[tuple[int, ...]]) -> list[Triangles]:
        """The triangles of groups of kinds; a group of the last call has the same ones again."""
        group_of = np.full(len(self.kinds), len(groups))
        for number, kinds in enumerate(groups):
            group_of[list(kinds)] = number
        order = np.argsort(group_of[self.kind], kind="stable")
        begins = np.searchsorted(group_of[self.kind], np.arange(len(groups) + 1), sorter=order)
        of = self.triangles
        self._chosen = {
            kinds: self._chosen.get(kinds)
            or Triangles(*(a[order[begin:end]] for a in (of.positions, of.normals, of.uv, of.keys)))
            for kinds, begin, end in zip(groups, begins, begins[1:])
        }
        return list(self._chosen.values())
