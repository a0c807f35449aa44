"""Defines solids, which are primitives with their transforms, makes their meshes, and converts TRANSFORM statements to
matrices.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from .. import model
from .grouping import group_equal
from .primitives import Mesh, Primitive

IDENTITY = np.eye(4)
IDENTITY.flags.writeable = False


@dataclass(frozen=True, eq=False)
class Solid:
    """A primitive with its transform; leaves of the CSG tree with the same primitive and transform share one solid.

    The 4x4 matrix ``to_world`` is the transform. ``segments`` is the number of line segments by which the mesh
    approximates a full circle. ``surfaces`` has, for each face of the solid, the number of the surface (plane or
    quadric) that the face shares with faces of other solids, or -1 if the face shares no surface. If several solids
    share a curved surface, their meshes have the same facets on this surface: those of the owner of the surface, the
    largest of these solids. Tori with nearly the same surface also have the facets of one of them. Solids with the
    same facets have the same number ``pattern``; -1 stands for own facets. The 4x4 matrix ``facet_map`` moves the
    facets of the curved face: it maps the space of the solid with these facets to the space of this solid, or
    concentrates the facets of a ball near a visible cap. The mesh of the curved face is made smaller by ``scale``,
    which is below 1 only if the face touches another one from inside.
    """

    primitive: Primitive
    to_world: np.ndarray
    segments: int = 0
    surfaces: np.ndarray = field(default_factory=lambda: np.array([-1]))
    pattern: int = -1
    facet_map: np.ndarray = field(default_factory=lambda: IDENTITY)
    scale: float = 1.0

    @property
    def inradius(self) -> float:
        """The inradius of the curved face's mesh, for radius 1; without ``facet_map`` and ``scale``."""
        return inradius(self.primitive, self.segments)

    def mesh(self) -> Mesh:
        """Returns the mesh of the solid in world coordinates, with the effects of ``facet_map`` and ``scale``; the
        triangles are counter-clockwise if seen from outside, also if the transform mirrors the primitive.
        """
        linear, offset = self.to_world[:3, :3], self.to_world[:3, 3]
        mirrored = np.linalg.det(linear) < 0
        if self.facet_map is not IDENTITY:
            unit = self.primitive.mesh(self.segments, self.facet_map)
            a, b, c = (unit.vertices[unit.triangles[:, i]] for i in range(3))
            mirrored ^= np.einsum("ij,ij->", a, np.cross(b, c)) < 0  # the sign of the mesh's volume
        else:
            unit = unit_mesh(self.primitive, self.segments)
        vertices = unit.vertices if self.scale == 1 else self.primitive.scaled(unit.vertices, self.scale)
        triangles = unit.triangles[:, ::-1] if mirrored else unit.triangles
        return Mesh(vertices @ linear.T + offset, triangles, unit.facets, unit.faces)


@lru_cache(maxsize=64)
def unit_mesh(primitive: Primitive, segments: int) -> Mesh:
    """Returns the mesh of a primitive in its coordinates; the result is cached."""
    return primitive.mesh(segments, IDENTITY)


@lru_cache(maxsize=1024)
def inradius(primitive: Primitive, segments: int) -> float:
    """Returns the inradius of the mesh of a primitive's curved face, of radius 1, in the primitive's coordinates."""
    if primitive.name != "sphere":
        return math.cos(primitive.segment_factor * math.pi / segments)
    mesh = unit_mesh(primitive, segments)
    return float(plane_heights(mesh).min())


def plane_heights(mesh: Mesh) -> np.ndarray:
    """Returns the height of each triangle's plane over the origin, below 0 if the origin is outside of the plane."""
    a, b, c = (mesh.vertices[mesh.triangles[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    return np.asarray(np.einsum("ij,ij->i", normals, a) / np.linalg.norm(normals, axis=1))


def world_boxes(solids: Sequence[Solid]) -> tuple[np.ndarray, np.ndarray]:
    """Returns the minimum and the maximum corners (n, 3) of boxes, in world coordinates, around the boxes of n solids'
    primitives.
    """
    own = np.array([s.primitive.box_corners for s in solids]).reshape(-1, 8, 3)
    to_world = np.array([s.to_world for s in solids]).reshape(-1, 4, 4)
    corners = own @ to_world[:, :3, :3].transpose(0, 2, 1) + to_world[:, None, :3, 3]
    return corners.min(axis=1), corners.max(axis=1)


AXES = {"rotate-x": (1, 2), "rotate-y": (2, 0), "rotate-z": (0, 1)}  # turns the first axis towards the second


def matrices(transforms: Sequence[model.Transform]) -> np.ndarray:
    """Returns the matrices (n, 4, 4) of n TRANSFORMs; those with equal sequences of steps are computed in one batch."""
    result = np.tile(np.eye(4), (len(transforms), 1, 1))
    for kinds, numbers in group_equal(tuple(step.kind for step in transform.steps) for transform in transforms).items():
        batch = result[numbers]
        for i, kind in enumerate(kinds):
            batch = _matrices(kind, np.array([transforms[n].steps[i].values for n in numbers])) @ batch
        result[numbers] = batch
    return result


def _matrices(kind: str, values: np.ndarray) -> np.ndarray:
    result = np.tile(np.eye(4), (len(values), 1, 1))
    if kind == "scale":
        result[:, [0, 1, 2], [0, 1, 2]] = values
    elif kind == "translate":
        result[:, :3, 3] = values
    elif kind == "matrix":
        result[:, :3] = values.reshape(-1, 3, 4)
    else:
        quarters, rest = np.divmod(values[:, 0], 90)  # multiples of 90 degrees have no rounding error
        angles = np.radians(rest).tolist()
        sine, cosine = np.array([(math.sin(a), math.cos(a)) for a in angles]).T
        quarter = (quarters % 4).astype(int)
        i, j = AXES[kind]
        result[:, i, i] = result[:, j, j] = np.choose(quarter, [cosine, -sine, -cosine, sine])
        result[:, j, i] = np.choose(quarter, [sine, cosine, -sine, -cosine])
        result[:, i, j] = -result[:, j, i]
    return result
