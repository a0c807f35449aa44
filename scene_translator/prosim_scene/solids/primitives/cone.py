"""CONE: x^2 + y^2 <= z^2, 0 <= z <= 1, with its apex at the origin."""

import numpy as np

from .primitive import MIN_SEGMENTS, ON_AXIS, Corners, Mesh, Primitive, around_an_axis, circle, longest_axis, plane


class Cone(Primitive):
    """Face 0 is the side, 1 the disc at z = 1."""

    name = "cone"
    quadrics = np.array([np.diag([1.0, 1, -1, 0]), plane(0, 0, 1, -1)])
    box = np.array([[-1.0, -1, 0], [1, 1, 1]])
    curved = 0
    two_sheets = True
    lines = np.stack([np.append(circle(64), np.ones((64, 1)), axis=1) * z for z in (0, 1)], axis=1)

    def mesh(self, segments: int, frame: np.ndarray) -> Mesh:
        i = np.arange(segments)
        generators = np.append(circle(segments), np.ones((segments, 1)), axis=1) @ frame[:3, :3].T
        ring = np.append(generators[:, :2] / generators[:, 2:], np.ones((segments, 1)), axis=1)
        fan = np.stack([np.zeros(segments - 2, int), i[1:-1], i[2:]], axis=1)  # counter-clockwise seen from above
        triangles = np.concatenate([fan, np.stack([i, np.full(segments, segments), (i + 1) % segments], axis=1)])
        facets = np.concatenate([np.zeros(segments - 2, int), i + 1])
        return Mesh(
            np.append(ring, np.zeros((1, 3)), axis=0), triangles, facets, np.append([1], np.zeros(segments, int))
        )

    def count(self, segments: int) -> int:
        return 2 * max(segments, MIN_SEGMENTS) - 2

    def ball(self, linear: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        size = longest_axis(linear[..., :2])
        center = linear[..., 2] / 2
        return size, center, np.linalg.norm(center, axis=-1) + size

    def corners(self, p: np.ndarray, face: np.ndarray) -> Corners:
        side = around_an_axis(p, face, p * [1, 1, -1], {1: 1})
        apex = (np.linalg.norm(p, axis=2) < ON_AXIS) & (face == 0)[:, None]
        tips = apex.any(axis=1)
        # The apex has no normal: each triangle takes that of the generator through the middle of its other corners.
        middle = np.where(apex[..., None], 0, p)[tips].sum(axis=1) * [1, 1, 0]
        middle /= np.maximum(np.linalg.norm(middle, axis=1, keepdims=True), 1e-300)
        middle[:, 2] = -1
        side.normals[tips] = np.where(apex[tips][..., None], middle[:, None], side.normals[tips])
        return Corners(side.normals, side.uv, side.alone | apex)
