"""Computes tables of the leaves of the CSG tree: their solids, the surfaces that they share, their normals and uv."""

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..language.document import Document
from ..model import Leaf
from ..view import Camera
from .coincidence import THICKNESS, Planes, same_surfaces
from .contacts import near_tori
from .detail import with_segments
from .grouping import group_equal
from .primitives import CornerAttributes, Cube, Mesh, Primitive, Torus, box_corners, primitive_of
from .solids import Solid, matrices, world_boxes

#: How far a PLANE extends, relative to the size of the scene.
EXTENT = 100
#: The largest number that is allowed; its square is below the maximum of single precision.
LARGEST = 1e19
FAR = 16  # a scene whose distance from the origin is more than this number of scene sizes is first moved to the origin


@dataclass(frozen=True, eq=False)
class Leaves:
    """The distinct ``solids`` of a CSG tree, and the number of each leaf's solid, ``of_leaf``. Positions are relative
    to ``origin`` (3,); coincident facets are at most ``thickness``, in scene units, apart.
    """

    solids: list[Solid]
    of_leaf: np.ndarray
    origin: np.ndarray
    thickness: float

    @cached_property
    def to_local(self) -> np.ndarray:
        """The maps (n, 3, 4) from world coordinates to those of the solids' primitives."""
        return np.linalg.inv([s.to_world for s in self.solids])[:, :3]

    @cached_property
    def of_primitive(self) -> dict[Primitive, list[int]]:
        """A dictionary from each primitive to the numbers of its solids."""
        return group_equal(s.primitive for s in self.solids)

    def cache_key(self) -> Hashable:
        """Returns a hashable key of this object; two :class:`Leaves` objects with equal keys have equal tables."""
        solids = tuple(
            (s.primitive.name, s.segments, s.scale, *(array.tobytes() for array in arrays))
            for s in self.solids
            for arrays in [(s.primitive.box, s.to_world, s.facet_map, s.surfaces)]
        )
        return solids, self.of_leaf.tobytes(), self.origin.tobytes()

    def corner_attributes(self, positions: np.ndarray, leaf: np.ndarray, face: np.ndarray) -> CornerAttributes:
        """Returns outward unit normals, in world coordinates, and uv at the corners ``positions`` (n, 3, 3) of
        triangles of these leaves and faces (n,).
        """
        solid = self.of_leaf[leaf]
        inverse = self.to_local[solid]
        local = positions @ inverse[:, :, :3].transpose(0, 2, 1) + inverse[:, None, :, 3]
        count = local.shape[:2]
        result = CornerAttributes(np.zeros_like(local), np.zeros((*count, 2)), np.zeros(count, bool))
        for primitive, numbers in self.of_primitive.items():
            chosen = np.isin(solid, numbers)
            if chosen.any():
                own = primitive.corner_attributes(local[chosen], face[chosen])
                result.normals[chosen], result.uv[chosen], result.unshared[chosen] = own.normals, own.uv, own.unshared
        normals = result.normals @ inverse[:, :, :3]  # normals are transformed by the transposed inverse matrix
        length = np.linalg.norm(normals, axis=2, keepdims=True)
        return replace(result, normals=normals * (1 / np.where(length > 0, length, 1)))


def leaves_of(
    document: Document,
    camera: Camera,
    tolerance: float,
    cuts_several_media: np.ndarray,
    meshes: Mapping[str, Primitive],
) -> Leaves:
    """Returns the leaves of a scene, whose solids have their transforms, shared surfaces and numbers of segments.

    ``tolerance`` is the largest chord error of curved faces in pixels. ``meshes`` is a dictionary from the names of
    mesh files to their solids. ``cuts_several_media`` (n,) is True for each leaf that cuts several media. Raises
    :class:`SceneError` for a transform that is nearly singular or too extreme for Mitsuba, and for too many triangles.
    """
    leaves = _distinct(document, meshes)
    leaves = _bounded(document, leaves, camera)
    leaves = _with_shared_surfaces(document, leaves, cuts_several_media)
    solids = with_segments(document, leaves.solids, leaves.of_leaf, camera, tolerance)
    offset = np.pad(leaves.origin[:, None], ((0, 1), (3, 0)))
    return replace(leaves, solids=[replace(s, to_world=s.to_world - offset) for s in solids])


