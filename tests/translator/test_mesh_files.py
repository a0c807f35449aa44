"""MESH: solids in PLY, OBJ, STL and OFF files."""

import re
import warnings
from contextlib import suppress
from itertools import pairwise

import numpy as np
import prosim_scene
import pytest
from manifold3d import Manifold
from meshes import scene
from prosim_scene import SceneError
from prosim_scene.geometry.mesh_files import MeshFile
from prosim_scene.geometry.primitives import PRIMITIVES
from scipy.spatial.transform import Rotation

pytestmark = pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")

CUBE = PRIMITIVES["cube"].mesh(4, np.eye(4))
#: Corners of the cube's faces, outwards.
SQUARES = [(0, 1, 3, 2), (0, 4, 5, 1), (0, 2, 6, 4), (4, 6, 7, 5), (2, 3, 7, 6), (1, 5, 7, 3)]


def ply(kind, squares=SQUARES, vertices=CUBE.vertices, names="xyz"):
    header = f"ply\nformat {kind} 1.0\ncomment a cube\nelement vertex {len(vertices)}\n"
    header += "".join(f"property float {name}\n" for name in names) + "element edge 0\nproperty int vertex1\n"
    header += f"element face {len(squares)}\nproperty uchar flags\nproperty list uchar int vertex_indices\nend_header\n"
    if kind == "ascii":
        rows = [" ".join(map(str, v)) for v in vertices] + [" ".join(map(str, (9, len(s), *s))) for s in squares]
        return (header + "\n".join(rows) + "\n").encode()
    order = "<" if "little" in kind else ">"
    rows = [np.array([9, len(s)], "u1").tobytes() + np.array(s, order + "i4").tobytes() for s in squares]
    return header.encode() + vertices.astype(order + "f4").tobytes() + b"".join(rows)


def obj(squares=SQUARES, vertices=CUBE.vertices):
    rows = ["# a cube", "o cube", *(f"v {x} {y} {z}" for x, y, z in vertices)]
    return "\r\n".join([*rows, *("f " + " ".join(str(i + 1) for i in s) for s in squares)]).encode()


def stl(squares=SQUARES, binary=True):
    corners = [[CUBE.vertices[i] for i in (s[0], *s[k : k + 2])] for s in squares for k in (1, 2)]
    if binary:
        facets = [np.array([(0, 0, 0), *c], "<f4").tobytes() + b"\0\0" for c in corners]
        return b"solid".ljust(80) + np.uint32(12).tobytes() + b"".join(facets)
    lines = ["solid cube"]
    for c in corners:
        vertices = "".join(f"vertex {x} {y} {z}\n" for x, y, z in c)
        lines.append(f"facet normal 0 0 0\nouter loop\n{vertices}endloop\nendfacet")
    return "\n".join([*lines, "endsolid cube", ""]).encode()


OFF = "OFF # a cube\n8 6 0\n\n" + "".join(f"{x} {y} {z}\n" for x, y, z in CUBE.vertices)
OFF += "".join(f"4 {' '.join(map(str, s))} .5 .5 .5\n" for s in SQUARES)
VERTICES = [f"v {x} {y} {z}" for x, y, z in CUBE.vertices]
FACES = ["f " + " ".join(str(i + 1) for i in s) for s in SQUARES]
#: Each face after its own vertices, which it counts backwards.
RELATIVE = "\n".join("\n".join([*(VERTICES[i] for i in s), "f -4 -3 -2 -1"]) for s in SQUARES)

