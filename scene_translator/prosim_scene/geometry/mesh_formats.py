"""Parses mesh files: PLY (text or binary), OBJ, STL (text or binary) and OFF."""

# trimesh 5.2 misreads relative indices and tabs in OBJ, and refuses binary PLY with triangles and quads; meshio 5.3
# refuses OBJ whose uv are not as many as its points, and ends the process if a file is damaged.

import re
from itertools import compress
from typing import Any, NamedTuple

import numpy as np
from manifold3d import triangulate

from ..language.analysis import garbage_collection_paused
from ..text_files import BYTE_ORDER_MARKS, decode

#: NumPy's name of a type -> the names of this type in PLY files.
NAMES = {"i1": "char int8", "u1": "uchar uint8", "i2": "short int16", "u2": "ushort uint16", "i4": "int int32"}
NAMES |= {"u4": "uint uint32", "f4": "float float32", "f8": "double float64"}
TYPES = {name: kind for kind, names in NAMES.items() for name in names.split()}
ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
HEADER = re.compile(rb"ply[ \t]*(\r\n|\r|\n).*?\1end_header[ \t]*\r??\1", re.DOTALL)
#: The possible names of texture coordinates in PLY files.
UV = (("u", "v"), ("s", "t"), ("texture_u", "texture_v"))
#: A triangle in a binary STL file, whose header has 84 bytes.
STL_TRIANGLE, STL_HEADER = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]), 84
#: The beginning of an OFF file; the letters before OFF announce normals, colours or uv after x y z, which are ignored.
OFF = re.compile(r"(?:\s|#[^\n]*\n)*(?:C|N|ST)*OFF\b")
POINT_ONLY = [True, False, False]  # of the three numbers of a corner
LEFT_OUT = 1 << 62  # stands for a number that is left out of a corner in an OBJ file, as in 1//3
CONTRADICTION = "its content does not agree with its header"
#: The names of the properties of a PLY element, and their types. A list has two types: of its length and of its items.
Properties = list[tuple[str, list[str]]]


class MeshError(ValueError):
    """The content of a mesh file is wrong; the message describes the reason to the user."""


class MeshData(NamedTuple):
    """The content of a mesh file: tables of ``points`` (n, 3), ``uv`` (k, 2) and ``normals`` (l, 3); ``corners`` (m, 3,
    3) has, for each corner of each triangle, the numbers of its point, uv and normal, or -1 if the corner has none.
    """

    points: np.ndarray
    corners: np.ndarray
    uv: np.ndarray = np.empty((0, 2))
    normals: np.ndarray = np.empty((0, 3))


@garbage_collection_paused()
def parse(data: bytes) -> MeshData:
    """Parses the content of a mesh file; its first bytes determine its format. Raises MeshError, or another
    ValueError, OverflowError, LookupError or TypeError, if the content is wrong.
    """
    if data.startswith(BYTE_ORDER_MARKS):
        data = decode(data).encode()
    if data[:3] == b"ply":
        return _ply(data)
    count = int.from_bytes(data[80:STL_HEADER], "little")
    excess = len(data) - STL_HEADER - STL_TRIANGLE.itemsize * count
    is_binary = data[83:STL_HEADER] == b"\0"  # the last byte of the count, as the size of mesh files is limited
    if excess == 0 or (excess > 0 and is_binary):  # some programs write more behind the triangles
        return _separate(np.frombuffer(data, STL_TRIANGLE, count, STL_HEADER)["corners"].astype(float))
    if is_binary:
        raise ValueError  # the file is cut off, or no STL file
    text = decode(data)
    if re.match(r"\s*solid\b", text, re.IGNORECASE):
        return _stl(text.lower())
    return _off(text) if OFF.match(text) else _obj(text)


def _ply(data: bytes) -> MeshData:
    header = HEADER.match(data)
    if header is None:
        raise MeshError("its header has no end")
    elements: list[tuple[str, int, Properties]] = []
    lines = [line.split() for line in header[0].decode("latin-1").splitlines()]
    kind = next((line[1] for line in lines if line[:1] == ["format"]), "")
    for line in lines:
        if line[:1] == ["element"]:
            elements.append((line[1], int(line[2]), []))
            if elements[-1][1] < 0:
                raise MeshError(f"its header has a negative count, {line[2]}")
        elif line[:1] == ["property"]:
            types = line[2:4] if line[1] == "list" else line[1:2]
            formats = [ORDERS[kind] + ("f8" if kind == "ascii" else TYPES[name]) for name in types]
            elements[-1][2].append((line[-1], formats))
    body, position, values = data[header.end() :], 0, dict[str, dict[str, Any]]()
    if kind == "ascii":  # the numbers become binary, so that _rows reads both kinds of files; inf ends a row
        body = np.array(b" inf ".join([*filter(bytes.strip, body.splitlines()), b""]).split(), "<f8").tobytes()
        elements = [(name, count, [*properties, ("row end", ["<f8"])]) for name, count, properties in elements]
    try:
        with np.errstate(invalid="ignore"):  # of inf as the length of a list
            for name, count, properties in elements:
                values[name], position = _rows(body, position, count, properties)
        valid = position == len(body) and all(np.isinf(rows.get("row end", np.inf)).all() for rows in values.values())
    except (ValueError, OverflowError):
        valid = False
    if not valid:
        raise MeshError(CONTRADICTION)
    if not values.get("face") and values.get("tristrips"):
        raise MeshError("it has triangle strips instead of faces")
    return _ply_mesh(values["vertex"], values.get("face", {}))


