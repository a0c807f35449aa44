"""CYLINDER: x^2 + y^2 <= 1, 0 <= z <= 1."""

import numpy as np

from .primitive import Corners, Primitive, around_an_axis, circle, plane


class Cylinder(Primitive):
    """Face 0 is the side, 1 the disc at z = 1, 2 that at z = 0."""

    name = "cylinder"
    quadrics = [np.diag([1.0, 1, 0, -1]), plane(0, 0, 1, -1), plane(0, 0, 1, 0)]
    box = ((-1, -1, 0), (1, 1, 1))

    def mesh(self, segments: int) -> tuple[np.ndarray, np.ndarray]:
        i = np.arange(segments)
        ring = np.concatenate([circle(segments), np.ones((segments, 1))], axis=1)
        following = (i + 1) % segments
        fan = np.stack([np.zeros(segments - 2, int), i[1:-1], i[2:]], axis=1)  # counter-clockwise seen from above
        low = segments  # ring at z = 1, then at z = 0
        return (np.concatenate([ring, ring * [1, 1, 0]]),
                np.concatenate([fan, fan[:, ::-1] + low, np.stack([i, i + low, following], axis=1),
                                np.stack([following, i + low, following + low], axis=1)]))

    def round_part(self, linear):
        size = np.linalg.norm(linear[:, :2], 2)
        center = linear @ [0, 0, 0.5]
        return size, center, np.linalg.norm(center) + size

    def inside(self, x, y, z):
        return (x * x + y * y <= 1) & (z >= 0) & (z <= 1)

    def flat_face(self, face: int, segments: int):
        return None if face == 0 else (2, 1 if face == 1 else -1, [0, 1], circle(segments))

    def on_surface(self, p: np.ndarray, face: np.ndarray) -> np.ndarray:
        factor = np.where(face == 0, 1 / np.maximum(np.hypot(p[:, 0], p[:, 1]), 1e-300), 1)
        return p * np.stack([factor, factor, np.ones_like(factor)], axis=1)

    def corners(self, p: np.ndarray) -> Corners:
        return around_an_axis(p, {1: 1.0, 2: 0.0}, p * [1, 1, 0])