MIXED = [SQUARES[0][:3], (SQUARES[0][0], *SQUARES[0][2:]), *SQUARES[1:]]
APART = CUBE.vertices[np.array(SQUARES).ravel()]  # no two faces share a vertex
KINDS = {
    "ascii.ply": ply("ascii"),
    "little.ply": ply("binary_little_endian"),
    "big.ply": ply("binary_big_endian"),
    "mixed.ply": ply("binary_big_endian", MIXED),
    "mixed-text.ply": ply("ascii", MIXED),
    "inside-out.ply": ply("ascii", [s[::-1] for s in SQUARES]),
    "cube.obj": obj(),
    "apart.obj": obj(np.arange(24).reshape(6, 4).tolist(), APART),
    "backwards.obj": obj([[i - 9 for i in s] for s in SQUARES]),
    "a cube": obj(MIXED),
    "broken-lines.obj": obj().replace(b"f ", b"f \\\r\n"),
    "relative.obj": RELATIVE.encode(),
    "mark.obj": b"\xef\xbb\xbf" + "\n".join(VERTICES + FACES).encode(),
    "utf-16.obj": "\n".join(VERTICES + FACES).encode("utf-16"),
    "returns.obj": "\r".join(VERTICES + FACES).encode(),
    "tabs.obj": "\n".join([*VERTICES, *FACES]).replace(" ", "\t").encode(),
    "no-break-spaces.obj": "\n".join([*VERTICES, *FACES]).replace(" ", " \xa0").encode(),
    "weights.obj": "\n".join([*(f"{v} 1.0" for v in VERTICES), *FACES]).encode(),
    "colours.obj": "\n".join([*(f"{v} .5 0 1" for v in VERTICES), *FACES]).encode(),
    "mark.ply": b"\xef\xbb\xbf" + ply("ascii"),
    "utf-16.ply": ply("ascii").decode().encode("utf-16"),
    "returns.ply": ply("ascii").replace(b"\n", b"\r"),
    "last-return.ply": ply("binary_little_endian").replace(b"end_header", b"end_header\r"),
    "line-ends.ply": ply("ascii").replace(b"\n", b"\r\n \r\n").replace(b"\r\n \r\n", b"\r\n", 11),
    "binary.stl": stl(),
    "text.stl": stl(binary=False),
    "returns.stl": stl(binary=False).upper().replace(b"SOLID CUBE", b"solid x", 1).replace(b"\n", b"\r"),
    "plain.off": OFF.encode(),
    "folder.obj": "\n".join(["# C:\\models\\", *VERTICES, *FACES]).encode(),  # a comment ends with its line
    "zero.obj": b"# " + 60 * b"a" + b"\0\n" + obj(),
    "excess.stl": stl() + b"\0 written by a program",
    "spaces.stl": stl(binary=False).replace(b"endfacet", b"end facet").replace(b"endsolid", b"end solid"),
    "comment.off": f"# a cube\n\n# {' # ' * 40}\n{OFF}".encode(),
    "normals.off": re.sub(r"(\.0)\n", r"\1 0 0 1\n", OFF.replace("OFF # a cube\n", "NOFF\n")).encode(),
    "colours.off": re.sub(r"(\.0)\n", r"\1 1 0 0 1\n", OFF.replace("OFF # a cube\n", "COFF ")).encode(),
}


def meshes(path, text, **options):
    """The meshes of a translation."""
    path.write_text(text)
    prosim_scene.translate(path, **options)
    return [MeshFile(file.read_bytes()) for file in path.parent.glob("s-meshes/*.ply")]


def measured(path, text):
    """Volume and surface of the one mesh of a translation, which is closed."""
    (file,) = meshes(path, text)
    mesh = file.mesh(0, np.eye(4))
    p = mesh.vertices[mesh.triangles]
    cross = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    assert (np.einsum("tci,ti->tc", file.normals, cross) > 0).all()  # those in the file, as the triangles are wound
    return np.einsum("ti,ti->", p[:, 0], cross) / 6, np.linalg.norm(cross, axis=1).sum() / 2


@pytest.mark.parametrize(
    "name, tree",
    [
        *[(name, "- {} 0 CYLINDER 1") for name in KINDS],
        *[("mixed.ply", tree) for tree in ("{} 0", "- CYLINDER 1 {} 0", "+ {} 0 CUBE 2", "* {} 2 + {} 0 CUBE 2")],
    ],
)
def test_a_cube_from_a_file_is_as_large_as_the_languages_own(tmp_path, name, tree):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / name).write_bytes(KINDS[name])
    files = tree.replace("{} 0", f'MESH 0 "parts/{name}"').replace("{} 2", f'MESH 2 "parts/{name}"')
    for scale in (2, -2) if name == "mixed.ply" else (2,):
        steps = f"SCALE ({scale} 1 1) ROTATE-X (20)", "SCALE (.3 .3 5) TRANSLATE (.1 .5 -2)", "TRANSLATE (-.6 .4 .3)"
        found = measured(tmp_path / "s.scn", scene(files, steps, 3 * [""]))
        expected = measured(tmp_path / "s.scn", scene(tree.format("CUBE", "CUBE"), steps, 3 * [""]))
        assert found[0] > 0 and found == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("side", [1, -1], ids=["", "inside out"])
