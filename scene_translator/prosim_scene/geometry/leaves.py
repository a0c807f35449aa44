"""All occurrences of primitives in the tree at once: their solids, the planes that they share, normals and uv."""

import math
from collections.abc import Hashable, Mapping
from dataclasses import dataclass

import numpy as np

from ..camera import Camera
from ..language.document import Document
from . import csg
from .coincidence import STEP, Planes, same_surfaces
from .detail import active_zones, choose_segments, clipped, shrink_inscribed, warn_if_far
from .grouping import components
from .primitives import PRIMITIVES, Primitive
from .solids import Solid, corners, facet_planes, matrices, placed

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

    ``solids`` are the different ones, ``of_leaf`` has the number of a leaf's solid. After :meth:`make_meshes` there are
    their ``meshes`` in the world, with ``origin`` as the point 0, and the ``boxes`` (n, 2, 3) around these, min and max
    corner. The facets of all solids are numbered through, those of solid i from ``first[i]``: ``faces`` has the face of
    each, ``planes`` those that facets have in common.
    """

    def __init__(
        self,
        document: Document,
        camera: Camera,
        tolerance: float,
        cutters: np.ndarray | None = None,
        meshes: Mapping[str, Primitive] | None = None,
    ) -> None:
        """``cutters`` are those leaves whose faces may coincide with themselves, ``meshes`` the solids in files.

        Raises :class:`SceneError` for a transform that cannot be inverted, and for more than memory can hold.
        """
        leaves = csg.leaves(document.scene.csg)
        kinds = {
            kind: i for i, kind in enumerate(dict.fromkeys((leaf.shape, leaf.file, leaf.index) for leaf in leaves))
        }
        self.of_leaf = np.array([kinds[leaf.shape, leaf.file, leaf.index] for leaf in leaves])
        placing = _checked_matrices(document, list(dict.fromkeys(index for *_, index in kinds)))
        self.solids = [
            Solid(meshes[file] if meshes and file is not None else PRIMITIVES[shape], placing[index])
            for shape, file, index in kinds
        ]
        boxes = corners(self.solids)
        low, high = boxes.min(axis=(0, 1)), boxes.max(axis=(0, 1))
        middle = (low + high) / 2
        self.origin = middle if np.abs(middle).max() > FAR * (high - low).max() else np.zeros(3)
        size = float(np.abs(np.stack([low, high]) - self.origin).max())
        self._step = STEP * 2.0 ** (math.frexp(size)[1] - 1)
        self._share(cutters)
        bounds = active_zones(document.scene.csg, self.solids, self.of_leaf.tolist())
        warn_if_far(document, camera, clipped(corners(self.solids), bounds))
        choose_segments(document, self.solids, bounds, camera, tolerance)
        shrink_inscribed(self.solids)
        offset = np.pad(self.origin[:, None], ((0, 1), (3, 0)))
        for s in self.solids:
            s.to_world = s.to_world - offset
        self.to_local = np.linalg.inv([s.to_world for s in self.solids])[:, :3]
        self.primitives = list(dict.fromkeys(s.primitive for s in self.solids))
        self.shape = np.array([self.primitives.index(s.primitive) for s in self.solids])

    def _share(self, cutters: np.ndarray | None) -> None:
        """Finds the surfaces that leaves which may touch have in common, and the solids that are the same."""
        bearing = np.bincount(self.of_leaf) + (0 if cutters is None else np.bincount(self.of_leaf, cutters))
        counts = [len(s.primitive.quadrics) for s in self.solids]
        if not any(counts):
            return
        at = np.array([(i, f) for i, count in enumerate(counts) for f in range(count)])
        surface = same_surfaces(
            np.concatenate([s.primitive.quadrics for s in self.solids]),
            np.array([s.to_world for s in self.solids])[at[:, 0]],
        )
        surface = self._connected(surface, *at.T)
        bearers = np.bincount(surface, bearing[at[:, 0]])
        shared = np.where(bearers[surface] > 1, surface, -1)
        for s, surfaces in zip(self.solids, np.split(shared, np.cumsum(counts)[:-1])):
            s.surfaces = surfaces if len(surfaces) else s.surfaces
            if s.curved_surface >= 0 and self.solids[at[s.curved_surface, 0]] is not s:
                s.frame = np.linalg.solve(s.to_world, self.solids[at[s.curved_surface, 0]].to_world)
        same: dict[Hashable, int] = {}
        first = [i if s.key is None else same.setdefault(s.key, i) for i, s in enumerate(self.solids)]
        kept, renumbered = np.unique(first, return_inverse=True)
        self.solids = [self.solids[i] for i in kept]
        self.of_leaf = renumbered[self.of_leaf]

    def _connected(self, surface: np.ndarray, solid: np.ndarray, face: np.ndarray) -> np.ndarray:
        """Surfaces (n,) of faces of solids (n,), those of one number split where they do not matter to each other: flat
        ones of solids whose boxes do not touch. Each is numbered by its largest bearer.
        """
        boxes = corners(self.solids)[solid]
        low, high = boxes.min(axis=1) - self._step, boxes.max(axis=1) + self._step
        curved = face == [-1 if (c := self.solids[i].primitive.curved) is None else c for i in solid.tolist()]
        low[curved], high[curved] = low.min(axis=0), high.max(axis=0)
        # Boxes of different surfaces are moved apart, so that all are looked at together.
        apart = np.unique(surface, return_inverse=True)[1] * 2 * (high.max(axis=0) - low.min(axis=0))[0]
        low[:, 0] += apart
        high[:, 0] += apart
        group = components(low, high)
        order = np.lexsort([-np.linalg.norm([s.to_world[:3, :3] for s in self.solids], axis=(1, 2))[solid], group])
        groups, largest = np.unique(group[order], return_index=True)
        return order[largest][np.searchsorted(groups, group)]

    def content(self) -> Hashable:
        """Equal for tables that are the same."""
        solids = tuple(
            (s.primitive.name, s.segments, s.shrink, s.to_world.tobytes(), s.surfaces.tobytes()) for s in self.solids
        )
        return solids, self.of_leaf.tobytes(), self.origin.tobytes()

    def make_meshes(self) -> None:
        """Makes the meshes, and brings them onto the planes that they share."""
        meshes = placed(self.solids)
        counts = np.array([len(m.faces) for m in meshes])
        self.first = np.concatenate([[0], np.cumsum(counts)])
        self.faces = np.concatenate([m.faces for m in meshes])
        # A surface's planes are those of the facets of the first solid that bears it, which is the largest one.
        sharing = [i for i, s in enumerate(self.solids) if (s.surfaces >= 0).any()]
        sharing.sort(key=lambda i: -np.linalg.norm(self.solids[i].to_world[:3, :3]))
        facets = np.concatenate([np.arange(0), *(self.first[i] + np.arange(counts[i]) for i in sharing)])
        own = facet_planes([meshes[i] for i in sharing])
        surface = np.concatenate([np.arange(0), *(self.solids[i].surfaces[meshes[i].faces] for i in sharing)])
        face = np.stack([np.repeat(np.arange(len(sharing)), counts[sharing]), self.faces[facets]])
        facets, own, surface, face = (
            facets[surface >= 0],
            own[surface >= 0],
            surface[surface >= 0],
            face[:, surface >= 0],
        )
        # Face by face, in which a face's facets keep their order.
        order = np.lexsort(face[::-1])
        facets, own, surface, face = facets[order], own[order], surface[order], face[:, order]
        begins = np.flatnonzero(np.append(True, (np.diff(face) != 0).any(axis=0)))[: len(facets)]
        lengths = np.diff(np.append(begins, len(facets)))
        numbers, first, bearer = np.unique(surface[begins], return_index=True, return_inverse=True)
        starts = np.cumsum(lengths[first]) - lengths[first]
        within = np.arange(len(facets)) - np.repeat(begins, lengths)
        plane = starts[np.repeat(bearer, lengths)] + within
        planes = np.empty((lengths[first].sum(), 4))
        planes[plane[::-1]] = own[::-1]  # the first bearer's remain
        of_facet, side = np.full(self.first[-1], -1), np.ones(self.first[-1])
        of_facet[facets] = plane
        side[facets] = np.sign(np.einsum("ij,ij->i", own[:, :3], planes[plane, :3]))
        self.planes = Planes(planes, np.repeat(numbers, lengths[first]), of_facet, side, self._step)
        adjusted = self.planes.adjusted([meshes[i] for i in sharing], self.first[sharing])
        for i, mesh in zip(sharing, adjusted):
            meshes[i] = mesh
        self.meshes = meshes
        begins = np.cumsum([0, *(len(m.vertices) for m in meshes[:-1])])
        vertices = np.concatenate([m.vertices for m in meshes])
        self.boxes = np.stack([np.minimum.reduceat(vertices, begins), np.maximum.reduceat(vertices, begins)], axis=1)

    def surface(self, positions: np.ndarray, leaf: np.ndarray, facet: np.ndarray, sign: np.ndarray) -> Surface:
        """Normals and surface parameters of triangles (n, 3, 3) of the leaves with these numbers; ``sign`` (n,) is -1
        where the leaf has been taken away.
        """
        solid, face = self.of_leaf[leaf], self.faces[facet]
        inverse = self.to_local[solid]
        local = positions @ inverse[:, :, :3].transpose(0, 2, 1) + inverse[:, None, :, 3]
        normals, uv = np.zeros_like(local), np.zeros((*local.shape[:2], 2))
        alone = np.zeros(local.shape[:2], bool)
        for number, primitive in enumerate(self.primitives):
            chosen = self.shape[solid] == number
            if chosen.any():
                c = primitive.corners(local[chosen], face[chosen])
                normals[chosen], uv[chosen], alone[chosen] = c.normals, c.uv, c.alone
        return Surface(self.outwards(normals, solid) * sign[:, None, None], uv, face, alone)

    def outwards(self, normals: np.ndarray, solid: np.ndarray) -> np.ndarray:
        """Normals (..., m, 3) of any length in the spaces of solids (n,) as those in the world (n, m, 3)."""
        normals = normals @ self.to_local[solid][:, :, :3]  # by the inverse's transpose
        length = np.linalg.norm(normals, axis=2, keepdims=True)
        return np.asarray(normals * (1 / np.where(length > 0, length, 1)))


def _checked_matrices(document: Document, indices: list[int]) -> dict[int, np.ndarray]:
    found = matrices([document.scene.transforms[index] for index in indices])
    finite = np.isfinite(found).all(axis=(1, 2))
    conditions = np.linalg.cond(np.where(finite[:, None, None], found, 0)[:, :3, :3])
    for index, wrong in zip(indices, (~finite | ~(conditions <= 1e12)).tolist()):
        if wrong:
            raise document.error("this transform is singular or beyond double precision", "transforms", index)
    return dict(zip(indices, found))
