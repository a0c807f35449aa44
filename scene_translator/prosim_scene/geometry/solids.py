"""Solids: primitives with their transforms, and their meshes."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np

from .primitives import Mesh, Primitive

IDENTITY = np.eye(4)
IDENTITY.flags.writeable = False


@dataclass(eq=False)
class Solid:
    """A primitive with its transform; equal leaves of the CSG tree share one solid.

    ``to_world`` is a 4x4 matrix. ``segments`` is the number of segments around a circle. ``surfaces`` has for each face
    the number of the surface that it shares with other solids, or -1. If several solids share a curved surface, all of
    them use the facets of its owner, the largest solid. ``facet_map`` maps the owner's space to the space of this
    solid. ``shrink`` is a factor of the curved face's size: 1 or slightly less.
    """

    primitive: Primitive
    to_world: np.ndarray
    segments: int = 0
    surfaces: np.ndarray = field(default_factory=lambda: np.array([-1]))
    facet_map: np.ndarray = field(default_factory=lambda: IDENTITY)
    shrink: float = 1.0

    @cached_property
    def narrowest(self) -> float:
        """The shortest semi-axis of the curved face in the world."""
        return float(np.linalg.norm(self.to_world[:3, : self.primitive.axes], -2))

    @property
    def inradius(self) -> float:
        """The inradius of the mesh of the curved face in the primitive's space, without ``facet_map`` and
        ``shrink``.
        """
        return math.cos(math.pi * self.primitive.segment_factor / self.segments)

    @property
    def curved_surface(self) -> int:
        """The number of the shared surface on which the curved face lies, or -1 if there is no such surface."""
        return -1 if self.primitive.curved is None else int(self.surfaces[self.primitive.curved])

    def mesh(self) -> Mesh:
        """Returns the mesh of the solid in the world; its triangles are counter-clockwise if seen from outside."""
        linear, offset = self.to_world[:3, :3], self.to_world[:3, 3]
        mirrored = np.linalg.det(linear) < 0
        if self.facet_map is not IDENTITY:
            unit = self.primitive.mesh(self.segments, self.facet_map)
            a, b, c = (unit.vertices[unit.triangles[:, i]] for i in range(3))
            mirrored ^= np.einsum("ij,ij->", a, np.cross(b, c)) < 0  # the sign of the mesh's volume
        else:
            unit = unit_mesh(self.primitive, self.segments)
        vertices = unit.vertices * np.where(np.arange(3) < self.primitive.axes, self.shrink, 1.0)
        triangles = unit.triangles[:, ::-1] if mirrored else unit.triangles
        return Mesh(vertices @ linear.T + offset, triangles, unit.facets, unit.faces)


@lru_cache(maxsize=64)
def unit_mesh(primitive: Primitive, segments: int) -> Mesh:
    """Returns the mesh of a primitive in its own space; the result is cached for equal solids."""
    return primitive.mesh(segments, IDENTITY)


def world_box_corners(solids: Sequence[Solid]) -> np.ndarray:
    """Returns the corners (n, 8, 3) of the bounding boxes of solids, transformed to the world."""
    own = np.array([s.primitive.box_corners for s in solids]).reshape(-1, 8, 3)
    to_world = np.array([s.to_world for s in solids]).reshape(-1, 4, 4)
    return np.asarray(own @ to_world[:, :3, :3].transpose(0, 2, 1) + to_world[:, None, :3, 3])
