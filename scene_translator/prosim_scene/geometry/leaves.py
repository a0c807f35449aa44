"""Computes tables of the leaves of the CSG tree: their solids, the surfaces that they share, their normals and uv."""

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..language.document import Document
from ..view import Camera
from .coincidence import THICKNESS, Planes, same_surfaces
from .detail import choose_tessellations, find_enclosing
from .grouping import group_equal
from .primitives import PRIMITIVES, CornerAttributes, Cube, Primitive, box_corners, with_radius
from .solids import Solid, world_box_corners
from .transforms import matrices

#: How far a PLANE extends, relative to the size of the scene.
EXTENT = 100
#: The largest number that is allowed; its square is below the maximum of single precision.
LARGEST = 1e19
FAR = 16  # a scene whose distance from the origin is more than this number of scene sizes is first moved to the origin


class Leaves:
    """Tables of the leaves of a scene's CSG tree.

    ``solids`` is the list of the distinct solids; ``of_leaf`` has, for each leaf, the number of its solid. All
    positions are relative to ``origin`` (3,), a point in world coordinates. The distance between coincident facets of
    different solids is at most ``thickness``, in scene units.

    After :meth:`make_meshes`, ``meshes`` has the meshes of the solids, and ``boxes`` (n, 2, 3) has the minimum and the
    maximum corner of each mesh. The facets of all solids have consecutive numbers; the numbers of solid i's facets
    start at ``first[i]``. ``faces`` has, for each facet, the number of the primitive's face on which the facet lies;
    ``planes`` has the planes that facets of several solids share.
    """

    def __init__(
        self,
        document: Document,
        camera: Camera,
        tolerance: float,
        cuts_several_media: np.ndarray,
        meshes: Mapping[str, Primitive],
    ) -> None:
        """Computes the solids with their transforms, shared surfaces and numbers of segments; :meth:`make_meshes` makes
        their meshes later.

        ``tolerance`` is the largest chord error of curved faces in pixels. ``meshes`` is a dictionary from the names of
        mesh files to their solids. ``cuts_several_media`` (n,) is True for each leaf that cuts several media. A face of
        a leaf that cuts several media becomes a face of the solids of all these media, and these faces coincide. Raises
        :class:`SceneError` for a transform that is nearly singular or too extreme for Mitsuba, and for too many
        triangles.
        """
        keys = [(leaf.shape, leaf.file, leaf.radius, leaf.index) for _, leaf in document.scene.leaves]
        numbers_of_keys = {key: i for i, key in enumerate(dict.fromkeys(keys))}
        self.of_leaf = np.array([numbers_of_keys[key] for key in keys])
        indices = [index for *_, index in numbers_of_keys]
        primitives = [_primitive(shape, file, radius, meshes) for shape, file, radius, _ in numbers_of_keys]
        with np.errstate(all="ignore"):
            to_world_matrices = matrices([document.scene.transforms[index] for index in indices])
            self.solids = [
                Solid(primitive, to_world @ primitive.placement)
                for primitive, to_world in zip(primitives, to_world_matrices)
            ]
            boxes = world_box_corners(self.solids)
        _check_transforms(document, indices, to_world_matrices, boxes)
        bounded = np.array([primitive.name != "plane" for primitive in primitives])
        boxes = boxes[bounded | ~bounded.any()]
        low, high = boxes.min(axis=(0, 1)), boxes.max(axis=(0, 1))
        middle = (low + high) / 2
        self.origin = middle if np.abs(middle).max() > FAR * (high - low).max() else np.zeros(3)
        size = float(np.abs(np.stack([low, high]) - self.origin).max())
        self.thickness = THICKNESS * 2.0 ** (math.frexp(size)[1] - 1)
        seen = np.stack([camera.eye, camera.eye - camera.depth * camera.n])
        _bound_planes(self.solids, np.append(boxes.reshape(-1, 3), seen, axis=0))
        self._find_shared_surfaces(cuts_several_media)
        choose_tessellations(document, self.solids, self.of_leaf, camera, tolerance)
        find_enclosing(self.solids)
        offset = np.pad(self.origin[:, None], ((0, 1), (3, 0)))
        for s in self.solids:
            s.to_world = s.to_world - offset
        self.to_local = np.linalg.inv([s.to_world for s in self.solids])[:, :3]
        self.of_primitive = group_equal(s.primitive for s in self.solids)

    def _find_shared_surfaces(self, cuts_several_media: np.ndarray) -> None:
        """Sets ``surfaces`` and ``facet_map`` of each :class:`.Solid` that shares surfaces with other solids, and
        merges equal solids.

        A solid of several leaves, or of a leaf that cuts several media, has shared surfaces even if no other solid has
        them.
        """
        # A leaf that cuts several media counts twice, because its faces become faces of several solids.
        uses = np.bincount(self.of_leaf) + np.bincount(self.of_leaf, cuts_several_media)
        counts = [len(s.primitive.quadrics) for s in self.solids]
        if not any(counts):
            return
        solid = np.repeat(np.arange(len(self.solids)), counts)
        to_world_matrices = np.array([s.to_world for s in self.solids])[solid]
        boxes = world_box_corners(self.solids)[solid]
        low, high = boxes.min(axis=1) - self.thickness, boxes.max(axis=1) + self.thickness
        quadrics = np.concatenate([s.primitive.quadrics for s in self.solids])
        surface = same_surfaces(quadrics, to_world_matrices, low, high)
        users = np.bincount(surface, uses[solid])
        shared = np.where(users[surface] > 1, surface, -1)
        for s, surfaces in zip(self.solids, np.split(shared, np.cumsum(counts)[:-1])):
            s.surfaces = surfaces if len(surfaces) else s.surfaces
            if s.curved_surface >= 0 and (owner := self.solids[solid[s.curved_surface]]) is not s:
                s.facet_map = np.linalg.solve(s.to_world, owner.to_world)
        # Solids of a primitive are equal if all their faces lie on the same shared surfaces.
        keys = [(s.primitive, *sorted(s.surfaces)) if min(s.surfaces) >= 0 else i for i, s in enumerate(self.solids)]
        numbers = {key: i for i, key in enumerate(dict.fromkeys(keys))}
        renumbered = np.array([numbers[key] for key in keys])
        self.solids = [self.solids[i] for i in np.unique(renumbered, return_index=True)[1]]
        self.of_leaf = renumbered[self.of_leaf]

    def cache_key(self) -> Hashable:
        """Returns a hashable key of this object; two :class:`Leaves` objects with equal keys have equal tables."""
        solids = tuple(
            (s.primitive.name, s.segments, s.scale, *(array.tobytes() for array in arrays))
            for s in self.solids
            for arrays in [(s.primitive.box, s.to_world, s.facet_map, s.surfaces)]
        )
        return solids, self.of_leaf.tobytes(), self.origin.tobytes()

    def make_meshes(self) -> None:
        """Makes the meshes of all solids, and moves the vertices of the meshes onto the planes that facets of several
        solids share.
        """
        meshes = [s.mesh() for s in self.solids]
        self.first = np.cumsum([0, *(len(m.faces) for m in meshes)])
        self.faces = np.concatenate([m.faces for m in meshes])
        ends = np.cumsum([0, *(len(m.vertices) for m in meshes)])
        vertices = np.concatenate([m.vertices for m in meshes])
        # The surface of each facet; a mesh file has more faces than surfaces.
        surface = np.concatenate([s.surfaces.take(m.faces, mode="clip") for s, m in zip(self.solids, meshes)])
        triangles = np.concatenate([m.triangles + end for m, end in zip(meshes, ends)])
        facets = np.concatenate([m.facets + first for m, first in zip(meshes, self.first)])
        on = surface[facets] >= 0
        sizes = np.linalg.norm([s.to_world[:3, :3] for s in self.solids], axis=(1, 2))
        # Facets of several solids share the plane of the largest solid, which has the lowest rank.
        rank = np.argsort(np.argsort(-sizes, kind="stable"))
        owner = np.repeat(rank, np.diff(self.first)) * (self.faces.max() + 1) + self.faces
        self.planes = Planes(vertices[triangles[on]], facets[on], surface, owner, self.thickness)
        vertices = self.planes.snap_vertices(vertices, triangles[on], facets[on])
        self.meshes = [replace(m, vertices=own) for m, own in zip(meshes, np.split(vertices, ends[1:-1]))]
        self.boxes = np.stack([f.reduceat(vertices, ends[:-1]) for f in (np.minimum, np.maximum)], axis=1)

    def corner_attributes(self, positions: np.ndarray, leaf: np.ndarray, face: np.ndarray) -> CornerAttributes:
        """Returns the normals and uv at the corners of n triangles; the normals are outward unit vectors in world
        coordinates.

        ``positions`` (n, 3, 3) are the positions of the corners; ``leaf`` (n,) and ``face`` (n,) are the numbers of the
        leaf and of its face to which each triangle belongs.
        """
        solid = self.of_leaf[leaf]
        inverse = self.to_local[solid]
        local = positions @ inverse[:, :, :3].transpose(0, 2, 1) + inverse[:, None, :, 3]
        result = CornerAttributes(
            np.zeros_like(local), np.zeros((*local.shape[:2], 2)), np.zeros(local.shape[:2], bool)
        )
        for primitive, numbers in self.of_primitive.items():
            chosen = np.isin(solid, numbers)
            if chosen.any():
                own = primitive.corner_attributes(local[chosen], face[chosen])
                result.normals[chosen], result.uv[chosen], result.unshared[chosen] = own.normals, own.uv, own.unshared
        normals = result.normals @ inverse[:, :, :3]  # normals are transformed by the transposed inverse matrix
        length = np.linalg.norm(normals, axis=2, keepdims=True)
        return replace(result, normals=normals * (1 / np.where(length > 0, length, 1)))