def _distinct(document: Document, meshes: Mapping[str, Primitive]) -> Leaves:
    """Returns the leaves with their transforms; the positions are still those of the scene."""
    leaves = [leaf for _, leaf in document.scene.leaves]
    with np.errstate(all="ignore"):
        to_world = matrices([document.scene.transforms[leaf.index] for leaf in leaves]) + 0.0  # converts -0 to 0
        primitives = [meshes[leaf.file] if leaf.file else primitive_of(leaf.shape, leaf.radius) for leaf in leaves]
        keys = list(zip(primitives, map(bytes, to_world)))
        distinct = [numbers[0] for numbers in group_equal(keys).values()]
        solids = [Solid(primitives[i], to_world[i] @ primitives[i].placement) for i in distinct]
        boxes = np.stack(world_boxes(solids), axis=1)
    _check_transforms(document, [leaves[i].index for i in distinct], to_world[distinct], boxes)
    numbers = {keys[i]: number for number, i in enumerate(distinct)}
    corners = _bounded_corners(solids)
    low, high = corners.min(axis=0), corners.max(axis=0)
    middle = (low + high) / 2
    origin = middle if np.abs(middle).max() > FAR * (high - low).max() else np.zeros(3)
    size = float(np.abs(np.stack([low, high]) - origin).max())
    of_leaf = np.array([numbers[key] for key in keys])
    return Leaves(solids, of_leaf, origin, THICKNESS * 2.0 ** (math.frexp(size)[1] - 1))


def _bounded_corners(solids: Sequence[Solid]) -> np.ndarray:
    """Returns points (n, 3) that the boxes of all solids except PLANEs enclose; PLANEs if there is nothing else."""
    bounded = np.array([s.primitive.name != "plane" for s in solids])
    return np.concatenate(world_boxes([s for s, chosen in zip(solids, bounded | ~bounded.any()) if chosen]))


def _bounded(document: Document, leaves: Leaves, camera: Camera) -> Leaves:
    """Makes each PLANE a block that ends EXTENT times as far from the middle of the scene as the scene itself; one that
    is subtracted ends beyond the others, of which it would leave a wall in the distance.
    """
    points = np.stack([camera.eye, camera.eye - camera.depth * camera.n])
    points = np.append(_bounded_corners(leaves.solids), points, axis=0)
    low, high = points.min(axis=0), points.max(axis=0)
    half = (high - low).max() / 2
    # The corners of two cubes: around all facets on which other solids may stand, and around the blocks.
    inner, outer = ((low + high) / 2 + np.outer([-size, size], half * np.ones(3)) for size in (2, EXTENT))
    solids, levels = list(leaves.solids), np.zeros(len(leaves.solids), int)
    np.maximum.at(levels, leaves.of_leaf, _minus_signs(document))
    for level in sorted({*levels}):
        chosen = [i for i, s in enumerate(solids) if s.primitive.name == "plane" and levels[i] == level]
        for i in chosen:
            solids[i] = _block(solids[i], box_corners(inner), box_corners(outer))
        ends = np.concatenate([outer, *world_boxes([solids[i] for i in chosen])])
        outer = np.stack([ends.min(axis=0), ends.max(axis=0)])
    return replace(leaves, solids=solids)


def _minus_signs(document: Document) -> list[int]:
    """Returns, for each leaf, the number of operators - whose second operand contains it."""
    above, result = [0], list[int]()
    for node in document.scene.csg:
        count = above.pop()
        if isinstance(node, Leaf):
            result.append(count)
        else:
            above += [count + (node.symbol == "-"), count]  # the first operand is the next node
    return result


def _block(plane: Solid, *boxes: np.ndarray) -> Solid:
    to_local = np.linalg.inv(plane.to_world)
    inner, outer = (corners @ to_local[:3, :3].T + to_local[:3, 3] for corners in boxes)
    (*xy, z), high = outer.min(axis=0), outer.max(axis=0)
    box = [*xy, min(z, z - high[2])], [*high[:2], 0]
    return replace(plane, primitive=Cube("plane", box, [inner.min(axis=0)[:2], inner.max(axis=0)[:2]]))


