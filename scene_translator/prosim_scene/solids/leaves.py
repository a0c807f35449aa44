"""All occurrences of primitives in the tree at once: their places, their surfaces, normals and surface parameters."""

import numpy as np

from ..model import Scene
from . import tree
from .primitives import PRIMITIVES
from .transforms import matrix


class Leaves:
    """Arrays by a leaf's number: ``shape`` (of :attr:`SHAPES`), ``matrix`` to the world and its ``inverse`` (n, 3, 4),
    ``sign``, ``rounds`` (segments around a circle), ``surfaces`` (hashes by the number of the face), and a box,
    ``low`` and ``high``, with a ``margin``."""

    SHAPES = list(PRIMITIVES)

    def __init__(self, scene: Scene, camera, tolerance: float) -> None:
        """Raises :class:`SceneError` for a transform that cannot be inverted."""
        leaves = tree.leaves(scene.csg)
        matrices = {i: matrix(scene.transforms[i]) for i in {leaf.index for leaf in leaves}}
        inverses = {}
        for i, m in matrices.items():
            if not np.isfinite(m).all() or np.linalg.cond(m[:3, :3]) > 1e12:
                raise scene.source.error(scene.transforms[i].at, "this transform is singular or beyond double precision")
            inverses[i] = np.linalg.inv(m)
        kinds = {(leaf.shape, leaf.index) for leaf in leaves}
        surfaces = {(shape, i): _surfaces(shape, inverses[i]) for shape, i in kinds}
        rounds = {(shape, i): PRIMITIVES[shape].segments(matrices[i], camera, tolerance) for shape, i in kinds}
        self.shape = np.array([self.SHAPES.index(leaf.shape) for leaf in leaves])
        self.matrix = np.array([matrices[leaf.index][:3] for leaf in leaves])
        self.inverse = np.array([inverses[leaf.index][:3] for leaf in leaves])
        self.sign = np.array(tree.signs(scene.csg), dtype=float)
        self.surfaces = [surfaces[leaf.shape, leaf.index] for leaf in leaves]
        self.rounds = [rounds[leaf.shape, leaf.index] for leaf in leaves]
        self.alone = 0  # corners so far that are shared with no other triangle
        self.bearers: dict[int, list[int]] = {}  # surface -> the leaves that have a face on it
        for number, hashes in enumerate(self.surfaces):
            for surface in hashes:
                self.bearers.setdefault(surface, []).append(number)
        self.shared = {surface for surface, bearers in self.bearers.items() if len(bearers) > 1}
        # Boxes: the image of the canonical box, exact for cubes and wide enough for the others.
        ends = [PRIMITIVES[name].box for name in self.SHAPES]
        box = np.array([[(x, y, z) for x in (a[0], b[0]) for y in (a[1], b[1]) for z in (a[2], b[2])] for a, b in ends])
        corners = np.einsum("tij,tcj->tci", self.matrix[:, :, :3], box[self.shape]) + self.matrix[:, None, :, 3]
        self.low, self.high = corners.min(axis=1), corners.max(axis=1)
        self.margin = 1e-6 * (self.high - self.low).max(axis=1)

    def primitive(self, number: int):
        """The primitive of a leaf."""
        return PRIMITIVES[self.SHAPES[self.shape[number]]]

    def inside(self, number: int, points: np.ndarray) -> np.ndarray:
        """Which points a leaf contains."""
        return self.primitive(number).inside(*(self.inverse[number, :, :3] @ points.T + self.inverse[number, :, 3:]))

    def flat_face(self, number: int, face: int):
        """Of a flat face: its normal out of the result, its local axes and its convex outline on them; else None."""
        found = self.primitive(number).flat_face(face, self.rounds[number])
        if found is None:
            return None
        axis, side, across, outline = found
        return self.sign[number] * side * self.inverse[number, axis, :3], across, outline

    def others_on(self, number: int, face: int) -> np.ndarray:
        """Leaves other than ``number`` that have a face on the surface of one of its faces, their boxes in reach."""
        others = np.array([b for b in self.bearers[self.surfaces[number][face]] if b != number], dtype=int)
        return others[np.all((self.low[others] <= self.high[number] + self.margin[number])
                             & (self.high[others] >= self.low[number] - self.margin[number]), axis=1)]

    def evaluate(self, positions: np.ndarray, leaf: np.ndarray):
        """World normals of the corners of triangles, uv, which corners are shared by no other triangle, the triangles'
        face numbers and the corners in their primitives' own spaces."""
        inverse = self.inverse[leaf]
        local = positions @ inverse[:, :, :3].transpose(0, 2, 1) + inverse[:, None, :, 3]
        normal, uv = np.zeros_like(local), np.zeros(local.shape[:2] + (2,))
        face = np.zeros(len(leaf), int)
        alone = np.zeros(local.shape[:2], bool)
        for number, name in enumerate(self.SHAPES):
            chosen = self.shape[leaf] == number
            if chosen.any():
                c = PRIMITIVES[name].corners(local[chosen])
                normal[chosen], uv[chosen], face[chosen], alone[chosen] = c.normals, c.uv, c.face, c.alone
        world = normal @ inverse[:, :, :3]  # by the inverse's transpose
        length = np.linalg.norm(world, axis=2, keepdims=True)
        world *= self.sign[leaf, None, None] / np.where(length > 0, length, 1)
        return world, uv, alone, face, local

    def corners(self, positions: np.ndarray, vertex: np.ndarray, leaf: np.ndarray):
        """Positions, normals, uv and keys of the corners of triangles, for their vertex numbers and leaves."""
        world, uv, alone, face, _ = self.evaluate(positions, leaf)
        wrapped = (np.floor(uv[..., 0]) > 0).astype(int)
        keys = ((vertex * len(self.shape) + leaf[:, None]) * 8 + face[:, None]) * 2 + wrapped
        count = int(alone.sum())
        keys[alone] = -1 - np.arange(self.alone, self.alone + count)
        self.alone += count
        return positions, world, uv, keys


def _surfaces(shape: str, inverse: np.ndarray) -> list[int]:
    """Hashes of the quadrics that a primitive's faces lie on, by the number of the face; equal where 7 digits agree."""
    result = []
    for quadric in PRIMITIVES[shape].quadrics:
        q = inverse.T @ quadric @ inverse
        q /= np.abs(q[:3, :3]).max()
        scale = np.abs(q).max(axis=0) + 1  # of the offsets against the directions
        result.append(hash((np.round(q / scale[3] * 1e7) + 0.0).tobytes()))
    return result