@pytest.mark.parametrize("kind", ["ply", "obj"])
def test_normals_and_texture_coordinates_of_the_file(kind, side):
    """They are interpolated; a normal that looks to the other side gives way to the face's own."""
    squares = [s[::side] for s in SQUARES]
    normals = CUBE.vertices - 0.5 + [0, 0, 0.1]
    normals[7] *= -1
    table = np.concatenate([CUBE.vertices, side * normals, CUBE.vertices[:, :2] * 3], axis=1)
    if kind == "ply":
        data = ply("ascii", squares, table, ["x", "y", "z", "nx", "ny", "nz", "u", "v"])
        data = data.replace(b"float", b"double").replace(b"vertex_indices", b"vertex_index")
    else:
        rows = [
            f"{word} " + " ".join(map(str, v[part]))
            for v in table.tolist()
            for word, part in (("v", slice(3)), ("vn", slice(3, 6)), ("vt", slice(6, 8)))
        ]
        data = "\n".join([*rows, *("f " + " ".join(f"{i + 1}/{i + 1}/{i + 1}" for i in s) for s in squares)]).encode()
    solid = MeshFile(data)
    mesh = solid.mesh(0, np.eye(4))
    p = mesh.vertices[mesh.triangles]
    weights = np.array([[0.2, 0.3, 0.5], [1, 0, 0], [0, 0.5, 0.5]])
    got = solid.corner_attributes(weights @ p, np.arange(12))
    assert np.allclose(got.uv, (weights @ p)[..., :2] * 3) and got.unshared.all()
    whole = (p != 1).any(axis=2).all(axis=1)  # without the corner whose normal is wrong
    assert np.allclose(got.normals[whole], (weights @ p - 0.5 + [0, 0, 0.1])[whole])
    flat = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    assert whole.sum() == 12 - np.sum((p == 1).all(axis=2)) and (np.einsum("tci,ti->tc", got.normals, flat) > 0).all()
    plain = MeshFile(obj()).corner_attributes(p, np.arange(12))
    assert (np.count_nonzero(plain.normals, axis=2) == 1).all() and np.array_equal(plain.uv, p[..., :2])


def test_corners_without_normals_or_texture_coordinates_have_those_of_the_triangle(tmp_path):
    """A face with another normal than its own is not wrong."""
    rows = [*VERTICES, "vt 5 6", "vn -9 1 2", FACES[0].replace("f 1 2 4 3", "f 1/1/1 2/1/1 4/1/1 3/1/1"), *FACES[1:]]
    solid = MeshFile("\n".join(rows).encode())
    p = solid.mesh(0, np.eye(4)).vertices[solid.mesh(0, np.eye(4)).triangles]
    got, own = solid.corner_attributes(p, np.arange(12)), (p[..., 0] == 0).all(axis=1)
    assert (got.uv[own] == [5, 6]).all() and np.array_equal(got.uv[~own], p[~own][..., :2])
    assert (np.count_nonzero(got.normals, axis=2) == np.where(own, 3, 1)[:, None]).all()
    (tmp_path / "m.obj").write_text("\n".join(rows))
    with warnings.catch_warnings():
        warnings.simplefilter("error", prosim_scene.SceneWarning)
        meshes(tmp_path / "s.scn", scene("MESH 0 m.obj", [""]))


@pytest.mark.parametrize("squares", [SQUARES, MIXED])
def test_each_face_of_a_ply_file_may_have_its_own_texture_coordinates(squares):
    uv = np.arange(60.0).reshape(-1, 2)
    lists, ends = ply("ascii", squares).decode().splitlines(), np.cumsum([0, *map(len, squares)])
    for i, (begin, end) in enumerate(pairwise(ends), len(lists) - len(squares)):
        lists[i] += f" {2 * (end - begin)} " + " ".join(map(str, uv[begin:end].ravel()))
    data = "\n".join(lists).replace("end_header", "property list uchar float texcoord\nend_header")
    solid = MeshFile(data.encode())
    mesh = solid.mesh(0, np.eye(4))
    corners = mesh.vertices[mesh.triangles]
    got = solid.corner_attributes(corners, np.arange(12)).uv
    expected = {(*uv[begin + k], *CUBE.vertices[s[k]]) for begin, s in zip(ends, squares) for k in range(len(s))}
    assert {*map(tuple, np.concatenate([got, corners], axis=2).reshape(-1, 5).tolist())} == expected
    with pytest.raises(ValueError, match="its texcoord lists do not have two numbers for each corner"):
        MeshFile(re.sub(r" 8 .*", " 0", data, count=1).encode())


