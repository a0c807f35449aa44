"""CUBE: [0, 1]^3."""

from typing import ClassVar

import numpy as np

from .primitive import Corners, Mesh, Primitive, box_corners, plane


class Cube(Primitive):
    """Faces 0 to 2 are those at 0 of the x, y and z axes, 3 to 5 those at 1."""

    name = "cube"
    quadrics = np.array([plane(*n, d) for d in (0, -1) for n in np.eye(3)])
    box = np.array([[0.0, 0, 0], [1, 1, 1]])
    #: Each face's corners, counter-clockwise from outside; corner 4 x + 2 y + z is (x, y, z).
    squares: ClassVar[list[tuple[int, int, int, int]]] = [
        (0, 1, 3, 2),
        (0, 4, 5, 1),
        (0, 2, 6, 4),
        (4, 6, 7, 5),
        (2, 3, 7, 6),
        (1, 5, 7, 3),
    ]

    def mesh(self, segments: int, frame: np.ndarray) -> Mesh:
        triangles = np.array([t for a, b, c, d in self.squares for t in ((a, b, c), (a, c, d))])
        return Mesh(box_corners(self.box), triangles, np.repeat(np.arange(6), 2), np.arange(6))

    def count(self, segments: int) -> int:
        return 12

    def corners(self, p: np.ndarray, face: np.ndarray) -> Corners:
        normals = np.zeros_like(p)
        axis = face % 3
        normals[np.arange(len(p)), :, axis] = np.where(face < 3, -1, 1)[:, None]
        across = np.array([[1, 2], [0, 2], [0, 1]])[axis]  # (y, z), (x, z), (x, y)
        uv = np.take_along_axis(p, np.repeat(across[:, None], 3, axis=1), axis=2)
        return Corners(normals, uv, np.zeros(p.shape[:2], bool))
