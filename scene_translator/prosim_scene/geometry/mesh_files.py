"""Makes solids from mesh files, and checks that their meshes bound solids."""

import hashlib
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from manifold3d import Error, Manifold, Mesh64, OpType
from manifold3d import Mesh as MeshOfFloats

from .mesh_formats import MeshError, parse
from .primitives import CornerAttributes, Mesh, Primitive

#: The largest coordinate that is allowed; the scene language has the same limit.
LARGE = 1e15
#: The number of points of a mesh at which the winding number is tested, and the smallest number for each part.
TESTED, TESTED_OF_PART = 4096, 4
#: The depth below a face at which the winding number is tested, relative to the size of the mesh.
DEPTH = 1e-8


class MeshFile(Primitive):
    """A closed mesh from a file. Each triangle of the mesh file is a separate face of the solid, with a single facet.
    Faces of a mesh file are only treated as coincident with those of a copy of the solid.

    A normal of the file is used if it points outwards; otherwise the normal of the triangle is used. The texture
    coordinates uv are those of the file; where the file has no uv, they are (x, y) in the coordinates of the file.
    ``warning`` describes overlaps in the mesh, and is "" if there are none.
    """

    quadrics = np.empty((0, 4, 4))

    def __init__(self, data: bytes) -> None:
        """Reads the content of a mesh file. Raises ValueError, with the reason, if the file does not describe a solid.

        Vertices at equal positions become one vertex, and so do vertices of open edges whose positions differ by the
        rounding of single precision. Degenerate triangles and unused vertices are removed. If the mesh is inside out,
        all its triangles are reversed. Parts of the mesh that overlap become one.
        """
        self.name = f"mesh {hashlib.sha256(data).hexdigest()}"
        try:
            points, index, uv, normals = parse(data)
            for i, (table, width) in enumerate(((points, 3), (uv, 2), (normals, 3))):
                _check_table(table, index[..., i], width, least=-1 if i else 0)
            points, number = np.unique(points + 0.0, axis=0, return_inverse=True)  # adding 0.0 converts -0 to 0
        except (ValueError, OverflowError, LookupError, TypeError) as error:
            why = error if isinstance(error, MeshError) else "it is damaged, or in another format"
            raise ValueError(f"cannot be read: {why}; expected a closed mesh in PLY, OBJ, STL or OFF") from None
        triangles = number.reshape(-1)[index[..., 0]]
        triangles = _joined(points, triangles[_proper(triangles)])[triangles]
        proper = _proper(triangles)
        used, corner = np.unique(triangles[proper], return_inverse=True)
        points, triangles, index = points[used], corner.reshape(-1, 3), index[proper]
        _check_closed(points, triangles)
        solid = _manifold(points, triangles)
        if solid.status() != Error.NoError or _flat(solid):
            raise ValueError("encloses nothing; expected a closed mesh")
        if solid.volume() < 0:
            triangles, index = triangles[:, ::-1], index[:, ::-1]
            solid = _manifold(points, triangles)
        self.box = np.stack([points.min(axis=0), points.max(axis=0)])
        faces = np.arange(len(triangles))
        self._mesh = Mesh(points, triangles, faces, faces)
        united, self.warning = _united(solid)
        if united is not None:
            mesh = united.to_mesh64()
            self._mesh = Mesh(mesh.vert_properties[:, :3], mesh.tri_verts.astype(int), np.array(mesh.face_id), faces)
        self._origin, b, c = (points[triangles[:, i]] for i in range(3))
        self._flat = np.cross(b - self._origin, c - self._origin)
        square = np.maximum(np.sum(self._flat**2, axis=1, keepdims=True), 1e-300)
        #: The dual basis of two edges of each triangle, for barycentric coordinates.
        self._dual = np.stack(
            [np.cross(c - self._origin, self._flat / square), np.cross(self._flat / square, b - self._origin)], axis=2
        )
        #: Normals (m, 3, 3), 0 if the file has none, and uv (m, 3, 2), or NaN, at the corners of the triangles.
        self.normals = np.append(normals, [[0, 0, 0]], axis=0)[index[..., 2]]
        if np.einsum("tcx,tx->", self.normals, self._flat) < 0:
            self.normals *= -1
        self.uv = np.append(uv, [[np.nan, np.nan]], axis=0)[index[..., 1]]

    def mesh(self, segments: int, facet_map: np.ndarray) -> Mesh:
        """Returns the mesh of the file."""
        return self._mesh

    def corner_attributes(self, p: np.ndarray, face: np.ndarray) -> CornerAttributes:
        """Returns normals (those of the triangle if the file's normals point inwards) and uv ((x, y) if the file has
        no uv), interpolated in the triangles ``face``. No corner is shared.
        """
        along = (p - self._origin[face, None]) @ self._dual[face]
        weights = np.concatenate([1 - along.sum(axis=2, keepdims=True), along], axis=2)
        flat = np.repeat(self._flat[face, None], 3, axis=1)
        normals, uv = weights @ self.normals[face], weights @ self.uv[face]
        outwards = np.sum(normals * flat, axis=2, keepdims=True) > 0
        uv = np.where(np.isnan(uv), p[..., :2], uv)
        return CornerAttributes(np.where(outwards, normals, flat), uv, np.ones(p.shape[:2], bool))


