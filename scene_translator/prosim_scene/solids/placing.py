"""The meshes of all solids, and the planes of their facets.

Many solids have one mesh but for their place: what such have in common is computed together.
"""

from collections.abc import Iterator

import numpy as np

from .grouping import alike
from .primitives import Mesh
from .solid import Solid

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
