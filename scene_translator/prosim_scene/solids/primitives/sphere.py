"""SPHERE: the unit ball."""

import math

import numpy as np
from manifold3d import Manifold

from .primitive import Corners, Primitive, azimuth


class Sphere(Primitive):
    """Its mesh is an octahedron, each face of which is divided into equal triangles."""

    name = "sphere"
    quadrics = [np.diag([1.0, 1, 1, -1])]
    box = ((-1, -1, -1), (1, 1, 1))
    segment_factor = 1.64  # an octahedral sphere needs so many times the segments of a circle

    def mesh(self, segments: int) -> tuple[np.ndarray, np.ndarray]:
        mesh = Manifold.sphere(1.0, segments).to_mesh64()
        vertices = np.array(mesh.vert_properties)[:, :3]
        return vertices / np.linalg.norm(vertices, axis=1, keepdims=True), np.array(mesh.tri_verts, dtype=np.int64)

    def round_part(self, linear):
        size = np.linalg.norm(linear, 2)
        return size, np.zeros(3), size

    def inside(self, x, y, z):
        return x * x + y * y + z * z <= 1

    def on_surface(self, p: np.ndarray, face: np.ndarray) -> np.ndarray:
        return p * (1 / np.maximum(np.linalg.norm(p, axis=1), 1e-300))[:, None]

    def corners(self, p: np.ndarray) -> Corners:
        radius = np.linalg.norm(p, axis=2)
        u, pole = azimuth(p)
        v = np.arccos(np.clip(p[..., 2] / radius, -1, 1)) / math.pi
        return Corners(p, np.stack([u, v], axis=2), np.zeros(len(p), int), pole)
