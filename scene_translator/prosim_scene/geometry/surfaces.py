"""Computes the surfaces of the evaluated CSG tree: one mesh, with normals and uv, for each combination of a material
with the media on both sides of a face.
"""

import time
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import NamedTuple

import numpy as np
from manifold3d import Manifold, Mesh64

from ..language.analysis import garbage_collection_paused
from ..language.document import Document
from ..model import Step, Transform
from ..view import Camera
from . import csg
from .boundaries import AIR, OPAQUE, Boundary, OriginalIds, boundaries, concatenated, heights, primitive_boundary
from .detail import warn_of_rounding
from .enclosure import warn_of_enclosure
from .grouping import components
from .leaves import Leaves, Tessellation, leaves_of, tessellation_of
from .primitives import OUTSIDE_TOLERANCE, CornerAttributes, Mesh, Primitive
from .solids import matrices


class Look(NamedTuple):
    """What a primitive looks like: keys of its ``material`` and of the ``medium`` inside (None if opaque), and whether
    it is opaque and reflects by Fresnel's equations, which depend on the medium outside.
    """

    material: Hashable
    medium: Hashable
    fresnel: bool


class MeshKey(NamedTuple):
    """The key of a mesh: the material of a primitive, and the media on both sides of a face. Triangles with equal keys
    share a mesh.

    The normal of a face points to the medium ``outside``; None is air. For an opaque primitive ``inside`` is None;
    ``outside`` is None, too, unless the primitive reflects by Fresnel's equations.
    """

    material: Hashable
    inside: Hashable = None
    outside: Hashable = None


@dataclass(eq=False)
class Triangles:
    """Triangles ``index`` (n, 3) of ``vertices`` (k, 3), unit ``normals`` (k, 3) and ``uv`` (k, 2); they share a vertex
    only with equal position, normal and uv.
    """

    vertices: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    index: np.ndarray

    @property
    def positions(self) -> np.ndarray:
        """The positions (n, 3, 3) of the triangles' corners."""
        return np.asarray(self.vertices[self.index])


def corner_keys(vertex: np.ndarray, face: np.ndarray, corners: CornerAttributes, first: int) -> np.ndarray:
    """Returns keys (n, 3) of corners. Corners with the same vertex and face, on the same side of the seam of uv, have
    the same key; each ``unshared`` corner has its own negative key, from -1 - ``first`` downwards.
    """
    wrapped = (np.floor(corners.uv[..., 0]) > 0).astype(int)
    # Face numbers are below 8, except in mesh files, whose corners are all unshared.
    keys = np.asarray((vertex * 8 + face[:, None]) * 2 + wrapped)
    keys[corners.unshared] = -1 - np.arange(first, first + corners.unshared.sum())
    return keys


@dataclass(eq=False)
class SurfaceMesh:
    """The boundary of the evaluated CSG tree, without materials: all ``triangles``, sorted by their kinds.

    The kind of a triangle is the combination of its leaf, the medium inside and the medium outside; the list ``kinds``
    has these three numbers for each kind. The triangles of kind i have the numbers from ``starts[i]`` to ``starts[i +
    1]`` - 1. ``visible`` has one flag for each kind; it is False if all triangles of the kind are slivers that are too
    thin to be visible. ``wrong`` has the leaf and a point of some visible triangles that do not lie on the leaf's flat
    face.
    """

    triangles: Triangles
    starts: np.ndarray
    kinds: list[tuple[int, int, int]]
    visible: np.ndarray
    wrong: list[tuple[int, np.ndarray]]

    def of_kinds(self, kinds: list[int]) -> Triangles:
        """Returns the triangles of the kinds that have these numbers."""
        mesh = self.triangles
        chosen = np.concatenate([mesh.index[self.starts[kind] : self.starts[kind + 1]] for kind in kinds])
        vertices, index = np.unique(chosen, return_inverse=True)
        return Triangles(mesh.vertices[vertices], mesh.normals[vertices], mesh.uv[vertices], index.reshape(-1, 3))


class TranslationCache:
    """Keeps the CSG surface that was evaluated last, whose key ignores colours and textures; it needs as much memory as
    the evaluation. ``evaluations`` counts those that it did not contain.
    """

    def __init__(self) -> None:
        self.key: Hashable = None
        self.surface: SurfaceMesh | None = None
        self.evaluations = 0

    def surface_for(self, key: Hashable, evaluate: Callable[[], SurfaceMesh]) -> SurfaceMesh:
        """Returns the cached surface if its key equals ``key``; otherwise caches and returns ``evaluate()``."""
        if self.surface is None or key != self.key:
            self.surface = None  # frees memory before the evaluation
            self.key, self.surface = key, evaluate()
            self.evaluations += 1
        return self.surface