def _with_shared_surfaces(document: Document, leaves: Leaves, cuts_several_media: np.ndarray) -> Leaves:
    """Returns the leaves with ``surfaces``, ``pattern`` and ``facet_map``; equal solids are merged. A solid of several
    leaves, or that cuts several media, has shared surfaces even alone.
    """
    solids, of_leaf, thickness = leaves.solids, leaves.of_leaf, leaves.thickness
    # A leaf that cuts several media counts twice, because its faces become faces of several solids.
    uses = np.bincount(of_leaf) + np.bincount(of_leaf, cuts_several_media)
    counts = [len(s.primitive.quadrics) for s in solids]
    solid = np.repeat(np.arange(len(solids)), counts)
    low, high = world_boxes(solids)
    low, high = low[solid] - thickness, high[solid] + thickness
    quadrics = np.concatenate([s.primitive.quadrics for s in solids])
    to_world = np.array([s.to_world for s in solids])[solid]
    surface, (difference, *pair) = same_surfaces(quadrics, to_world, low, high) if any(counts) else (solid, (0.0,))
    if difference:
        gap = difference * np.linalg.norm(to_world[pair[0], :3, :3])
        near = sorted(int(np.flatnonzero(of_leaf == solid[face])[0]) for face in pair)
        reason = f"faces of {document.names_of(near)} are only about {gap:.0e} apart, so they count as one face; "
        document.warn(f"{reason}if they should differ, move one farther", "csg", document.scene.leaves[near[0]][0])
    users = np.bincount(surface, uses[solid])
    shared = np.where(users[surface] > 1, surface, -1)
    pattern, is_torus = shared.copy(), np.array([s.primitive.name == "torus" for s in solids])[solid]
    tori = np.unique(surface[is_torus])
    pattern[tori] = tori[near_tori([solids[i] for i in solid[tori]])]
    pattern[is_torus] = pattern[surface[is_torus]]
    result = []
    last = len(shared)
    for s, surfaces, own, count in zip(solids, *(np.split(a, np.cumsum(counts)[:-1]) for a in (shared, pattern)), uses):
        if not len(surfaces) and count > 1:  # a mesh file, whose faces only its copies share
            surfaces = np.arange(last, last := last + len(s.mesh().faces))
        sharing = replace(s, surfaces=surfaces) if len(surfaces) else s
        if s.primitive.curved is not None and (number := int(own[s.primitive.curved])) >= 0:
            sharing = replace(sharing, pattern=number)
            if (owner := solids[solid[number]]) is not s:
                sharing = replace(sharing, facet_map=np.linalg.solve(s.to_world, owner.to_world))
            if isinstance(s.primitive, Torus):
                sharing = replace(sharing, primitive=primitive_of("torus", s.primitive.radius, owner.primitive.hull[1]))
        result.append(sharing)
    # Solids of a primitive are equal if all their faces lie on the same shared surfaces.
    keys = [(s.primitive, *sorted(s.surfaces)) if min(s.surfaces) >= 0 else i for i, s in enumerate(result)]
    distinct = dict(zip(reversed(keys), reversed(result)))
    numbers = {key: i for i, key in enumerate(dict.fromkeys(keys))}
    merged = np.array([numbers[key] for key in keys])
    return replace(leaves, solids=[distinct[key] for key in numbers], of_leaf=merged[of_leaf])


@dataclass(frozen=True, eq=False)
class Tessellation:
    """The ``meshes`` of the solids of a scene, and ``boxes`` (n, 2, 3), the minimum and the maximum corner of each
    mesh.

    The facets of all solids have consecutive numbers; the numbers of solid i's facets start at ``first[i]``. ``faces``
    has, for each facet, the number of the primitive's face on which the facet lies; ``planes`` has the planes that
    facets of several solids share.
    """

    meshes: list[Mesh]
    boxes: np.ndarray
    first: np.ndarray
    faces: np.ndarray
    planes: Planes


def tessellation_of(leaves: Leaves) -> Tessellation:
    """Makes the meshes of all solids, with vertices moved onto planes that several solids share."""
    solids = leaves.solids
    meshes = [s.mesh() for s in solids]
    first = np.cumsum([0, *(len(m.faces) for m in meshes)])
    faces = np.concatenate([m.faces for m in meshes])
    ends = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    vertices = np.concatenate([m.vertices for m in meshes])
    # The surface of each facet; a mesh file has more faces than surfaces.
    surface = np.concatenate([s.surfaces.take(m.faces, mode="clip") for s, m in zip(solids, meshes)])
    triangles = np.concatenate([m.triangles + end for m, end in zip(meshes, ends)])
    facets = np.concatenate([m.facets + start for m, start in zip(meshes, first)])
    on = surface[facets] >= 0
    sizes = np.linalg.norm([s.to_world[:3, :3] for s in solids], axis=(1, 2))
    # Facets of several solids share the plane of the largest solid, which has the lowest rank.
    rank = np.argsort(np.argsort(-sizes, kind="stable"))
    owner = np.repeat(rank, np.diff(first)) * (faces.max() + 1) + faces
    planes = Planes(vertices[triangles[on]], facets[on], surface, owner)
    vertices = planes.snap_vertices(vertices, triangles[on], facets[on])
    meshes = [replace(m, vertices=own) for m, own in zip(meshes, np.split(vertices, ends[1:-1]))]
    boxes = np.stack([f.reduceat(vertices, ends[:-1]) for f in (np.minimum, np.maximum)], axis=1)
    return Tessellation(meshes, boxes, first, faces, planes)


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
