"""The triangles of a whole result, and those of them that look alike."""

from dataclasses import dataclass, field

import numpy as np


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
    """What a tree comes to, whatever it looks like: all triangles, and the number of the ``leaf`` (n,) of each.

    ``seen`` (leaves,) says of which leaves there is more than seams of no width.
    """

    triangles: Triangles
    leaf: np.ndarray
    seen: np.ndarray
    _chosen: dict[tuple[int, ...], Triangles] = field(default_factory=dict)

    def chosen(self, groups: list[tuple[int, ...]]) -> list[Triangles]:
        """The triangles of groups of leaves; a group of the last call has the same ones again."""
        group_of = np.full(len(self.seen), len(groups))
        for number, leaves in enumerate(groups):
            group_of[list(leaves)] = number
        order = np.argsort(group_of[self.leaf], kind="stable")
        begins = np.searchsorted(group_of[self.leaf], np.arange(len(groups) + 1), sorter=order)
        of = self.triangles
        self._chosen = {
            leaves: self._chosen.get(leaves)
            or Triangles(*(a[order[begin:end]] for a in (of.positions, of.normals, of.uv, of.keys)))
            for leaves, begin, end in zip(groups, begins, begins[1:])
        }
        return list(self._chosen.values())
