"""All occurrences of primitives in the tree: their solids, the surfaces that they share, normals and uv."""

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..camera import Camera
from ..language.document import Document
from ..model import Leaf
from .coincidence import STEP, Planes, same_surfaces
from .detail import active_zones, choose_segments, clipped, shrink_inscribed, warn_if_far
from .grouping import components
from .primitives import PRIMITIVES, Corners, Primitive
from .solids import Solid, corners
from .transforms import matrices

FAR = 16  # times its size: a scene that lies farther from the origin than this is computed about its own centre


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
        keys = [(x.shape, x.file, x.index) for x in document.scene.csg if isinstance(x, Leaf)]
        kinds = {key: i for i, key in enumerate(dict.fromkeys(keys))}
        self.of_leaf = np.array([kinds[key] for key in keys])
        places = _checked_matrices(document, [index for *_, index in kinds])
        self.solids = [
            Solid(meshes[file] if meshes and file is not None else PRIMITIVES[shape], to_world)
            for (shape, file, _), to_world in zip(kinds, places)
        ]
        boxes = corners(self.solids)
        low, high = boxes.min(axis=(0, 1)), boxes.max(axis=(0, 1))
        middle = (low + high) / 2
        self.origin = middle if np.abs(middle).max() > FAR * (high - low).max() else np.zeros(3)
        size = float(np.abs(np.stack([low, high]) - self.origin).max())
        self.step = STEP * 2.0 ** (math.frexp(size)[1] - 1)
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
        solid = np.repeat(np.arange(len(self.solids)), counts)
        places = np.array([s.to_world for s in self.solids])[solid]
        surface = same_surfaces(np.concatenate([s.primitive.quadrics for s in self.solids]), places)
        surface = self._split(surface, solid)
        bearers = np.bincount(surface, bearing[solid])
        shared = np.where(bearers[surface] > 1, surface, -1)
        for s, surfaces in zip(self.solids, np.split(shared, np.cumsum(counts)[:-1])):
            s.surfaces = surfaces if len(surfaces) else s.surfaces
            if s.curved_surface >= 0 and (bearer := self.solids[solid[s.curved_surface]]) is not s:
                s.frame = np.linalg.solve(s.to_world, bearer.to_world)
        same: dict[Hashable, int] = {}
        first = [i if s.key is None else same.setdefault(s.key, i) for i, s in enumerate(self.solids)]
        kept, renumbered = np.unique(first, return_inverse=True)
        self.solids = [self.solids[i] for i in kept]
        self.of_leaf = renumbered[self.of_leaf]

    def _split(self, surface: np.ndarray, solid: np.ndarray) -> np.ndarray:
        """Surfaces (n,) of faces of solids (n,), flat ones split where they do not matter to each other: where boxes
        do not touch. Each is numbered by its largest bearer.
        """
        boxes = corners(self.solids)[solid]
        low, high = boxes.min(axis=1) - self.step, boxes.max(axis=1) + self.step
        curved = [face == s.primitive.curved for s in self.solids for face in range(len(s.primitive.quadrics))]
        low[curved], high[curved] = low.min(axis=0), high.max(axis=0)
        # Boxes of different surfaces are moved apart, so that all are looked at together.
        apart = np.unique(surface, return_inverse=True)[1] * 2 * np.ptp([low[:, 0], high[:, 0]])
        group = components(low + np.outer(apart, [1, 0, 0]), high + np.outer(apart, [1, 0, 0]))
        order = np.argsort(-_sizes(self.solids)[solid], kind="stable")
        _, largest, number = np.unique(group[order], return_index=True, return_inverse=True)
        result = np.empty_like(order)
        result[order] = order[largest][number]
        return result

    def content(self) -> Hashable:
        """Equal for tables that are the same."""
        solids = tuple(
            (s.primitive.name, s.segments, s.shrink, s.to_world.tobytes(), s.surfaces.tobytes()) for s in self.solids
        )
        return solids, self.of_leaf.tobytes(), self.origin.tobytes()

    def make_meshes(self) -> None:
        """Makes the meshes, and brings them onto the planes that they share."""
        meshes = [s.mesh() for s in self.solids]
        self.first = np.cumsum([0, *(len(m.faces) for m in meshes)])
        self.faces = np.concatenate([m.faces for m in meshes])
        ends = np.cumsum([0, *(len(m.vertices) for m in meshes)])
        vertices = np.concatenate([m.vertices for m in meshes])
        surface = np.full(len(self.faces), -1)  # of facets
        sharing = [i for i, s in enumerate(self.solids) if (s.surfaces >= 0).any()]
        for i in sharing:
            surface[self.first[i] : self.first[i + 1]] = self.solids[i].surfaces[meshes[i].faces]
        triangles = np.concatenate([np.empty((0, 3), int), *(meshes[i].triangles + ends[i] for i in sharing)])
        facets = np.concatenate([np.empty(0, int), *(meshes[i].facets + self.first[i] for i in sharing)])
        on = surface[facets] >= 0
        rank = np.argsort(np.argsort(-_sizes(self.solids), kind="stable"))
        bearer = np.repeat(rank, np.diff(self.first)) * (self.faces.max() + 1) + self.faces
        self.planes = Planes.of(vertices, triangles[on], facets[on], surface, bearer, self.step)
        vertices = self.planes.settled(vertices, triangles[on], facets[on])
        for i in sharing:
            meshes[i] = replace(meshes[i], vertices=vertices[ends[i] : ends[i + 1]])
        self.meshes = meshes
        self.boxes = np.stack([f.reduceat(vertices, ends[:-1]) for f in (np.minimum, np.maximum)], axis=1)

    def corners(self, positions: np.ndarray, leaf: np.ndarray, face: np.ndarray) -> Corners:
        """Unit normals in the world, out of the leaves, and surface parameters of triangles (n, 3, 3) on the faces
        (n,) of the leaves (n,).
        """
        solid = self.of_leaf[leaf]
        inverse = self.to_local[solid]
        local = positions @ inverse[:, :, :3].transpose(0, 2, 1) + inverse[:, None, :, 3]
        result = Corners(np.zeros_like(local), np.zeros((*local.shape[:2], 2)), np.zeros(local.shape[:2], bool))
        for number, primitive in enumerate(self.primitives):
            chosen = self.shape[solid] == number
            if chosen.any():
                own = primitive.corners(local[chosen], face[chosen])
                result.normals[chosen], result.uv[chosen], result.alone[chosen] = own.normals, own.uv, own.alone
        normals = result.normals @ inverse[:, :, :3]  # by the inverse's transpose
        length = np.linalg.norm(normals, axis=2, keepdims=True)
        return replace(result, normals=normals * (1 / np.where(length > 0, length, 1)))


def _sizes(solids: Sequence[Solid]) -> np.ndarray:
    """How large solids are against one another, (n,)."""
    return np.asarray(np.linalg.norm([s.to_world[:3, :3] for s in solids], axis=(1, 2)))


def _checked_matrices(document: Document, indices: Sequence[int]) -> np.ndarray:
    """The matrices (n, 4, 4) of the TRANSFORMs with these indices. Raises SceneError for a singular one."""
    found = matrices([document.scene.transforms[index] for index in indices])
    finite = np.isfinite(found).all(axis=(1, 2))
    conditions = np.linalg.cond(np.where(finite[:, None, None], found, 0)[:, :3, :3])
    for index, wrong in zip(indices, (~finite | ~(conditions <= 1e12)).tolist()):
        if wrong:
            raise document.error("this transform is singular or beyond double precision", "transforms", index)
    return found
