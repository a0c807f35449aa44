"""Reads solids from mesh files: PLY (text or binary) and OBJ."""

import hashlib
import re
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from manifold3d import Error, Manifold, Mesh64

from .grouping import group_equal
from .primitives import CornerAttributes, Mesh, Primitive

#: NumPy's name of a type -> the names of this type in PLY files.
NAMES = {"i1": "char int8", "u1": "uchar uint8", "i2": "short int16", "u2": "ushort uint16", "i4": "int int32"}
NAMES |= {"u4": "uint uint32", "f4": "float float32", "f8": "double float64"}
TYPES = {name: kind for kind, names in NAMES.items() for name in names.split()}
ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
HEADER = re.compile(rb"ply\s.*?\nend_header[ \t]*\r?\n", re.DOTALL)
#: The possible names of texture coordinates in PLY files.
UV = (("u", "v"), ("s", "t"), ("texture_u", "texture_v"))
#: The largest coordinate that is allowed; the scene language has the same limit.
LARGE = 1e15

#: The names of the properties of a PLY element, and their types. A list has two types: of its length and of its items.
Properties = list[tuple[str, list[str]]]


class MeshFile(Primitive):
    """A closed mesh from a file. Each triangle of the mesh file is a separate face of the solid, with a single facet.
    Faces of a mesh file are never treated as coincident with faces of other solids.

    A normal of the file is used if it points outwards; otherwise the normal of the triangle is used. The texture
    coordinates uv are those of the file; if the file has no uv, they are (x, y) in the coordinates of the file.
    """

    quadrics = np.empty((0, 4, 4))

    def __init__(self, data: bytes) -> None:
        """Reads the content of a mesh file. Raises ValueError, with the reason, if the file does not describe a solid.

        Vertices at equal positions become one vertex. Degenerate triangles and unused vertices are removed. If the mesh
        is inside out, all its triangles are reversed.
        """
        self.name = f"mesh {hashlib.sha256(data).hexdigest()}"
        try:
            points, index, normals, uv = _ply(data) if data[:3] == b"ply" else _obj(data.decode("latin-1"))
            _check_table(points, index[..., 0], 3)
            _check_table(uv, index[..., 1], 2)
            _check_table(normals, index[..., 2], 3)
            points, number = np.unique(points + 0.0, axis=0, return_inverse=True)  # adding 0.0 converts -0 to 0
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
        #: The dual basis of two edges of each triangle, for barycentric coordinates.
        self._dual = np.stack(
            [np.cross(c - self._origin, self._flat / square), np.cross(self._flat / square, b - self._origin)], axis=2
        )
        #: Normals (m, 3, 3) and uv (m, 3, 2) at the corners of the triangles; None if the file has no normals or no uv.
        self.normals = None if normals is None else normals[index[..., 2]]
        self.uv = None if uv is None else uv[index[..., 1]]

    def mesh(self, segments: int, facet_map: np.ndarray) -> Mesh:
        """Returns the mesh of the file; ``segments`` and ``facet_map`` have no effect."""
        return self._mesh

    def corner_attributes(self, p: np.ndarray, face: np.ndarray) -> CornerAttributes:
        """Returns normals and uv at the points ``p``, interpolated in the file's triangles whose numbers are ``face``.
        No corner shares its vertex with other triangles.

        A normal that does not point outwards is replaced by the normal of the triangle. If the file has no uv, uv is
        (x, y).
        """
        along = (p - self._origin[face, None]) @ self._dual[face]
        weights = np.concatenate([1 - along.sum(axis=2, keepdims=True), along], axis=2)
        flat = np.repeat(self._flat[face, None], 3, axis=1)
        normals = flat if self.normals is None else weights @ self.normals[face]
        outwards = np.sum(normals * flat, axis=2, keepdims=True) > 0
        uv = p[..., :2] if self.uv is None else weights @ self.uv[face]
        return CornerAttributes(np.where(outwards, normals, flat), uv, np.ones(p.shape[:2], bool))


@lru_cache(maxsize=16)
def mesh_file(data: bytes) -> MeshFile:
    """Returns the solid of a mesh file with the content ``data``. Raises ValueError if the file does not describe a
    solid.

    The result is cached, because all frames of an animation use the same file.
    """
    return MeshFile(data)


def _check_table(table: np.ndarray | None, index: np.ndarray, width: int) -> None:
    """Raises ValueError if a table of vertex data does not have a row of ``width`` numbers for each index in ``index``,
    or if the table contains a number that is not finite or whose magnitude is above LARGE.

    A table that is None causes no error.
    """
    if table is None:
        return
    if table.shape[1:] != (width,) or not 0 <= index.min() <= index.max() < len(table):
        raise ValueError("a face has a corner that does not exist, or that has too few numbers")
    if not (np.abs(table) <= LARGE).all():
        raise ValueError(f"a number is not finite, or beyond {LARGE:g}")


def _check_closed(points: np.ndarray, triangles: np.ndarray) -> None:
    """Raises ValueError if a mesh is not closed: its triangles use an edge more often in one direction than in the
    opposite direction.
    """
    a, b = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    edges, number = np.unique(np.minimum(a, b) * len(points) + np.maximum(a, b), return_inverse=True)
    wrong = np.flatnonzero(np.bincount(number, np.sign(b - a)) != 0)
    if len(wrong):
        open_edges = wrong[np.bincount(number)[wrong] % 2 == 1]
        problem = "belong to one face alone" if len(open_edges) else "have faces with different orientations"
        shown = open_edges if len(open_edges) else wrong
        start, end = (" ".join(f"{x:g}" for x in points[i]) for i in divmod(int(edges[shown[0]]), len(points)))
        raise ValueError(
            f"is not closed: {len(shown)} of its {len(edges)} edges {problem}, such as that from ({start}) to ({end}); "
            "expected a closed mesh: fill its holes, and turn its faces outwards, in the program that wrote the file"
        )


