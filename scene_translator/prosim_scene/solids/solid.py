"""A primitive at its place in the world."""

import math
from collections.abc import Hashable
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from .primitives import Mesh, Primitive

IDENTITY = np.eye(4)
IDENTITY.flags.writeable = False


@dataclass(eq=False)
class Solid:
    """A primitive at its place; leaves of the tree that are the same share one.

    ``to_world`` is a 4x4 matrix, ``segments`` the number around a circle, ``surfaces`` are the numbers of those that it
    has in common with others, by the number of the face, or -1, and ``frame`` is the map to its space from that of the
    primitive that its curved face has its facets from. ``shrink`` is a factor of the curved face's size, 1 or a little
    less.
    """

    primitive: Primitive
    to_world: np.ndarray
    segments: int = 0
    surfaces: np.ndarray = field(default_factory=lambda: np.empty(0, int))
    frame: np.ndarray = field(default_factory=lambda: IDENTITY)
    shrink: float = 1.0

    @property
    def framed(self) -> bool:
        """Whether its curved face's facets lie elsewhere than in the primitive's own mesh."""
        return self.frame is not IDENTITY and bool((self.frame != IDENTITY).any())

    @property
    def widest(self) -> float:
        """The longest semi-axis of its curved face."""
        return float(self.primitive.ball(self.to_world[:3, :3])[0])

    @property
    def narrowest(self) -> float:
        """The shortest semi-axis of its curved face."""
        return float(np.linalg.norm(self.to_world[:3, : self.primitive.axes], -2))

    @property
    def inradius(self) -> float:
        """The curved face's, in its own unit, of the mesh without ``frame`` and ``shrink``."""
        return math.cos(math.pi * self.primitive.segment_factor / self.segments)

    @property
    def curved_surface(self) -> int:
        """The number of the surface of its curved face, -1 where it has none or is alone on it."""
        return -1 if self.primitive.curved is None else int(self.surfaces[self.primitive.curved])

    @property
    def key(self) -> Hashable:
        """Equal for solids that are the same; None where one of its surfaces shows that there is no other."""
        surfaces = self.surfaces.tolist()
        return None if min(surfaces, default=0) < 0 else (self.primitive.name, frozenset(surfaces))

    @property
    def own_mesh_key(self) -> Hashable:
        """Equal for solids with the same :meth:`own_mesh`."""
        return id(self) if self.framed else (self.primitive.name, self.segments)

    def own_mesh(self) -> Mesh:
        """The primitive's mesh in its own space."""
        if self.framed:
            return self.primitive.mesh(self.segments, self.frame)
        return _unit_mesh(self.primitive, self.segments)


@lru_cache(maxsize=64)
def _unit_mesh(primitive: Primitive, segments: int) -> Mesh:
    return primitive.mesh(segments, IDENTITY)