#: Polygons of which a fan of triangles would overlap itself; the second one goes around its hole, and returns.
ARROW = [(0, 0), (2, 0), (3, 0), (1, 1), (0, 3)]
FRAME = [(0, 0), (3, 0), (3, 3), (0, 3), (0, 0), (1, 1), (1, 2), (2, 2), (2, 1), (1, 1)]


@pytest.mark.parametrize("outline, surface, walls", [(ARROW, 3, 6 + 2 * 5**0.5), (FRAME, 8, 16)])
def test_polygons_need_not_be_convex(outline, surface, walls):
    """From which corner, and in which format they are, and however the mesh is turned."""
    n, turn = len(outline), Rotation.from_rotvec([0.3, -2, 1])
    vertices = turn.apply([(*p, z) for z in (0, 1) for p in outline])
    edges = [*zip(outline, np.roll(outline, -1, axis=0).tolist(), range(n), [*range(1, n), 0])]
    sides = [(i, j, j + n, i + n) for a, b, i, j in edges if (tuple(b), list(a)) not in [e[:2] for e in edges]]
    for start in range(n):
        top = np.roll(np.arange(n), start)
        squares = [top[::-1], top + n, *map(list, sides)]
        off = ["OFF", f"{2 * n} {len(squares)} 0", *(" ".join(map(str, row)) for row in vertices)]
        off += [" ".join(map(str, (len(s), *s))) for s in squares]
        lists = ply("ascii", squares, vertices).decode().splitlines()
        for i, s in enumerate(squares, len(lists) - len(squares)):
            lists[i] += f" {2 * len(s)} " + " ".join(map(str, vertices[s][:, :2].ravel()))
        uv = "\n".join(lists).replace("end_header", "property list uchar double texcoord\nend_header")
        for data in (obj(squares, vertices), "\n".join(off).encode(), uv.encode()):
            solid = MeshFile(data)
            mesh = solid.mesh(0, np.eye(4))
            corners = mesh.vertices[mesh.triangles]
            cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            assert solid.warning == "" and np.linalg.norm(cross, axis=1).sum() / 2 == pytest.approx(2 * surface + walls)
            assert np.einsum("ti,ti->", corners[:, 0], cross) / 6 == pytest.approx(surface)
            proper = np.linalg.norm(cross, axis=1) > 1e-6
            got = solid.corner_attributes(corners[proper], np.flatnonzero(proper)).uv
            assert got == pytest.approx(corners[proper][..., :2], abs=1e-6)


def parts(*boxes):
    """An OBJ file of boxes, each with its minimum corner, its size, and whether it is inside out."""
    rows = [f"v {' '.join(map(str, v))}" for low, size, _ in boxes for v in CUBE.vertices * size + low]
    for n, (_, _, turned) in enumerate(boxes):
        rows += ["f " + " ".join(str(8 * n + i + 1) for i in (s[::-1] if turned else s)) for s in SQUARES]
    return "\n".join(rows).encode()