#: The content of a mesh file: vertices (n, 3); for each corner of each triangle the numbers of its vertex, uv and
#: normal (m, 3, 3); normals and uv, each None if the file does not have them for all corners.
Raw = tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray | None]


def _ply(data: bytes) -> Raw:
    """Parses the content of a PLY file. If the file has no normals or no texture coordinates, the result contains None
    instead. Raises ValueError, LookupError, OverflowError, TypeError or StopIteration if the content is wrong.
    """
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
            formats = [ORDERS[kind] + ("f8" if kind == "ascii" else TYPES[name]) for name in types]
            elements[-1][2].append((line[-1], formats))
    body, position, values = data[header.end() :], 0, dict[str, dict[str, Any]]()
    if kind == "ascii":  # the numbers become binary, so that _rows reads both kinds of files
        body = np.array(body.split(), "<f8").tobytes()
    for name, count, properties in elements:
        values[name], position = _rows(body, position, count, properties)
    vertex, face = values["vertex"], values["face"]
    uv_names = next((pair for pair in UV if set(pair) <= set(vertex)), UV[0])
    index = _fans(face.get("vertex_indices", face.get("vertex_index", ())))
    uv, normals = (
        np.stack([vertex[name] for name in names], axis=-1).astype(float) if set(names) <= set(vertex) else None
        for names in (uv_names, ("nx", "ny", "nz"))
    )
    points = np.stack([vertex[axis] for axis in "xyz"], axis=-1).astype(float)
    # A PLY file has one number for the position, the uv and the normal of a corner.
    return points, np.repeat(index[..., None], 3, axis=2), normals, uv


def _rows(body: bytes, position: int, count: int, properties: Properties) -> tuple[dict[str, Any], int]:
    """Reads ``count`` rows of a PLY element; the rows begin at the byte ``position`` of ``body``, the file's content
    after the header.

    Returns a dictionary from property names to values, and the position after the last row. The values of a property
    are an array if every list property has the same length in all rows; otherwise the values are a list with one entry
    per row. For an element without rows or properties, the dictionary is empty.
    """
    if not count or not properties:
        return {}, position
    fields: list[Any] = []  # the fields of a row, if its lists have the same lengths as in the first row
    lengths = {}
    for name, types in properties:
        shape = []
        if len(types) > 1:
            shape = np.frombuffer(body, types[0], 1, position + np.dtype(fields).itemsize).astype(int).tolist()
            lengths[f"{name} length"] = shape
            fields.append((f"{name} length", types[0]))
        fields.append((name, types[-1], tuple(shape)))
    dtype = np.dtype(fields)
    if count == 1 or len(body) - position >= count * dtype.itemsize:
        table = np.frombuffer(body, dtype, count, position)
        if all((table[name] == length).all() for name, length in lengths.items()):
            return {name: table[name] for name, _ in properties}, position + table.nbytes
    rows = []
    for _ in range(count):
        row, position = _rows(body, position, 1, properties)
        rows.append(row)
    return {name: [row_values[name][0] for row_values in rows] for name, _ in properties}, position


def _obj(text: str) -> Raw:
    """Parses the content of an OBJ file: its vertices, texture coordinates, normals and faces. Raises ValueError or
    OverflowError.

    If a corner of any face has no texture coordinates, the result contains None instead of the texture coordinates, and
    likewise for the normals.
    """
    tables: dict[str, list[list[float]]] = {"v": [], "vt": [], "vn": []}
    polygons: list[list[list[int]]] = []
    for line in re.sub(r"\\\r?\n", " ", text).replace("\r", "\n").split("\n"):
        word, *values = line.partition("#")[0].split() or [""]
        if word in tables:
            tables[word].append([float(number) for number in values[: 2 if word == "vt" else 3]])
        elif word == "f":
            corners = [[*corner.split("/"), "", ""][:3] for corner in values]
            polygons.append([[_number(n, len(tables[of])) for n, of in zip(c, tables)] for c in corners])
    index = _fans(polygons)
    uv, normals = (
        np.array(tables[word], float) if (index[..., i] >= 0).all() else None for i, word in ((1, "vt"), (2, "vn"))
    )
    return np.array(tables["v"], float), index, normals, uv


def _number(text: str, count: int) -> int:
    """Converts an index in an OBJ file to an index from 0, or to -1 if the text is empty.

    An index in an OBJ file counts from 1; a negative index counts backwards from the latest of ``count`` items. Raises
    ValueError if ``text`` is no whole number, if it is 0, and if a negative index counts back beyond the first item.
    """
    if not text:
        return -1
    number = int(text)
    if number == 0 or number < -count:
        raise ValueError(f"a face has a corner {number}, which does not exist")
    return number - 1 if number > 0 else count + number


def _fans(polygons: Sequence[Any]) -> np.ndarray:
    """Divides convex polygons, each a sequence of corners, into m triangles (m, 3, ...); polygons with fewer than 3
    corners are left out. Raises ValueError if there are no triangles.
    """
    result = []
    for count, numbers in group_equal(map(len, polygons)).items():
        with np.errstate(invalid="ignore"):  # NaN becomes an invalid index; _check_table reports it
            corners = np.array([polygons[i] for i in numbers]).astype(np.int64)
        if count > 2:
            fan = np.stack([np.repeat(corners[:, :1], count - 2, axis=1), corners[:, 1:-1], corners[:, 2:]], axis=2)
            result.append(fan.reshape(-1, *fan.shape[2:]))
    if not result:
        raise ValueError("it has no faces")
    return np.concatenate(result)
