"""CYLINDER: x^2 + y^2 <= 1, 0 <= z <= 1."""

import numpy as np

from .primitive import MIN_SEGMENTS, Corners, Mesh, Primitive, around_an_axis, circle, longest_axis, plane


class Cylinder(Primitive):
    """Face 0 is the side, 1 the disc at z = 1, 2 that at z = 0."""

    name = "cylinder"
    quadrics = np.array([np.diag([1.0, 1, 0, -1]), plane(0, 0, 1, -1), plane(0, 0, 1, 0)])
    box = np.array([[-1.0, -1, 0], [1, 1, 1]])
    curved = 0
    lines = np.stack([np.append(circle(64), np.full((64, 1), z), axis=1) for z in (0, 1)], axis=1)

    def mesh(self, segments: int, frame: np.ndarray) -> Mesh:
        i = np.arange(segments)
        around = circle(segments) @ frame[:2, :2].T  # the quadric's generators are parallel to z in either space
        ring = np.append(around / np.linalg.norm(around, axis=1, keepdims=True), np.ones((segments, 1)), axis=1)
        following = (i + 1) % segments
        fan = np.stack([np.zeros(segments - 2, int), i[1:-1], i[2:]], axis=1)  # counter-clockwise seen from above
        low = segments  # ring at z = 1, then at z = 0
        triangles = np.concatenate(
            [
                fan,
                fan[:, ::-1] + low,
                np.stack([i, i + low, following], axis=1),
                np.stack([following, i + low, following + low], axis=1),
            ]
        )
        facets = np.concatenate([np.repeat([0, 1], segments - 2), i + 2, i + 2])
        return Mesh(
            np.concatenate([ring, ring * [1, 1, 0]]), triangles, facets, np.append([1, 2], np.zeros(segments, int))
        )

    def count(self, segments: int) -> int:
        return 4 * max(segments, MIN_SEGMENTS) - 4

    def ball(self, linear: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        size = longest_axis(linear[..., :2])
        center = linear[..., 2] / 2
        return size, center, np.linalg.norm(center, axis=-1) + size

    def corners(self, p: np.ndarray, face: np.ndarray) -> Corners:
        return around_an_axis(p, face, p * [1, 1, 0], {1: 1, 2: -1})