TURNED = [SQUARES[0][::-1], *SQUARES[1:]]
WRONG = {
    "none.ply": (None, "the mesh 'none.ply' does not exist in the scene's folder"),
    "open.ply": (ply("ascii", SQUARES[1:]), "not closed: 4 of its .* belong to one face alone"),
    "turned.obj": (obj(TURNED), "not closed: 4 of its .* different orientations"),
    "second.obj": (parts(((0, 0, 0), 4, False), ((3, 3, 3), 2, True)), r"is inside out in the part from \(3 3 3\)"),
    "flat.obj": (obj([SQUARES[0], SQUARES[0][::-1]]), "encloses nothing"),
    "empty.obj": (b"", "cannot be read: it has no faces; expected a closed mesh in PLY, OBJ, STL or OFF"),
    "picture.ply": (b"\x89PNG\r\n\x1a\n\0v\xff", "expected a closed mesh in PLY, OBJ, STL or OFF"),
    "half.stl": (stl()[:-9], "it is damaged, or in another format"),
    "no-name.stl": (stl()[5:].rjust(684)[:-99], "it is damaged, or in another format"),
    "solid.stl": (b"solid x\nfacet normal 0 0 1\n", "its facets are not complete"),
    "faces.off": (OFF.replace("8 6 0", "8 5 0").encode(), "does not agree with its header"),
    "negative.off": (OFF.replace("8 6 0", "-6 20 0").encode(), "does not agree with its header"),
    "row.off": (OFF.replace("4 0 1 3 2 .5 .5 .5", "4 0 1 3").encode(), "does not agree with its header"),
    "weight.obj": ("\n".join([*(f"{v} 2" for v in VERTICES), *FACES]).encode(), "the weight 2 after x y z; only 1"),
    "five.obj": ("\n".join([*(f"{v} 1 1" for v in VERTICES), *FACES]).encode(), "a vertex has 5 numbers"),
    "short.obj": (obj().replace(b"v 0.0 0.0 0.0", b"v 0 0"), "a vertex has 2 numbers"),
    "points.ply": (ply("ascii", []), "it has no faces"),
    "strips.ply": (ply("ascii", [(0, 1, 2, 3)]).replace(b"face", b"tristrips"), "triangle strips instead of faces"),
    **{
        f"{kind}-{words[1].decode().replace(' ', '')}.ply": (ply(kind).replace(*words), reason)
        for kind in ("ascii", "binary_little_endian", "binary_big_endian")
        for words, reason in (
            ((b"face 6", b"face -6"), "its header has a negative count, -6"),
            ((b"vertex 8", b"vertex -8"), "its header has a negative count, -8"),
            ((b"face 6", b"face 5"), "does not agree with its header"),
            ((b"face 6", b"face 7"), "does not agree with its header"),
            ((b"vertex 8", b"vertex 7"), "does not agree with its header"),
            ((b"vertex 8", b"vertex 9"), "cannot be read"),
        )
    },
    "long-row.ply": (ply("ascii").replace(b"0.0 0.0 1.0\n", b"0.0 0.0 1.0 4\n", 1), "does not agree with its header"),
    # the numbers of one row stand in the next one, so that their count is right
    "moved.ply": (ply("ascii").replace(b"0.0 0.0 0.0\n", b"0.0 0.0\n0.0 ", 1), "does not agree with its header"),
    "short-face.ply": (ply("ascii").replace(b"9 4 0 1", b"9 3 0 1", 1), "does not agree with its header"),
    "long-face.ply": (ply("ascii").replace(b"9 4 0 1", b"9 5 0 1", 1), "does not agree with its header"),
    "fraction.ply": (ply("ascii").replace(b"9 4 0 1", b"9 4.5 0 1", 1), "does not agree with its header"),
    "word-row.ply": (ply("ascii").replace(b"0.0 0.0 1.0\n", b"0.0 x 1.0\n", 1), "cannot be read"),
    "corner.obj": (obj([*SQUARES, (0, 1, 8)]), "a corner that does not exist"),
    "no-uv.obj": ("\n".join(VERTICES + FACES).replace("f 1", "f 1/1").encode(), "a corner that does not exist"),
    "zero.obj": (obj() + b"\nf 0 1 2", "a face has a corner 0"),
    "word.obj": (obj() + b"\nv a b c", "it is damaged, or in another format"),
    "nan.obj": (obj(vertices=CUBE.vertices * np.nan), "not finite"),
    "header.ply": (b"ply\nformat ascii 1.0\n", "header has no end"),
    "kind.ply": (b"ply\nformat fancy 1.0\nelement vertex 1\nproperty float x\nend_header\n", "cannot be read"),
    "huge.ply": (ply("binary_big_endian").replace(b"face 6", b"face 999999999999999999"), "cannot be read"),
    "no-vertices.ply": (ply("ascii").replace(b"vertex 8", b"point 8"), "it is damaged, or in another format"),
}


@pytest.mark.parametrize("name", WRONG)
def test_mesh_file_that_bounds_no_solid_is_refused_by_name(tmp_path, name):
    content, words = WRONG[name]
    if content is not None:
        (tmp_path / name).write_bytes(content)
    path = tmp_path / "s.scn"
    path.write_text(scene(f"MESH 0 {name}", [""]))
    with pytest.raises(SceneError, match=words) as error:
        prosim_scene.check(path)
    assert (error.value.line, error.value.column) == (3, 8)


@pytest.mark.slow
def test_bytes_that_are_lost_or_changed_raise_nothing_else():
    generator = np.random.default_rng(1)
    for data in KINDS.values():
        for _ in range(20):
            content = bytearray(data[: generator.integers(1, len(data))] if generator.random() < 0.3 else data)
            for at in generator.integers(0, len(content), generator.integers(0, 4)):
                content[at] = generator.integers(0, 256)
            with suppress(ValueError):
                MeshFile(bytes(content))


