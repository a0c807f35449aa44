"""CONE: x^2 + y^2 <= z^2, 0 <= z <= 1, with its apex at the origin."""

import numpy as np

from .primitive import ON_FACE, Corners, Primitive, around_an_axis, circle, plane


class Cone(Primitive):
    """Face 0 is the side, 1 the disc at z = 1."""

    name = "cone"
    quadrics = [np.diag([1.0, 1, -1, 0]), plane(0, 0, 1, -1)]
    box = ((-1, -1, 0), (1, 1, 1))

    def mesh(self, segments: int) -> tuple[np.ndarray, np.ndarray]:
        i = np.arange(segments)
        ring = np.concatenate([circle(segments), np.ones((segments, 1))], axis=1)
        fan = np.stack([np.zeros(segments - 2, int), i[1:-1], i[2:]], axis=1)  # counter-clockwise seen from above
        return (np.concatenate([ring, np.zeros((1, 3))]),
                np.concatenate([fan, np.stack([i, np.full(segments, segments), (i + 1) % segments], axis=1)]))

    def round_part(self, linear):
        size = np.linalg.norm(linear[:, :2], 2)
        center = linear @ [0, 0, 0.5]
        return size, center, np.linalg.norm(center) + size

    def inside(self, x, y, z):
        return (x * x + y * y <= z * z) & (z >= 0) & (z <= 1)

    def flat_face(self, face: int, segments: int):
        return None if face == 0 else (2, 1, [0, 1], circle(segments))

    def on_surface(self, p: np.ndarray, face: np.ndarray) -> np.ndarray:
        factor = np.where(face == 0, np.abs(p[:, 2]) / np.maximum(np.hypot(p[:, 0], p[:, 1]), 1e-300), 1)
        return p * np.stack([factor, factor, np.ones_like(factor)], axis=1)

    def corners(self, p: np.ndarray) -> Corners:
        result = around_an_axis(p, {1: 1.0}, p * [1, 1, -1])
        apex = (np.linalg.norm(p, axis=2) < ON_FACE) & (result.face == 0)[:, None]
        tips = apex.any(axis=1)
        # The apex has no normal: each triangle takes that of the generator through the middle of its other corners.
        middle = np.where(apex[..., None], 0, p)[tips].sum(axis=1) * [1, 1, 0]
        middle /= np.maximum(np.linalg.norm(middle, axis=1, keepdims=True), 1e-300)
        middle[:, 2] = -1
        result.normals[tips] = np.where(apex[tips][..., None], middle[:, None], result.normals[tips])
        result.alone |= apex
        return result