def _ply_mesh(vertex: dict[str, Any], face: dict[str, Any]) -> MeshData:
    uv_names = next((pair for pair in UV if set(pair) <= set(vertex)), UV[0])
    corners = face.get("vertex_indices", face.get("vertex_index", ()))
    points, uv, normals = (
        np.stack([vertex[name] for name in names], axis=-1).astype(float) if set(names) <= set(vertex) else np.empty(0)
        for names in ("xyz", uv_names, ("nx", "ny", "nz"))
    )
    numbers, counts = _flat(corners)
    with np.errstate(invalid="ignore"):  # NaN becomes an invalid index, which is an error later
        numbers = numbers.astype(int)
    triangles = _triangles(points, numbers, counts)
    index = np.where([True, uv.size > 0, normals.size > 0], numbers[triangles][..., None], -1)
    if "texcoord" in face:  # uv of each corner of a face, where the others have those of a vertex
        uv, index[..., 1] = _flat(face["texcoord"])[0], triangles
        if len(uv) != 2 * len(numbers):
            raise MeshError("its texcoord lists do not have two numbers for each corner of a face")
    return MeshData(points, index, uv.astype(float).reshape(-1, 2), normals.reshape(-1, 3))


def _flat(rows: Any) -> tuple[np.ndarray, np.ndarray]:
    """Returns the items of all rows in one array, and the length of each row."""
    if isinstance(rows, np.ndarray):
        return rows.ravel(), np.full(len(rows), rows.shape[-1])
    return np.concatenate(rows or [[]]), np.array([*map(len, rows)], int)