@pytest.mark.parametrize("offset", [0, 100])
@pytest.mark.parametrize("steps, squares, closed", [(1, SQUARES, True), (1, SQUARES[1:], False), (200, SQUARES, False)])
def test_corners_that_differ_by_a_rounding_of_single_precision_are_joined(offset, steps, squares, closed):
    """A hole stays a hole, and so does a gap."""
    generator = np.random.default_rng(1)
    for _ in range(20):
        corners = (CUBE.vertices[np.array(squares)].reshape(-1, 3) + offset + 0.1).astype("f4")
        corners += generator.integers(0, steps + 1, corners.shape) * np.spacing(corners).max()
        data = ply("binary_little_endian", np.arange(len(corners)).reshape(-1, 4).tolist(), corners)
        if closed:
            mesh = MeshFile(data).mesh(0, np.eye(4))
            assert np.linalg.det(mesh.vertices[mesh.triangles] - offset).sum() / 6 == pytest.approx(1, abs=1e-4)
        else:
            with pytest.raises(ValueError, match="belong to one face alone"):
                MeshFile(data)


@pytest.mark.parametrize(
    "boxes, volume, warning",
    [
        ([((0, 0, 0), 2, False), ((5, 0, 0), 2, False)], 16, ""),
        ([((0, 0, 0), 2, True), ((5, 0, 0), 2, True)], 16, ""),
        ([((0, 0, 0), 2, False), ((2, 0, 0), 2, False)], 16, ""),  # with a common face
        ([((0, 0, 0), 2, False), ((2, 0.5, 0.5), 2, False)], 16, ""),
        ([((0, 0, 0), 2, False), ((2, 2, 0), 2, False)], 16, ""),  # with a common edge
        ([((0, 0, 0), 2, False), ((2, 2, 2), 2, False)], 16, ""),
        ([((0, 0, 0), 2, False), ((1, 1, 1), 2, False)], 15, "overlap, such as the part from .0 0 0. to .2 2 2., near"),
        ([((0, 0, 0), 2, False), ((1.999, 1.9, 1.9), 2, False)], 16 - 1e-5, "parts that overlap.* become one solid"),
        ([((0, 0, 0), 2, False), ((0, 0, 0), 2, False)], 8, "parts that overlap"),
        ([((0, 0, 0), 2, False), ((0.5, 0.5, 0.5), 1, False)], 8, "overlap, such as the part from .0.5 0.5 0.5."),
        ([((0, 0, 0), 2, False), ((0.5, 0.5, 0.5), 1, True)], 7, ""),  # with a cavity
        ([((0, 0, 0), 4, False), ((1, 1, 1), 2, True), ((1.5, 1.5, 1.5), 1, False)], 57, ""),
        ([((0, 0, 0), 4, False), ((1, 1, 1), 1, True), ((3, 3, 3), 2, False)], None, "overlaps itself in the part"),
    ],
)
def test_overlapping_parts_become_one_solid_with_a_warning(boxes, volume, warning):
    """Its winding number is 1 everywhere, so the volume is that of the union."""
    file = MeshFile(parts(*boxes))
    mesh = file.mesh(0, np.eye(4))
    p = mesh.vertices[mesh.triangles]
    assert re.search(warning, file.warning) if warning else not file.warning
    assert volume is None or np.linalg.det(p).sum() / 6 == pytest.approx(volume, rel=1e-9)
    # Each triangle lies on its face of the file, whose normal it has.
    normals = file.corner_attributes(p, mesh.faces[mesh.facets]).normals
    own = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    own, normals = own / np.linalg.norm(own, axis=1)[:, None], normals / np.linalg.norm(normals, axis=2)[..., None]
    assert np.allclose(normals, own[:, None], atol=1e-6)


@pytest.mark.parametrize("x, warned", [(-0.9, False), (-1.2, True)])
def test_a_vertex_that_leaves_the_other_side_is_named(x, warned):
    """A ball has a dent that is deeper than the ball; few of its faces are in a wrong place, and only by their ends."""
    mesh = Manifold.sphere(1, 64).to_mesh64()
    vertices = np.array(mesh.vert_properties)
    vertices[vertices[:, 0].argmax()] = [x, 0, 0]
    assert ("overlaps itself" in MeshFile(obj(mesh.tri_verts.tolist(), vertices)).warning) == warned


