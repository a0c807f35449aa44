"""Solids: primitives at their places in the world, their meshes, and the planes of their facets.

Many solids have one mesh but for their place: what such have in common is computed together.
"""

import math
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from .. import model
from .grouping import alike
from .primitives import Mesh, Primitive

AXES = {"rotate-x": (1, 2), "rotate-y": (2, 0), "rotate-z": (0, 1)}  # that one turns towards the other


def matrix(transform: model.Transform) -> np.ndarray:
    """The 4x4 matrix of a TRANSFORM."""
    (result,) = matrices([transform])
    return np.asarray(result)


def matrices(transforms: Sequence[model.Transform]) -> np.ndarray:
    """The matrices (n, 4, 4) of TRANSFORMs: their steps in the order in which they are applied.

    Those with the same kinds of steps are computed together.
    """
    result = np.tile(np.eye(4), (len(transforms), 1, 1))
    for kinds, numbers in alike(tuple(step.kind for step in transform.steps) for transform in transforms).items():
        some = result[numbers]
        for i, kind in enumerate(kinds):
            some = _matrices(kind, np.array([transforms[n].steps[i].values for n in numbers])) @ some
        result[numbers] = some
    return result


def _matrices(kind: str, values: np.ndarray) -> np.ndarray:
    """Those (n, 4, 4) of steps of one kind, with the ``values`` (n, 3), or (n, 1) degrees."""
    result = np.tile(np.eye(4), (len(values), 1, 1))
    if kind == "scale":
        result[:, [0, 1, 2], [0, 1, 2]] = values
    elif kind == "translate":
        result[:, :3, 3] = values
    else:
        quarters, rest = np.divmod(values[:, 0], 90)  # a right angle is exact
        angles = np.radians(rest).tolist()
        sine, cosine = np.array([(math.sin(a), math.cos(a)) for a in angles]).T
        quarter = (quarters % 4).astype(int)
        i, j = AXES[kind]
        result[:, i, i] = result[:, j, j] = np.choose(quarter, [cosine, -sine, -cosine, sine])
        result[:, j, i] = np.choose(quarter, [sine, cosine, -sine, -cosine])
        result[:, i, j] = -result[:, j, i]
    return result


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
    surfaces: np.ndarray = field(default_factory=lambda: np.array([-1]))
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
        if self.framed or self.primitive.curved is None:
            return self.primitive.mesh(self.segments, self.frame)
        return _unit_mesh(self.primitive, self.segments)


@lru_cache(maxsize=64)
def _unit_mesh(primitive: Primitive, segments: int) -> Mesh:
    return primitive.mesh(segments, IDENTITY)


CHUNK = 1 << 18  # triangles at a time


def corners(solids: list[Solid]) -> np.ndarray:
    """The corners (n, 8, 3) in the world of the boxes around solids."""
    own = np.array([s.primitive.box_corners for s in solids]).reshape(-1, 8, 3)
    to_world = np.array([s.to_world for s in solids]).reshape(-1, 4, 4)
    return np.asarray(own @ to_world[:, :3, :3].transpose(0, 2, 1) + to_world[:, None, :3, 3])


def placed(solids: list[Solid]) -> list[Mesh]:
    """The meshes of solids in the world, wound counter-clockwise seen from outside."""
    result: dict[int, Mesh] = {}
    for numbers in alike(s.own_mesh_key for s in solids).values():
        unit = solids[numbers[0]].own_mesh()
        a, b, c = (unit.vertices[unit.triangles[:, i]] for i in range(3))
        outside_in = np.einsum("ij,ij->", a, np.cross(b, c)) < 0  # of the volume
        triangles = {False: unit.triangles, True: unit.triangles[:, ::-1]}
        for chunk in chunks(numbers, len(unit.triangles)):
            to_world = np.array([solids[i].to_world for i in chunk])
            shrink = np.array([[solids[i].shrink] for i in chunk])
            scale = np.where(np.arange(3) < solids[chunk[0]].primitive.axes, shrink, 1.0)
            linear = to_world[:, :3, :3]
            vertices = (unit.vertices * scale[:, None]) @ linear.transpose(0, 2, 1) + to_world[:, None, :3, 3]
            inwards = (np.linalg.det(linear) < 0) != outside_in
            for i, points, turned in zip(chunk, vertices, inwards.tolist()):
                result[i] = Mesh(points, triangles[turned], unit.facets, unit.faces)
    return [result[i] for i in range(len(solids))]


def facet_planes(meshes: list[Mesh]) -> np.ndarray:
    """The planes (k, 4) of the facets of meshes, one mesh after the other: outward unit normals and offsets."""
    result: dict[int, np.ndarray] = {}
    for numbers in alike(id(m.triangles) for m in meshes).values():
        triangles, facets = meshes[numbers[0]].triangles, meshes[numbers[0]].facets
        count = len(meshes[numbers[0]].faces)
        for chunk in chunks(numbers, len(triangles)):
            vertices = np.array([meshes[i].vertices for i in chunk])
            a, b, c = (vertices[:, triangles[:, i]].reshape(-1, 3) for i in range(3))
            cross = np.cross(b - a, c - a)
            weight = np.linalg.norm(cross, axis=1)
            facet = (facets + count * np.arange(len(chunk))[:, None]).ravel()
            middles = weight[:, None] * (a + b + c) / 3
            normal: np.ndarray = np.stack([np.bincount(facet, cross[:, i]) for i in range(3)], axis=1)
            middle: np.ndarray = np.stack([np.bincount(facet, middles[:, i]) for i in range(3)], axis=1)
            middle /= np.bincount(facet, weight)[:, None]
            normal /= np.linalg.norm(normal, axis=1, keepdims=True)
            planes = np.append(normal, -np.einsum("ij,ij->i", normal, middle)[:, None], axis=1)
            result |= zip(chunk, planes.reshape(len(chunk), count, 4))
    return np.concatenate([np.empty((0, 4)), *(result[i] for i in range(len(meshes)))])


def chunks(numbers: list[int], triangles: int) -> Iterator[list[int]]:
    """Some of the numbers at a time, of meshes with so many triangles each."""
    step = max(CHUNK // triangles, 1)
    return (numbers[i : i + step] for i in range(0, len(numbers), step))
