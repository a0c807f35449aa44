"""SPHERE: the unit ball."""

import math

import numpy as np
from manifold3d import Manifold

from .primitive import MIN_SEGMENTS, Corners, Mesh, Primitive, azimuth, longest_axis


def _octahedral(segments: int) -> tuple[np.ndarray, np.ndarray]:
    """An octahedron, each face of which is divided into equal triangles, with its vertices on the unit sphere."""
    mesh = Manifold.sphere(1.0, segments).to_mesh64()
    vertices = np.array(mesh.vert_properties)[:, :3]
    return vertices / np.linalg.norm(vertices, axis=1, keepdims=True), np.array(mesh.tri_verts, dtype=np.int64)


class Sphere(Primitive):
    """Its one face is curved, and every triangle of its mesh is a facet."""

    name = "sphere"
    quadrics = np.diag([1.0, 1, 1, -1])[None]
    box = np.array([[-1.0, -1, -1], [1, 1, 1]])
    curved = 0
    axes = 3
    lines = np.repeat(_octahedral(64)[0][:, None], 2, axis=1)  # points, less than 0.05 apart
    segment_factor = 1.64  # the largest triangles lie in the middles of the octahedron's faces

    def mesh(self, segments: int, frame: np.ndarray) -> Mesh:
        vertices, triangles = _octahedral(segments)
        placed = vertices @ frame[:3, :3].T
        if frame[3, :3].any():  # a projective map
            placed = (placed + frame[:3, 3]) / (vertices @ frame[3, :3] + frame[3, 3])[:, None]
        return Mesh(placed, triangles, np.arange(len(triangles)), np.zeros(len(triangles), int))

    def count(self, segments: int) -> int:
        return max(segments, MIN_SEGMENTS) ** 2 // 2

    def ball(self, linear: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        size = longest_axis(linear)
        return size, np.zeros(linear.shape[:-1]), size

    def corners(self, p: np.ndarray, face: np.ndarray) -> Corners:
        radius = np.linalg.norm(p, axis=2)
        u, pole = azimuth(p)
        v = np.arccos(np.clip(p[..., 2] / radius, -1, 1)) / math.pi
        return Corners(p, np.stack([u, v], axis=2), pole)
