"""Solids in files: PLY (text or binary) and OBJ."""

import hashlib
import re
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from manifold3d import Error, Manifold, Mesh64

from .grouping import group_equal
from .primitives import CornerAttributes, Mesh, Primitive

#: NumPy's types and PLY's names for them; PLY's byte orders.
NAMES = {"i1": "char int8", "u1": "uchar uint8", "i2": "short int16", "u2": "ushort uint16", "i4": "int int32"}
NAMES |= {"u4": "uint uint32", "f4": "float float32", "f8": "double float64"}
TYPES = {name: kind for kind, names in NAMES.items() for name in names.split()}
ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
HEADER = re.compile(rb"ply\s.*?\nend_header[ \t]*\r?\n", re.DOTALL)
#: The names of PLY's texture coordinates.
UV = (("u", "v"), ("s", "t"), ("texture_u", "texture_v"))
#: The largest coordinate, that of the language.
LARGE = 1e15

#: The names and types of a PLY element's values; a list has two types, of its length and of its items.
Properties = list[tuple[str, list[str]]]


class MeshFile(Primitive):
    """A closed mesh. Its facets and its faces are its triangles; none is tested for coincidence with other solids.

    The normals are the file's, or those of the faces where it has none or they look to the wrong side; uv is the
    file's, or else (x, y).
    """

    quadrics = np.empty((0, 4, 4))

    def __init__(self, data: bytes) -> None:
        """Reads the content of a file. Raises ValueError, with the reason, if it is not a solid."""
        self.name = f"mesh {hashlib.sha256(data).hexdigest()}"
        try:
            points, index, normals, uv = _ply(data) if data[:3] == b"ply" else _obj(data.decode("latin-1"))
            _check_table(points, index[..., 0], 3)
            _check_table(uv, index[..., 1], 2)
            _check_table(normals, index[..., 2], 3)
            points, number = np.unique(points + 0.0, axis=0, return_inverse=True)  # -0 is 0
        except (ValueError, OverflowError, LookupError, TypeError, StopIteration) as error:
            why = error if isinstance(error, (ValueError, OverflowError)) else "its header is not a mesh header"
            raise ValueError(f"cannot be read: {why}; expected a whole file, PLY or OBJ") from None
        triangles = number.reshape(-1)[index[..., 0]]
        proper = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
        used, corner = np.unique(triangles[proper], return_inverse=True)
        points, triangles, index = points[used], corner.reshape(-1, 3), index[proper]
        _check_closed(points, triangles)
        solid = Manifold(Mesh64(points, triangles.astype(np.uint64)))
        if solid.status() != Error.NoError or solid.volume() == 0:
            raise ValueError("encloses nothing; expected a closed mesh")
        if solid.volume() < 0:
            triangles, index = triangles[:, ::-1], index[:, ::-1]
        self.box = np.stack([points.min(axis=0), points.max(axis=0)])
        self._mesh = Mesh(points, triangles, np.arange(len(triangles)), np.arange(len(triangles)))
        self._origin, b, c = (points[triangles[:, i]] for i in range(3))
        self._flat = np.cross(b - self._origin, c - self._origin)
        square = np.maximum(np.sum(self._flat**2, axis=1, keepdims=True), 1e-300)
        #: The dual basis of two edges: gives barycentric coordinates.
        self._dual = np.stack(
            [np.cross(c - self._origin, self._flat / square), np.cross(self._flat / square, b - self._origin)], axis=2
        )
        #: Of the triangles' corners, (m, 3, 3) and (m, 3, 2); None if the file lacks them.
        self.normals = None if normals is None else normals[index[..., 2]]
        self.uv = None if uv is None else uv[index[..., 1]]

    def mesh(self, segments: int, facet_map: np.ndarray) -> Mesh:
        """The file's mesh, for any number of segments."""
        return self._mesh

    def count(self, segments: int) -> int:
        """How many triangles it has."""
        return len(self._mesh.triangles)

    def corner_attributes(self, p: np.ndarray, face: np.ndarray) -> CornerAttributes:
        """The file's normals and (u, v), interpolated over its triangles ``face``."""
        along = (p - self._origin[face, None]) @ self._dual[face]
        weights = np.concatenate([1 - along.sum(axis=2, keepdims=True), along], axis=2)
        flat = np.repeat(self._flat[face, None], 3, axis=1)
        normals = flat if self.normals is None else weights @ self.normals[face]
        outwards = np.sum(normals * flat, axis=2, keepdims=True) > 0
        uv = p[..., :2] if self.uv is None else weights @ self.uv[face]
        return CornerAttributes(np.where(outwards, normals, flat), uv, np.ones(p.shape[:2], bool))


@lru_cache(maxsize=16)
def mesh_file(data: bytes) -> MeshFile:
    """The solid of a file with this content, cached for the frames of a film. Raises ValueError as MeshFile does."""
    return MeshFile(data)


def _check_table(table: np.ndarray | None, index: np.ndarray, width: int) -> None:
    """Raises ValueError unless there is no table, or it has ``width`` numbers for each index."""
    if table is None:
        return
    if table.shape[1:] != (width,) or not 0 <= index.min() <= index.max() < len(table):
        raise ValueError("a face has a corner that does not exist, or that has too few numbers")
    if not (np.abs(table) <= LARGE).all():
        raise ValueError(f"a number is not finite, or beyond {LARGE:g}")


