"""What one tessellation leaves for later ones."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass

import numpy as np

from .detail import MOST_TRIANGLES


@dataclass(frozen=True)
class Faces:
    """The triangles of a whole result, whatever they look like.

    Each has the number of its ``leaf`` (n,), and ``positions`` (n, 3, 3), ``normals`` (n, 3, 3), ``uv`` (n, 3, 2) and
    ``keys`` (n, 3) as in :class:`.Triangles`; ``seen`` (leaves,) says of which leaves there is something to see.
    """

    leaf: np.ndarray
    positions: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    keys: np.ndarray
    seen: np.ndarray


class Kept:
    """Results of trees that have been evaluated, by all that they follow from; the oldest make place for new ones.

    A caller who translates a scene again and again makes one, and passes it to each translation. Where the tree, its
    transforms, how fine its faces are and which of them are glass have stayed the same, the tree is not evaluated anew.
    """

    def __init__(self, most: int = MOST_TRIANGLES) -> None:
        """``most`` triangles are kept, of 240 bytes each."""
        self.most = most
        self._results: OrderedDict[Hashable, Faces] = OrderedDict()

    def faces(self, key: Hashable, evaluate: Callable[[], Faces]) -> Faces:
        """What is kept under a key, or else what ``evaluate()`` gives, which is kept from now on."""
        found = self._results.pop(key, None) or evaluate()
        self._results[key] = found
        while sum(len(faces.leaf) for faces in self._results.values()) > self.most:
            self._results.popitem(last=False)
        return found