def _primitive(shape: str, file: str | None, radius: float | None, meshes: Mapping[str, Primitive]) -> Primitive:
    if file is not None:
        return meshes[file]
    return PRIMITIVES[shape] if radius is None else with_radius(shape, radius)


def _bound_planes(solids: Sequence[Solid], points: np.ndarray) -> None:
    """Makes each PLANE a block that ends EXTENT times as far from the middle of the scene as the scene itself."""
    low, high = points.min(axis=0), points.max(axis=0)
    half = (high - low).max() / 2
    # The corners of two cubes: around all facets on which other solids may stand, and around the blocks.
    boxes = [box_corners((low + high) / 2 + np.outer([-size, size], half * np.ones(3))) for size in (2, EXTENT)]
    for s in solids:
        if s.primitive.name == "plane":
            to_local = np.linalg.inv(s.to_world)
            inner, outer = (corners @ to_local[:3, :3].T + to_local[:3, 3] for corners in boxes)
            (*xy, z), high = outer.min(axis=0), outer.max(axis=0)
            box = [*xy, min(z, z - high[2])], [*high[:2], 0]
            s.primitive = Cube("plane", box, [inner.min(axis=0)[:2], inner.max(axis=0)[:2]])


def _check_transforms(document: Document, indices: Sequence[int], matrices: np.ndarray, boxes: np.ndarray) -> None:
    """Raises SceneError for the first transform that is nearly singular or whose numbers are too extreme for Mitsuba. A
    transform is nearly singular if it scales one direction by less than 1e-12 of the scale in another direction.
    """
    wrong = ~(np.abs(boxes).max(axis=(1, 2)) <= LARGEST)
    widths = np.linalg.svd(np.where(wrong[:, None, None], 0, matrices[:, :3, :3]), compute_uv=False)
    wrong |= ~(widths[:, 2] >= np.maximum(widths[:, 0] / 1e12, 1 / LARGEST))
    for i in np.flatnonzero(wrong)[:1].tolist():
        raise document.error(
            "this transform is singular or beyond Mitsuba's single precision; expected less extreme steps",
            "transforms",
            indices[i],
        )