def _check_closed(points: np.ndarray, triangles: np.ndarray) -> None:
    """Raises ValueError unless each edge occurs as often in one direction as in the other."""
    a, b = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    edges, number = np.unique(np.minimum(a, b) * len(points) + np.maximum(a, b), return_inverse=True)
    wrong = np.flatnonzero(np.bincount(number, np.sign(b - a)) != 0)
    if len(wrong):
        open_edges = wrong[np.bincount(number)[wrong] % 2 == 1]
        what = "belong to one face alone" if len(open_edges) else "have faces that are wound to different sides"
        some = open_edges if len(open_edges) else wrong
        start, end = (" ".join(f"{x:g}" for x in points[i]) for i in divmod(int(edges[some[0]]), len(points)))
        raise ValueError(
            f"is not closed: {len(some)} of its {len(edges)} edges {what}, such as that from ({start}) to ({end}); "
            "expected a closed mesh: fill its holes, and turn its faces outwards, in the program that made it"
        )


#: Vertices (n, 3); the numbers of vertex, (u, v) and normal of the triangles' corners (m, 3, 3); normals and
#: (u, v), if the file has them for all corners.
Raw = tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray | None]


def _ply(data: bytes) -> Raw:
    """The content of a PLY file. Raises ValueError, IndexError, KeyError or OverflowError."""
    header = HEADER.match(data)
    if header is None:
        raise ValueError("its header has no end")
    elements: list[tuple[str, int, Properties]] = []
    lines = [line.split() for line in header[0].decode("latin-1").splitlines()]
    kind = next(line[1] for line in lines if line[:1] == ["format"])
    for line in lines:
        if line[:1] == ["element"]:
            elements.append((line[1], int(line[2]), []))
        elif line[:1] == ["property"]:
            types = line[2:4] if line[1] == "list" else line[1:2]
            order = [ORDERS[kind] + ("f8" if kind == "ascii" else TYPES[name]) for name in types]
            elements[-1][2].append((line[-1], order))
    body, at, found = data[header.end() :], 0, dict[str, dict[str, Any]]()
    if kind == "ascii":
        body = np.array(body.split(), "<f8").tobytes()
    for name, count, properties in elements:
        found[name], at = _rows(body, at, count, properties)
    vertex, face = found["vertex"], found["face"]
    uv_names = next((pair for pair in UV if set(pair) <= set(vertex)), UV[0])
    index = _fans(face.get("vertex_indices", face.get("vertex_index", ())))
    uv, normals = (
        np.stack([vertex[name] for name in names], axis=-1).astype(float) if set(names) <= set(vertex) else None
        for names in (uv_names, ("nx", "ny", "nz"))
    )
    points = np.stack([vertex[axis] for axis in "xyz"], axis=-1).astype(float)
    return points, np.repeat(index[..., None], 3, axis=2), normals, uv


def _rows(body: bytes, at: int, count: int, properties: Properties) -> tuple[dict[str, Any], int]:
    """The values of ``count`` rows of an element by their names, and where the next element begins."""
    if not count or not properties:
        return {}, at
    fields: list[Any] = []  # of a row whose lists have the lengths of the first row's lists
    lengths = {}
    for name, types in properties:
        if len(types) > 1:
            lengths[f"{name} length"] = int(np.frombuffer(body, types[0], 1, at + np.dtype(fields).itemsize)[0])
            fields.append((f"{name} length", types[0]))
            fields.append((name, types[1], (lengths[f"{name} length"],)))
        else:
            fields.append((name, types[0]))
    dtype = np.dtype(fields)
    if count == 1 or len(body) - at >= count * dtype.itemsize:
        table = np.frombuffer(body, dtype, count, at)
        if all((table[name] == length).all() for name, length in lengths.items()):
            return {name: table[name] for name, _ in properties}, at + table.nbytes
    rows = []
    for _ in range(count):
        row, at = _rows(body, at, 1, properties)
        rows.append(row)
    return {name: [one[name][0] for one in rows] for name, _ in properties}, at


def _obj(text: str) -> Raw:
    """The content of an OBJ file. Raises ValueError or IndexError."""
    found: dict[str, list[list[float]]] = {"v": [], "vt": [], "vn": []}
    polygons: list[list[list[int]]] = []
    for line in re.sub(r"\\\r?\n", " ", text).replace("\r", "\n").split("\n"):
        word, *rest = line.partition("#")[0].split() or [""]
        if word in found:
            found[word].append([float(number) for number in rest[: 2 if word == "vt" else 3]])
        elif word == "f":
            corners = [[*corner.split("/"), "", ""][:3] for corner in rest]
            polygons.append([[_number(n, len(found[of])) for n, of in zip(c, found)] for c in corners])
    index = _fans(polygons)
    uv, normals = (
        np.array(found[word], float) if (index[..., i] >= 0).all() else None for i, word in ((1, "vt"), (2, "vn"))
    )
    return np.array(found["v"], float), index, normals, uv


def _number(text: str, count: int) -> int:
    """OBJ's index (from 1, or negative from the last one so far) as an index from 0; -1 if it is empty."""
    if not text:
        return -1
    number = int(text)
    if number == 0 or number < -count:
        raise ValueError(f"a face has a corner {number}, which does not exist")
    return number - 1 if number > 0 else count + number


def _fans(polygons: Sequence[Any]) -> np.ndarray:
    """The triangles (m, 3, ...) of convex polygons, each a sequence of corners. Raises ValueError if there are none."""
    result = []
    for count, numbers in group_equal(map(len, polygons)).items():
        with np.errstate(invalid="ignore"):  # NaN becomes an invalid index, which is checked later
            some = np.array([polygons[i] for i in numbers]).astype(np.int64)
        if count > 2:
            fan = np.stack([np.repeat(some[:, :1], count - 2, axis=1), some[:, 1:-1], some[:, 2:]], axis=2)
            result.append(fan.reshape(-1, *fan.shape[2:]))
    if not result:
        raise ValueError("it has no faces")
    return np.concatenate(result)