#: A cached :class:`MeshFile`, because all frames of an animation use the same files.
mesh_file = lru_cache(maxsize=16)(MeshFile)


def _check_table(table: np.ndarray, index: np.ndarray, width: int, least: int) -> None:
    if table.shape != (len(table), width) or not least <= index.min() <= index.max() < len(table):
        raise MeshError("a face has a corner that does not exist, or that has too few numbers")
    if not (np.abs(table) <= LARGE).all():
        raise MeshError(f"a number is not finite, or beyond {LARGE:g}")


def _proper(triangles: np.ndarray) -> np.ndarray:
    return np.asarray((triangles != np.roll(triangles, 1, axis=1)).all(axis=1))


def _joined(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Returns a number for each point: vertices of open edges that are equal in single precision have equal numbers."""
    mesh, number = MeshOfFloats(points.astype("f4"), triangles.astype("u4")), np.arange(len(points))
    if mesh.merge():
        number[np.array(mesh.merge_from_vert, int)] = np.array(mesh.merge_to_vert, int)
    return number


def _check_closed(points: np.ndarray, triangles: np.ndarray) -> None:
    """Raises ValueError if triangles use an edge more often in one direction than in the other."""
    a, b = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    edges, number = np.unique(np.minimum(a, b) * len(points) + np.maximum(a, b), return_inverse=True)
    wrong = np.flatnonzero(np.bincount(number, np.sign(b - a)) != 0)
    if len(wrong):
        open_edges = wrong[np.bincount(number)[wrong] % 2 == 1]
        problem = "belong to one face alone" if len(open_edges) else "have faces with different orientations"
        shown = open_edges if len(open_edges) else wrong
        start, end = (_point(points[i]) for i in divmod(int(edges[shown[0]]), len(points)))
        raise ValueError(
            f"is not closed: {len(shown)} of its {len(edges)} edges {problem}, such as that from {start} to {end}; "
            "expected a closed mesh: fill its holes, and turn its faces outwards, in the program that wrote the file"
        )


def _manifold(points: np.ndarray, triangles: np.ndarray) -> Manifold:
    return Manifold(Mesh64(points, triangles.astype(np.uint64), face_id=np.arange(len(triangles), dtype=np.uint64)))


def _flat(solid: Manifold) -> bool:
    """Returns whether the volume is 0 but for a rounding error, as that of a flap of faces back to back."""
    return bool(abs(solid.volume()) <= DEPTH * solid.surface_area() ** 1.5)


def _united(solid: Manifold) -> tuple[Manifold | None, str]:
    """Returns the union of the parts, or None if none touch, and a warning of overlaps or flaps, or "". Cavities are
    parts; overlaps beside one are not united. Raises ValueError if a part is inside out.
    """
    parts, unite = solid.decompose(), "unite them in the program that wrote the file"
    solids, united, flaps = [part for part in parts if not _flat(part)], None, ""
    if len(solids) < len(parts):
        united = solid = Manifold.compose(solids)
        flaps = "has parts without a volume, which are left out"
    overlap = remaining = _overlap(solid, solids)
    if len(solids) > 1 and all(part.volume() > 0 for part in solids):
        union = Manifold.batch_boolean(solids, OpType.Add)
        if union.surface_area() < (1 - 1e-9) * solid.surface_area():
            united, remaining = union, _overlap(union, union.decompose())
    if remaining:
        return united, f"overlaps itself in {remaining}; faces inside it may show in glass and in cuts; {unite}"
    if united is None or united.volume() > (1 - 1e-9) * solid.volume():  # the parts at most touch each other
        return united, flaps
    return united, f"has parts that overlap{', such as ' * bool(overlap)}{overlap}; they become one solid; {unite}"


def _overlap(solid: Manifold, parts: Sequence[Manifold]) -> str:
    """Describes a part of a solid that overlaps another part or itself; returns "" if no part does. Raises ValueError
    if a part is inside out.

    Right below each face of a solid the winding number is 1. Above 1, the solid overlaps itself; below 1, the face is
    inside out. Only TESTED points are tested, so a small overlap may not be found.
    """
    result = ""
    for part in parts:
        places = _wrong_places(solid, part, max(TESTED // len(parts), TESTED_OF_PART))
        if not places:
            continue
        low, high = np.reshape(part.bounding_box(), (2, 3))
        name = f"the part from {_point(low)} to {_point(high)}"
        if part.volume() < 0 and min(winding for _, winding in places) < 1:
            reason = f"is inside out in {name}; turn its faces outwards in the program that wrote the file"
            raise ValueError(f"{reason}; a cavity has to lie inside a solid")
        result = result or f"{name}, near {_point(places[0][0])}"
    return result


def _wrong_places(solid: Manifold, part: Manifold, count: int) -> list[tuple[np.ndarray, int]]:
    mesh, generator = part.to_mesh64(), np.random.default_rng(0)
    chosen = np.repeat(mesh.tri_verts, 2, axis=0)
    if len(chosen) > count:
        chosen = chosen[generator.choice(len(chosen), count, replace=False)]
    corners = mesh.vert_properties[chosen.astype(int)][..., :3]
    edges = np.roll(corners, -1, axis=1) - corners
    normals, longest = np.cross(edges[:, 0], edges[:, 1]), np.linalg.norm(edges, axis=2).max(axis=1)
    size = float(np.ptp(np.reshape(solid.bounding_box(), (2, 3)), axis=0).max())
    area = np.linalg.norm(normals, axis=1)
    weights = generator.dirichlet((4, 4, 4), len(corners))
    # Half of the points are near a corner, because a vertex in a wrong place bears long faces.
    weights[1::2] = 0.02 * weights[1::2] + 0.98 * np.eye(3)[generator.integers(3, size=len(corners) // 2)]
    wide = area * (1 - weights.max(axis=1)) > 50 * DEPTH * size * longest
    normals = normals[wide] / area[wide, None]
    points = np.einsum("nc,ncx->nx", weights, corners)[wide]
    # A ray is nearly parallel to an axis, so that its bounding box, and the search in it, are small.
    axes = np.argmax(np.abs(normals), axis=1)
    directions = np.sign(normals) * (np.arange(3) == axes[:, None]) * 2 * size
    tilts = generator.normal(0, 1e-3 * size, (3, 3))
    result = []
    for point, start, direction in zip(points, points - DEPTH * size * normals, directions):
        # A ray that meets an edge may be wrong, so three rays have to agree.
        windings = {_winding(solid, start, direction + tilt) for tilt in tilts}
        if len(windings) == 1 and windings != {1}:
            result.append((point, windings.pop()))
    return result


def _winding(solid: Manifold, start: np.ndarray, direction: np.ndarray) -> int:
    hits = solid.ray_cast(start, start + direction)
    return sum(1 if np.dot(hit.normal, direction) > 0 else -1 for hit in hits)


def _point(coordinates: np.ndarray) -> str:
    return f"({' '.join(f'{x:g}' for x in coordinates)})"
