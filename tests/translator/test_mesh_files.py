"""MESH: solids in PLY and OBJ files."""

from contextlib import suppress

import numpy as np
import prosim_scene
import pytest
from meshes import scene
from prosim_scene import SceneError
from prosim_scene.geometry.mesh_files import MeshFile
from prosim_scene.geometry.primitives import PRIMITIVES

pytestmark = pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")

CUBE = PRIMITIVES["cube"].mesh(4, np.eye(4))
#: Corners of the cube's faces, outwards.
SQUARES = [(0, 1, 3, 2), (0, 4, 5, 1), (0, 2, 6, 4), (4, 6, 7, 5), (2, 3, 7, 6), (1, 5, 7, 3)]


def ply(kind, squares=SQUARES, vertices=CUBE.vertices):
    header = f"ply\nformat {kind} 1.0\ncomment a cube\nelement vertex {len(vertices)}\n"
    header += "".join(f"property float {axis}\n" for axis in "xyz") + "element edge 0\nproperty int vertex1\n"
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
    for scale in 2, -2:
        steps = f"SCALE ({scale} 1 1) ROTATE-X (20)", "SCALE (.3 .3 5) TRANSLATE (.1 .5 -2)", "TRANSLATE (-.6 .4 .3)"
        found = measured(tmp_path / "s.scn", scene(files, steps, 3 * [""]))
        expected = measured(tmp_path / "s.scn", scene(tree.format("CUBE", "CUBE"), steps, 3 * [""]))
        assert found[0] > 0 and found == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("kind", ["ply", "obj"])
def test_normals_and_texture_coordinates_of_the_file(kind):
    """They are interpolated; a normal that looks to the other side gives way to the face's own."""
    names = ["x", "y", "z", "nx", "ny", "nz", "u", "v"]
    normals = CUBE.vertices - 0.5 + [0, 0, 0.1]
    normals[7] *= -1
    table = np.concatenate([CUBE.vertices, normals, CUBE.vertices[:, :2] * 3], axis=1)
    if kind == "ply":
        header = "ply\nformat ascii 1.0\nelement vertex 8\n" + "".join(f"property double {name}\n" for name in names)
        header += "element face 6\nproperty list uchar int vertex_index\nend_header\n"
        rows = [" ".join(map(str, v)) for v in table.tolist()] + ["4 " + " ".join(map(str, s)) for s in SQUARES]
        data = (header + "\n".join(rows)).encode()
    else:
        rows = [
            f"{word} " + " ".join(map(str, v[part]))
            for v in table.tolist()
            for word, part in (("v", slice(3)), ("vn", slice(3, 6)), ("vt", slice(6, 8)))
        ]
        data = "\n".join([*rows, *("f " + " ".join(f"{i + 1}/{i + 1}/{i + 1}" for i in s) for s in SQUARES)]).encode()
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


TURNED = [SQUARES[0][::-1], *SQUARES[1:]]
WRONG = {
    "none.ply": (None, "the mesh 'none.ply' does not exist in the scene's folder"),
    "open.ply": (ply("ascii", SQUARES[1:]), "not closed: 4 of its .* belong to one face alone"),
    "turned.obj": (obj(TURNED), "not closed: 4 of its .* different orientations"),
    "flat.obj": (obj([SQUARES[0], SQUARES[0][::-1]]), "encloses nothing"),
    "empty.obj": (b"", "cannot be read: it has no faces; expected a whole file, PLY or OBJ"),
    "picture.ply": (b"\x89PNG\r\n\x1a\n\0v\xff", "expected a whole file, PLY or OBJ"),
    "solid.stl": (b"solid x\nfacet normal 0 0 1\n", "it has no faces"),
    "corner.obj": (obj([*SQUARES, (0, 1, 8)]), "a corner that does not exist"),
    "zero.obj": (obj() + b"\nf 0 1 2", "a face has a corner 0"),
    "word.obj": (obj() + b"\nv a b c", "could not convert"),
    "two.obj": (b"v 0 0\nv 1 0\nv 0 1\nf 1 2 3", "too few numbers"),
    "nan.obj": (obj(vertices=CUBE.vertices * np.nan), "not finite"),
    "header.ply": (b"ply\nformat ascii 1.0\n", "header has no end"),
    "half.ply": (ply("binary_little_endian")[:-9], "cannot be read"),
    "kind.ply": (b"ply\nformat fancy 1.0\nelement vertex 1\nproperty float x\nend_header\n", "cannot be read"),
    "huge.ply": (ply("binary_big_endian").replace(b"face 6", b"face 999999999999999999"), "cannot be read"),
    "no-vertices.ply": (ply("ascii").replace(b"vertex 8", b"point 8"), "its header is not a mesh header"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_no_solid_is_an_error_at_the_files_name(tmp_path, name):
    content, words = WRONG[name]
    if content is not None:
        (tmp_path / name).write_bytes(content)
    path = tmp_path / "s.scn"
    path.write_text(scene(f"MESH 0 {name}", [""]))
    with pytest.raises(SceneError, match=words) as error:
        prosim_scene.check(path)
    assert (error.value.line, error.value.column) == (3, 8)


def test_bytes_that_are_lost_or_changed_raise_nothing_else():
    generator = np.random.default_rng(1)
    for data in KINDS.values():
        for _ in range(50):
            content = bytearray(data[: generator.integers(1, len(data))] if generator.random() < 0.3 else data)
            for at in generator.integers(0, len(content), generator.integers(0, 4)):
                content[at] = generator.integers(0, 256)
            with suppress(ValueError):
                MeshFile(bytes(content))


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