BATCH = 1 << 16  # the number of triangles that are processed at a time
#: An edge that touches a curved face from inside protrudes from the face's mesh, by less than the tolerance. A result
#: without a face that is wider than this number of tolerances may have such edges alone.
SLIVER = 5


@garbage_collection_paused()
def tessellate(
    document: Document,
    camera: Camera,
    tolerance: float,
    looks: Sequence[Look],
    meshes: Mapping[str, Primitive],
    cache: TranslationCache,
) -> dict[MeshKey, Triangles]:
    """Evaluates the CSG tree of a document's scene, and returns a dictionary of the resulting triangles; the keys are
    the material and the media of the triangles. Keys of which no triangle is visible are left out, and a scene without
    primitives has no keys.

    ``tolerance`` is the largest chord error of curved faces in pixels. ``looks`` has the look of each leaf of the tree;
    faces of equal materials between the same media share a mesh. ``meshes`` is a dictionary from the names of mesh
    files to their solids.

    Raises :class:`SceneError` for a singular transform, and for too many triangles. Warns of leaves of which nothing is
    visible, of cuts between glass and opaque solids, of an eye or lights inside opaque solids, and of large rounding
    errors in single precision.
    """
    leaves = document.scene.leaves
    if not leaves:
        return {}
    tree = csg.tree_of(document.scene.csg)
    # None comes first, so the opaque medium gets the number OPAQUE = 0.
    numbers = {name: number for number, name in enumerate(dict.fromkeys([None, *(look.medium for look in looks)]))}
    media_of = [numbers[look.medium] for look in looks]
    cut_media = csg.count_cut_media(tree, media_of)
    table = leaves_of(document, camera, tolerance, cut_media > 1, meshes)
    reflects = tuple(number == OPAQUE and look.fresnel for number, look in zip(media_of, looks))
    evaluate = partial(_surface_mesh, document, tree, media_of, any(reflects), cut_media > 0)
    faces = cache.surface_for(
        (tuple(tree), tuple(media_of), reflects, table.cache_key()), lambda: _sound_surface_mesh(evaluate, table)
    )
    warn_of_rounding(document, camera, faces.triangles.vertices)
    is_wall = np.repeat(np.array([inside == OPAQUE for _, inside, _ in faces.kinds], bool), np.diff(faces.starts))
    opaque = [medium == OPAQUE for medium in media_of]
    warn_of_enclosure(document, tree, table, opaque, lambda: faces.triangles.positions[is_wall])
    _warn_of_owners(document, faces, media_of)
    is_cut = not {"-", "*"}.isdisjoint(tree) and any(solid.primitive.curved is not None for solid in table.solids)
    if is_cut and faces.visible.any() and _is_narrow(faces.triangles, camera, SLIVER * tolerance):
        reason = (
            f"no face of the tree's result is wider than {SLIVER * tolerance:g} pixels; where primitives touch, the "
        )
        document.warn(f"{reason}result may be empty but for the approximation of curved faces", "csg")
    for leaf, point in faces.wrong[:1]:
        place = f"near ({' '.join(f'{x:g}' for x in point)})"
        reason = f"a face of {document.names_of([leaf])} is wrong {place}, because many faces meet there in an edge; "
        document.warn(f"{reason}move a solid there a little", "csg", leaves[leaf][0])
    of_number = {AIR: None} | {number: name for name, number in numbers.items()}
    kinds_of_key: dict[MeshKey, list[int]] = {}
    for kind, (leaf, inside, outside) in enumerate(faces.kinds):
        sides = [of_number[side] for side in _sides(media_of[leaf], inside, outside, reflects[leaf])]
        kinds_of_key.setdefault(MeshKey(looks[leaf].material, *sides), []).append(kind)
    return {key: faces.of_kinds(kinds) for key, kinds in kinds_of_key.items() if faces.visible[kinds].any()}


PATIENCE = 30.0  # a longer evaluation of the CSG tree causes a warning after this number of seconds of processor time


