"""All occurrences of primitives in the tree at once: their solids, the planes that they share, normals and uv."""

from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np

from ..language.document import Document
from . import tree
from .coincidence import STEP, Planes
from .detail import choose_segments, warn_if_far
from .inscribed import shrink_inscribed
from .primitives import PRIMITIVES, Mesh
from .recognition import same_surfaces
from .sight import Sight
from .solid import Solid
from .transforms import matrix

FAR = 16  # times its size: a scene that lies farther from the origin than this is computed about its own centre


@dataclass
class Surface:
    """What the triangles of the result show: ``normals`` (n, 3, 3) of unit length, out of the result, ``uv`` (n, 3, 2),
    the number of each triangle's ``face`` (n,), and which corners (n, 3) stand ``alone``.
    """

    normals: np.ndarray
    uv: np.ndarray
    face: np.ndarray
    alone: np.ndarray


class Leaves:
    """Tables for the leaves of a scene.

    ``solids`` are the different ones, ``meshes`` theirs in the world, with ``origin`` as the point 0; ``of_leaf`` has
    the number of a leaf's solid. The facets of all solids are numbered through, those of solid i from ``first[i]``:
    ``faces`` has the face of each, ``planes`` those that facets have in common.
    """

    def __init__(self, document: Document, camera: Sight, tolerance: float) -> None:
        """Raises :class:`SceneError` for a transform that cannot be inverted, and for more than memory can hold."""
        leaves = tree.leaves(document.scene.csg)
        kinds = {kind: i for i, kind in enumerate(dict.fromkeys((leaf.shape, leaf.index) for leaf in leaves))}
        self.of_leaf = np.array([kinds[leaf.shape, leaf.index] for leaf in leaves])
        matrices = {index: _checked_matrix(document, index) for index in dict.fromkeys(index for _, index in kinds)}
        self.solids = [Solid(PRIMITIVES[shape], matrices[index]) for shape, index in kinds]
        boxes = np.array([s.corners() for s in self.solids])
        warn_if_far(document, camera, boxes)
        low, high = boxes.min(axis=(0, 1)), boxes.max(axis=(0, 1))
        middle = (low + high) / 2
        self.origin = middle if np.abs(middle).max() > FAR * (high - low).max() else np.zeros(3)
        self._share()
        choose_segments(document, self.solids, camera, tolerance)
        shrink_inscribed(self.solids)
        for s in self.solids:
            s.to_world = s.to_world - np.pad(self.origin[:, None], ((0, 1), (3, 0)))
        self._number_facets(STEP * float(np.abs(np.stack([low, high]) - self.origin).max()))
        self.to_local = np.linalg.inv([s.to_world for s in self.solids])[:, :3]
        self.shape = np.array([list(PRIMITIVES).index(s.primitive.name) for s in self.solids])

    def _share(self) -> None:
        """Finds the surfaces that several leaves have in common, and the solids that are the same."""
        at = np.array([(i, f) for i, s in enumerate(self.solids) for f in range(len(s.primitive.quadrics))])
        surface = same_surfaces(
            np.concatenate([s.primitive.quadrics for s in self.solids]),
            np.array([s.to_world for s in self.solids])[at[:, 0]],
        )
        bearers = np.bincount(surface, np.bincount(self.of_leaf)[at[:, 0]])
        shared = np.where(bearers[surface] > 1, surface, -1)
        for s, surfaces in zip(self.solids, np.split(shared, np.flatnonzero(np.diff(at[:, 0])) + 1)):
            s.surfaces = surfaces
            if s.curved_surface >= 0 and self.solids[at[s.curved_surface, 0]] is not s:
                s.frame = np.linalg.solve(s.to_world, self.solids[at[s.curved_surface, 0]].to_world)
        same: dict[Hashable, int] = {}
        first = [i if s.key is None else same.setdefault(s.key, i) for i, s in enumerate(self.solids)]
        kept, renumbered = np.unique(first, return_inverse=True)
        self.solids = [self.solids[i] for i in kept]
        self.of_leaf = renumbered[self.of_leaf]

    def _number_facets(self, step: float) -> None:
        """Makes the meshes, and brings them onto the planes that they share."""
        self.meshes = [s.mesh() for s in self.solids]
        counts = [len(m.faces) for m in self.meshes]
        self.first = np.concatenate([[0], np.cumsum(counts)])
        self.faces = np.concatenate([m.faces for m in self.meshes])
        of_facet, side = np.full(self.first[-1], -1), np.ones(self.first[-1])
        known: dict[int, tuple[int, np.ndarray]] = {}  # surface -> the number of its first plane, its planes
        count = 0
        # A surface's planes are those of the facets of the first solid that bears it, which is the largest one.
        sharing = [i for i, s in enumerate(self.solids) if (s.surfaces >= 0).any()]
        sharing.sort(key=lambda i: -np.linalg.norm(self.solids[i].to_world[:3, :3]))
        for i in sharing:
            own = facet_planes(self.meshes[i])
            for face, number in enumerate(self.solids[i].surfaces):
                if number < 0:
                    continue
                facets = np.flatnonzero(self.meshes[i].faces == face)
                if number not in known:
                    known[number] = count, own[facets]
                    count += len(facets)
                start, planes = known[number]
                of_facet[self.first[i] + facets] = start + np.arange(len(facets))
                side[self.first[i] + facets] = np.sign(np.einsum("ij,ij->i", own[facets, :3], planes[:, :3]))
        planes = np.concatenate([np.empty((0, 4)), *(p for _, p in known.values())])
        surface = np.repeat(np.array(list(known), int), [len(p) for _, p in known.values()])
        self.planes = Planes(planes, surface, of_facet, side, step)
        for i in sharing:
            self.meshes[i] = self.planes.adjusted(self.meshes[i], int(self.first[i]))

    def surface(self, positions: np.ndarray, leaf: np.ndarray, facet: np.ndarray, sign: np.ndarray) -> Surface:
        """Normals and surface parameters of triangles (n, 3, 3) of the leaves with these numbers; ``sign`` (n,) is -1
        where the leaf has been taken away.
        """
        solid, face = self.of_leaf[leaf], self.faces[facet]
        inverse = self.to_local[solid]
        local = positions @ inverse[:, :, :3].transpose(0, 2, 1) + inverse[:, None, :, 3]
        normals, uv = np.zeros_like(local), np.zeros((*local.shape[:2], 2))
        alone = np.zeros(local.shape[:2], bool)
        for number, primitive in enumerate(PRIMITIVES.values()):
            chosen = self.shape[solid] == number
            if chosen.any():
                c = primitive.corners(local[chosen], face[chosen])
                normals[chosen], uv[chosen], alone[chosen] = c.normals, c.uv, c.alone
        normals = normals @ inverse[:, :, :3]  # by the inverse's transpose
        length = np.linalg.norm(normals, axis=2, keepdims=True)
        normals *= sign[:, None, None] / np.where(length > 0, length, 1)
        return Surface(normals, uv, face, alone)


def facet_planes(mesh: Mesh) -> np.ndarray:
    """The planes (k, 4) of a mesh's facets, outward unit normals and offsets."""
    a, b, c = (mesh.vertices[mesh.triangles[:, i]] for i in range(3))
    cross = np.cross(b - a, c - a)
    weight = np.linalg.norm(cross, axis=1)
    normal: np.ndarray = np.stack([np.bincount(mesh.facets, cross[:, i]) for i in range(3)], axis=1)
    middle: np.ndarray = np.stack([np.bincount(mesh.facets, weight * (a + b + c)[:, i] / 3) for i in range(3)], axis=1)
    middle /= np.bincount(mesh.facets, weight)[:, None]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.append(normal, -np.einsum("ij,ij->i", normal, middle)[:, None], axis=1)


def _checked_matrix(document: Document, index: int) -> np.ndarray:
    m = matrix(document.scene.transforms[index])
    if not np.isfinite(m).all() or np.linalg.cond(m[:3, :3]) > 1e12:
        raise document.error("this transform is singular or beyond double precision", "transforms", index)
    return m
