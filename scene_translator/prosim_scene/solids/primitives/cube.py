"""CUBE: [0, 1]^3."""

import numpy as np
from manifold3d import Manifold

from .primitive import Corners, Primitive, plane


class Cube(Primitive):
    """Faces 0 to 2 are those at 0 of the x, y and z axes, 3 to 5 those at 1."""

    name = "cube"
    quadrics = [plane(*n, d) for d in (0, -1) for n in np.eye(3)]
    box = ((0, 0, 0), (1, 1, 1))

    def mesh(self, segments: int) -> tuple[np.ndarray, np.ndarray]:
        mesh = Manifold.cube((1.0, 1.0, 1.0)).to_mesh64()
        return np.array(mesh.vert_properties)[:, :3], np.array(mesh.tri_verts, dtype=np.int64)

    def round_part(self, linear):
        raise NotImplementedError("a cube has no curved faces")

    def segments(self, to_world, camera, tolerance: float) -> int:
        return 4

    def inside(self, x, y, z):
        return (x >= 0) & (x <= 1) & (y >= 0) & (y <= 1) & (z >= 0) & (z <= 1)

    def flat_face(self, face: int, segments: int):
        across = [i for i in range(3) if i != face % 3]
        return face % 3, 1 if face >= 3 else -1, across, np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)

    def corners(self, p: np.ndarray) -> Corners:
        center = p.mean(axis=1)
        face = np.argmin(np.concatenate([np.abs(center), np.abs(1 - center)], axis=1), axis=1)
        normals = np.zeros_like(p)
        axis = face % 3
        normals[np.arange(len(p)), :, axis] = np.where(face < 3, -1, 1)[:, None]
        across = np.array([[1, 2], [0, 2], [0, 1]])[axis]  # (y, z), (x, z), (x, y)
        uv = np.take_along_axis(p, np.repeat(across[:, None], 3, axis=1), axis=2)
        return Corners(normals, uv, face, np.zeros(p.shape[:2], bool))