@pytest.mark.parametrize("seed", range(4))
def test_a_flap_of_faces_back_to_back_is_left_out_however_the_mesh_is_turned(seed):
    """Its volume is a rounding error, whose sign depends on the turn."""
    vertices = Rotation.random(random_state=seed).apply([*CUBE.vertices, [0.3, -0.5, 0], [0.7, -0.5, 0]])
    solid = MeshFile(obj([*SQUARES, (9, 0, 8), (2, 9, 8), (2, 0, 9), (0, 2, 8)], vertices))
    assert "parts without a volume" in solid.warning and len(solid.mesh(0, np.eye(4)).triangles) == 12


def test_a_warning_names_the_mesh_that_overlaps_itself(tmp_path):
    (tmp_path / "m.obj").write_bytes(parts(((0, 0, 0), 2, False), ((1, 1, 1), 2, False)))
    (tmp_path / "s.scn").write_text(scene("MESH 0 m.obj", [""]))
    with pytest.warns(prosim_scene.SceneWarning, match=r"s.scn:3:8: the mesh 'm.obj' has parts that overlap"):
        prosim_scene.check(tmp_path / "s.scn")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["<f4", "<f8"])
def test_solids_without_overlaps_have_no_warning(kind):
    """Random unions and differences, whose slivers and creases are as in files by others."""
    generator, tested = np.random.default_rng(5), 0
    for _ in range(10):
        solid = Manifold()
        for _ in range(generator.integers(2, 6)):
            own = [Manifold.cube((2, 2, 2)), Manifold.sphere(1.3, int(generator.integers(8, 60)))]
            own = own[generator.integers(2)].rotate(generator.uniform(0, 360, 3))
            own = own.translate(generator.uniform(-1.5, 1.5, 3))
            solid = solid - own if solid.volume() and generator.random() < 0.5 else solid + own
        mesh = solid.to_mesh64()
        vertices = mesh.vert_properties.astype(kind)
        if solid.volume() > 0.1:
            tested += 1
            assert not MeshFile(obj(mesh.tri_verts.tolist(), vertices)).warning
    assert tested > 6


@pytest.mark.parametrize(
    "text, words",
    [
        ("MESH cube.obj END", "found 0 numbers after MESH; expected 1 number"),
        ("MESH 0", "the file ends after this; expected a file name or a quoted string"),
        ("MESH 0 t-tijolo END", "found 't-tijolo'; expected a file name"),
        ('MESH 0 "" END', "the mesh '' is not a valid file name; expected the name of a file"),
        ("MESH 0 ../cube.obj END", "outside the scene's folder; .*--allow-outside"),
    ],
)
def test_a_mesh_needs_its_file(write_scene, text, words):
    with pytest.raises(SceneError, match=words):
        prosim_scene.check(write_scene(f"SURFACE 0 TRANSFORM 0 CSG-TREE {text}"))


def test_a_file_outside_if_that_is_allowed_and_in_a_named_solid(tmp_path):
    (tmp_path / "cube.obj").write_bytes(obj())
    (tmp_path / "scene").mkdir()
    path = tmp_path / "scene" / "s.scn"
    text = scene("+ part 0 part 1", ["", "TRANSLATE (3 0 0)", "SCALE (2 1 1)"], 3 * [""])
    text = text.replace("CSG-TREE", "SOLID part MESH 2 ../cube.obj CSG-TREE")
    (mesh,) = meshes(path, text, allow_outside=True)
    assert len(mesh.mesh(0, np.eye(4)).triangles) == 24
    assert prosim_scene.meshes(prosim_scene.document(path)).keys() == {"../cube.obj"}


def test_a_mesh_that_has_changed_is_read_again(tmp_path):
    cache, path = prosim_scene.TranslationCache(), tmp_path / "s.scn"
    path.write_text(scene("MESH 0 $file", [""]).replace("VIEW", "DEFAULT $file = a.obj VIEW", 1))
    for content, define, made in (
        (obj(), {}, 1),
        (obj(), {}, 1),
        (obj(vertices=2 * CUBE.vertices), {}, 2),
        (obj(vertices=2 * CUBE.vertices), {"file": "b.obj"}, 2),  # another file with the same content
    ):
        for name in ("a.obj", "b.obj"):
            (tmp_path / name).write_bytes(content)
        prosim_scene.translate(path, cache=cache, define=define)
        assert cache.evaluations == made