def _boundary(
    document: Document,
    table: Leaves,
    tree: csg.Tree,
    meshes: Tessellation,
    media_of: list[int],
    fresnel: bool,
    cutters: np.ndarray,
) -> Boundary:
    """Evaluates the CSG tree; returns the boundary of the resulting solids."""
    end = time.process_time() + PATIENCE

    @cache
    def warn_of_time() -> None:
        reason = f"the solids of this tree take more than {PATIENCE:g} s, because many of them meet at one place; "
        document.warn(f"{reason}use fewer of them, or the option --tolerance with a larger number", "csg")

    ids = OriginalIds(Manifold.reserve_ids(len(media_of) * (max(media_of) + 1)), len(media_of))
    boxes = meshes.boxes + table.thickness * np.array([[-1.0], [1.0]])
    # The number of a group is that of its first leaf.
    labels = components(boxes[:, 0], boxes[:, 1])[table.of_leaf]
    _, first, number_of_group = np.unique(labels, return_index=True, return_inverse=True)
    groups = first[number_of_group]
    alone = np.bincount(groups, minlength=len(groups)) == 1

    def body(number: int, medium: int) -> csg.Body | None:
        if medium != media_of[number] and not cutters[number]:
            return None
        i = int(table.of_leaf[number])
        surfaces = frozenset(table.solids[i].surfaces.tolist()) - {-1}

        @cache
        def mesh() -> Manifold:
            if time.process_time() > end:
                warn_of_time()
            return csg.checked(manifold(meshes.meshes[i], meshes.first[i], ids.id_of(number, medium)), number)

        return csg.Body(mesh, boxes[i : i + 1], surfaces, meshes.planes, number, table.solids[i])

    bodies: dict[int, dict[int, csg.Body]] = {}
    for m in sorted(set(media_of)):
        for group, value in csg.evaluate(tree, groups.tolist(), partial(body, medium=m)).items():
            bodies.setdefault(group, {})[m] = value
    parts: list[Boundary] = []
    for group in sorted(bodies):
        of_group = bodies.pop(group)  # frees memory
        if alone[group]:  # a group of a single leaf has the number of this leaf
            i = int(table.of_leaf[group])
            parts.append(primitive_boundary(meshes.meshes[i], group, meshes.first[i], media_of[group]))
        else:
            parts += boundaries(of_group, ids, fresnel)
    return concatenated(parts)


def manifold(mesh: Mesh, first: int, original_id: int) -> Manifold:
    """Converts the mesh of a primitive to manifold3d's type; its facets get the numbers from ``first`` on."""
    mesh64 = Mesh64(
        mesh.vertices.astype(np.float64, copy=False),
        mesh.triangles.astype(np.uint64),
        run_index=np.array([0, 3 * len(mesh.triangles)], np.uint64),
        run_original_id=np.array([original_id], np.uint32),
        face_id=(first + mesh.facets).astype(np.uint64),
    )
    return Manifold(mesh64)


#: A rotation by angles that no scene has.
TURN = matrices([Transform(tuple(Step(f"rotate-{axis}", (11.3 + i,)) for i, axis in enumerate("xyz")))])[0]


def _sound_surface_mesh(evaluate: Callable[[Leaves], SurfaceMesh], table: Leaves) -> SurfaceMesh:
    """Returns the surface mesh of the evaluated CSG tree, which ``evaluate`` makes.

    In rare cases, where solids meet in an edge, the result of manifold3d has wrong triangles. The solids are then
    evaluated again after a rotation, and the result is turned back.
    """
    faces = evaluate(table)
    if not faces.wrong:
        return faces
    solids = [replace(s, to_world=TURN @ s.to_world) for s in table.solids]
    turned = evaluate(replace(table, solids=solids))
    mesh, turn = turned.triangles, TURN[:3, :3]
    mesh.vertices, mesh.normals = (mesh.vertices - table.origin) @ turn + table.origin, mesh.normals @ turn
    return faces if turned.wrong else turned