def _rows(body: bytes, position: int, count: int, properties: Properties) -> tuple[dict[str, Any], int]:
    """Reads ``count`` rows of a PLY element at ``position``; returns name -> values, and the position behind. Values
    are an array, or a list by row if a list property varies in length.
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
        if count == 1:
            raise MeshError(CONTRADICTION)  # the length of a list is not a whole number
    rows = []
    for _ in range(count):
        row, position = _rows(body, position, 1, properties)
        rows.append(row)
    return {name: [row_values[name][0] for row_values in rows] for name, _ in properties}, position


def _obj(text: str) -> MeshData:
    text = re.sub("#[^\n]*", "", text).replace("\\\n", " ")  # a comment may end with a \, as folders do on Windows
    points, uv, normals, polygons = (_obj_lines(text, word) for word in ("v", "vt", "vn", "f"))
    for line in points:
        row = line.split()
        # After x y z there may be a weight w, or a colour r g b, or both.
        if len(row) not in (3, 4, 6, 7):
            raise MeshError(f"a vertex has {len(row)} numbers; expected x y z")
        if len(row) in (4, 7) and float(row[3]) != 1:
            raise MeshError(f"a vertex has the weight {row[3]} after x y z; only 1 is supported")
    counts = np.array([len(line.split()) for line in polygons], int)
    numbers = _obj_corners(polygons)
    del polygons  # frees memory
    if (numbers < 0).any():  # numbers that are relative to the rows before the face
        words = np.array(re.findall(r"^[^\S\n]*(vt|vn|v|f)(?!\S)", text, re.MULTILINE))
        before = (words[:, None] == ["v", "vt", "vn"]).cumsum(axis=0)[words == "f"].repeat(counts, axis=0)
        numbers = np.where((numbers < 0) & (numbers >= -before), before + numbers + 1, numbers)
    for number in numbers[numbers <= 0][:1]:
        raise MeshError(f"a face has a corner {number}, which does not exist")
    numbers[numbers == LEFT_OUT] = 0
    numbers -= 1
    tables = [_obj_table(lines, width) for lines, width in ((points, 3), (uv, 2), (normals, 3))]
    return MeshData(tables[0], numbers[_triangles(tables[0], numbers[:, 0], counts)], *tables[1:])


def _obj_lines(text: str, word: str) -> list[str]:
    """Returns what follows ``word`` in each line of an OBJ file that begins with this word."""
    return re.findall(rf"^[^\S\n]*{word}(?!\S)(.*)", text, re.MULTILINE) if word in text else []


def _obj_table(lines: list[str], width: int) -> np.ndarray:
    """Returns the first ``width`` numbers of each line of an OBJ file."""
    values = (float(number) for line in lines for number in line.split()[:width])
    return np.fromiter(values, float).reshape(len(lines), width)


def _obj_corners(polygons: list[str]) -> np.ndarray:
    """Returns the numbers (n, 3) of all n corners of the polygons in an OBJ file, or LEFT_OUT."""
    corners = [corner for line in polygons for corner in line.split()]
    slashes = np.array([corner.count("/") for corner in corners])
    numbers = np.full((len(corners), 3), LEFT_OUT)
    for slash_count in np.unique(slashes).tolist():
        chosen = compress(corners, slashes == slash_count)
        values = np.fromiter((int(number or LEFT_OUT) for one in chosen for number in one.split("/")), int)
        numbers[slashes == slash_count, : slash_count + 1] = values.reshape(-1, slash_count + 1)
    return numbers


def _stl(text: str) -> MeshData:
    corners = re.findall(r"^\s*vertex\s+(\S+)\s+(\S+)\s+(\S+)\s*$", text, re.MULTILINE)
    if len(corners) != 3 * len(re.findall(r"\bend\s*facet", text)) or not re.search(r"\bend\s*solid", text):
        raise MeshError("its facets are not complete")
    return _separate(np.array(corners, float).reshape(-1, 3, 3))


def _separate(corners: np.ndarray) -> MeshData:
    if not len(corners):
        raise MeshError("it has no faces")
    index = np.arange(3 * len(corners)).reshape(-1, 3)
    return MeshData(corners.reshape(-1, 3), np.where(POINT_ONLY, index[..., None], -1))


def _off(text: str) -> MeshData:
    rows = [row for line in text.split("\n") if (row := line.partition("#")[0].split())]
    point_count, face_count = map(int, (rows.pop(0)[1:] or rows.pop(0))[:2])
    points, faces = np.array(rows[:point_count], float)[:, :3], rows[point_count:]
    counts = np.array([row[0] for row in faces], int)
    if point_count < 0 or len(faces) != face_count or any(not 0 <= n < len(row) for n, row in zip(counts, faces)):
        raise MeshError(CONTRADICTION)
    index = np.array([number for n, row in zip(counts, faces) for number in row[1 : n + 1]], int)
    return MeshData(points, np.where(POINT_ONLY, index[_triangles(points, index, counts)][..., None], -1))


def _triangles(points: np.ndarray, corners: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Divides polygons into m triangles; returns the places (m, 3) of their corners in ``corners``, which has the
    numbers of the ``points`` at the corners of all polygons, which may be wrong; ``counts`` has how many each polygon
    has. Polygons with fewer than 3 corners are left out. Raises MeshError if there are no triangles.
    """
    result, first = [], np.cumsum(counts) - counts
    positions = points if points.ndim == 2 and points.shape[1] == 3 and len(points) else np.zeros((1, 3))
    for count in dict.fromkeys(counts[counts > 2].tolist()):
        places = first[counts == count, None] + np.arange(count)
        fans = np.stack([np.repeat(places[:, :1], count - 2, axis=1), places[:, 1:-1], places[:, 2:]], axis=2)
        if count > 3:
            polygons = positions[np.clip(corners[places], 0, len(positions) - 1)]
            normals, concave = _normals(polygons)
            result += [places[i, _ears(polygons[i], normals[i])] for i in np.flatnonzero(concave).tolist()]
            fans = fans[~concave]
        result.append(fans.reshape(-1, 3))
    if not result:
        raise MeshError("it has no faces")
    return np.concatenate(result)


def _normals(polygons: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the normals of polygons (n, corners, 3), and of which of them a fan of triangles would overlap itself."""
    with np.errstate(over="ignore", invalid="ignore"):
        edges = polygons[:, 1:] - polygons[:, :1]
        fans = np.cross(edges[:, :-1], edges[:, 1:])
        normals = fans.sum(axis=1)
        along = np.einsum("pfx,px->pf", fans, normals)
        return normals, along.min(axis=1) < -1e-6 * np.sum(normals**2, axis=1)  # less is a rounding error


def _ears(polygon: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Returns the corners (m, 3) of the triangles of a concave polygon."""
    right = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    up = np.cross(normal, right)
    flat = polygon @ np.stack([right / np.linalg.norm(right), up / np.linalg.norm(up)], axis=1)
    return np.asarray(triangulate([flat]))