def _surface_mesh(
    document: Document, tree: csg.Tree, media_of: list[int], fresnel: bool, cutters: np.ndarray, table: Leaves
) -> SurfaceMesh:
    """Evaluates the CSG tree; returns the triangles of the result, sorted by kind, with their normals and uv."""
    meshes = tessellation_of(table)
    try:
        vertices, triangles = _boundary(document, table, tree, meshes, media_of, fresnel, cutters)
    except csg.OperationError as error:
        status, leaf = error.args
        reason = f"the solids at {document.names_of([leaf])} cannot be combined: manifold3d reports {status}; "
        number, _ = document.scene.leaves[leaf]
        raise document.error(f"{reason}move this solid, or one that touches it, a little", "csg", number) from None
    faces, count = meshes.faces, max(media_of) + 2  # the number of media, including air
    del meshes  # frees memory
    # The code of a kind is made of the leaf and of the two media; 1 is added to the media, because AIR is -1.
    codes = (triangles["leaf"].astype(int) * count + triangles["inside"] + 1) * count + triangles["outside"] + 1
    triangles = triangles[np.argsort(codes, kind="stable")]
    codes, starts, kind = np.unique(np.sort(codes), return_index=True, return_inverse=True)
    shape = len(kind), 3
    keys, normals, uv = np.empty(shape, int), np.empty((*shape, 3), "f4"), np.empty((*shape, 2), "f4")
    has_width = np.empty(len(kind), bool)
    unshared = 0  # the number of unshared corners in earlier batches
    wrong: list[tuple[int, np.ndarray]] = []
    # The normals of a mesh file are those that its author wrote; those of other flat faces are their planes'.
    has_plane = np.array([len(solid.primitive.quadrics) > 0 for solid in table.solids])[table.of_leaf]
    for start in range(0, len(kind), BATCH):
        batch = slice(start, start + BATCH)
        rows = triangles[batch]
        positions = vertices[rows["index"]]
        face = faces[rows["facet"]]
        corners = table.corner_attributes(positions, rows["leaf"], face)
        keys[batch] = corner_keys(rows["index"].astype(int) * len(codes) + kind[batch, None], face, corners, unshared)
        unshared += int(corners.unshared.sum())
        normals[batch], uv[batch] = corners.normals * rows["sign"][:, None, None], corners.uv
        has_width[batch] = heights(positions) > 2 * table.thickness
        across = np.cross(positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0])
        own = normals[batch]
        flat = has_plane[rows["leaf"]] & (own == own[:, :1]).all(axis=(1, 2))
        oblique = np.einsum("ti,ti->t", across, own[:, 0]) < 0.99 * np.linalg.norm(across, axis=1)
        oblique &= has_width[batch] & flat
        wrong += [(int(rows["leaf"][i]), positions[i].mean(axis=0) + table.origin) for i in np.flatnonzero(oblique)[:1]]
    _, first, index = np.unique(keys, return_index=True, return_inverse=True)
    triangle, corner = np.divmod(first, 3)
    positions = vertices[triangles["index"][triangle, corner]] + table.origin
    result = Triangles(positions, normals[triangle, corner], uv[triangle, corner], index.reshape(-1, 3))
    visible = np.bincount(kind[has_width], minlength=len(codes)) > 0
    leaf, sides = np.divmod(codes, count**2)
    kinds = list(zip(leaf.tolist(), (sides // count - 1).tolist(), (sides % count - 1).tolist()))
    return SurfaceMesh(result, np.append(starts, len(kind)), kinds, visible, wrong)


def _sides(own: int, inside: int, outside: int, reflects: bool) -> tuple[int, int]:
    """Returns the media of a face for its :class:`MeshKey`: air outside an opaque face unless it ``reflects`` by
    Fresnel's equations, and the dielectric inside a face that it cut into an opaque solid.
    """
    if own == OPAQUE:
        return own, outside if reflects else AIR
    return own if inside == OPAQUE else inside, outside


def _is_narrow(mesh: Triangles, camera: Camera, pixels: float) -> bool:
    """Whether no triangle is wider than a number of pixels, or OUTSIDE_TOLERANCE times as many outside the window."""
    for start in range(0, len(mesh.index), 1 << 10):
        positions = mesh.vertices[mesh.index[start : start + (1 << 10)]]
        pixel = camera.footprint(np.linalg.norm(positions.mean(axis=1) - camera.eye, axis=1))
        pixel *= np.where(camera.may_see(positions), 1, OUTSIDE_TOLERANCE)
        if (heights(positions) > pixels * pixel).any():
            return False
    return True


def _warn_of_owners(document: Document, faces: SurfaceMesh, media_of: Sequence[int]) -> None:
    """Warns of primitives of which nothing is visible, and of cuts between glass and opaque solids."""
    leaves = document.scene.leaves
    visible: set[int] = set()  # leaves that own a visible face
    filling: set[int] = set()  # media that are visible behind faces of other media
    mixed_cuts: dict[tuple[str, int], int] = {}  # the first opaque leaf of a SURFACE that cuts glass, or of glass
    for owner, inside, outside in (faces.kinds[kind] for kind in np.flatnonzero(faces.visible)):
        own, (_, leaf) = media_of[owner], leaves[owner]
        visible.add(owner)
        filling |= {inside, outside} - {own, OPAQUE, AIR}
        if (inside == OPAQUE) != (own == OPAQUE):
            mixed_cuts.setdefault((leaf.shape, leaf.index), owner)
    # A medium that fills a hollow is visible, although its face belongs to the leaf that cut the hollow.
    vanished = [i for i in range(len(leaves)) if i not in visible and media_of[i] not in filling]
    if len(vanished) == len(leaves):
        document.warn("the tree's result is empty; check its operators and transforms", "csg")
    elif vanished:
        reason = f"nothing is visible of {document.names_of(vanished)}: the result contains no face of this primitive"
        number, _ = leaves[vanished[0]]
        document.warn(reason + document.operands_note(number), "csg", number)
    for owner in mixed_cuts.values():
        number, leaf = leaves[owner]
        surface = f"SURFACE {leaf.index}"
        what, problem, expected = "an opaque solid", "is a dielectric, so the solid looks hollow", "another material"
        if media_of[owner] == OPAQUE:
            what, problem, expected = "glass", "is opaque, so the cut looks opaque", "material dielectric"
        reason = f"{leaf.shape.upper()} {leaf.index} cuts {what} and owns the faces of the cut: {surface} {problem}"
        document.warn(f"{reason}; expected {expected} in {surface}", "csg", number)
