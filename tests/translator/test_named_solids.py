"""Named solids, and light from an image."""

import prosim_scene
import pytest
from prosim_scene import SceneError
from prosim_scene.language import reader
from prosim_scene.symbols import Symbols

pytestmark = pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")

REST = """
LIGHTS POINT position 9 9 9
VIEW OBS 0 3 20 RESOLUTION 40 40
SURFACE 2 material condutor ouro
SURFACE 20 kd = .7 .3 .2
TRANSFORM 1 SCALE (.2 .2 2)
TRANSFORM 2 SCALE (.3 .3 .3)
TRANSFORM 3 SCALE (4 .2 4)
TRANSFORM 10
TRANSFORM 11 TRANSLATE (4 0 0)
TRANSFORM 20 ROTATE-Y (20) TRANSLATE (-6 0 0)
"""
NAMED = "SOLID leg + CYLINDER 1 SPHERE 2\nSÓLIDO table - + leg 10 LEG 11 CUBE 3\nCSG-TREE table 20" + REST + "END"
WRITTEN_OUT = (
    "CSG-TREE - + + CYLINDER 21 SPHERE 22 + CYLINDER 23 SPHERE 24 CUBE 25"
    + REST
    + "".join(f"SURFACE {i} kd = .7 .3 .2\n" for i in (21, 23, 25))
    + "".join(f"SURFACE {i} material condutor ouro\n" for i in (22, 24))
    + """TRANSFORM 21 SCALE (.2 .2 2) ROTATE-Y (20) TRANSLATE (-6 0 0)
TRANSFORM 22 SCALE (.3 .3 .3) ROTATE-Y (20) TRANSLATE (-6 0 0)
TRANSFORM 23 SCALE (.2 .2 2) TRANSLATE (4 0 0) ROTATE-Y (20) TRANSLATE (-6 0 0)
TRANSFORM 24 SCALE (.3 .3 .3) TRANSLATE (4 0 0) ROTATE-Y (20) TRANSLATE (-6 0 0)
TRANSFORM 25 SCALE (4 .2 4) ROTATE-Y (20) TRANSLATE (-6 0 0)
END"""
)


def test_a_use_of_a_named_solid_is_its_tree_written_out(write_scene):
    meshes = []
    for text in NAMED, WRITTEN_OUT:
        path = prosim_scene.translate(write_scene(text))
        meshes.append({file.name: file.read_bytes() for file in path.parent.rglob("*.ply")})
    assert meshes[0] == meshes[1] and len(meshes[0]) == 2
    scene = prosim_scene.parse(NAMED)
    assert [node.index for node in scene.csg if isinstance(node, prosim_scene.Leaf)] == [21, 22, 23, 24, 25]
    assert prosim_scene.parse(prosim_scene.format(NAMED)) == scene


def test_solids_of_solids_do_not_grow_without_a_limit(monkeypatch):
    monkeypatch.setattr(reader, "MAX_NODES", 1000)
    text = "SOLID s0 + CUBE 1 CUBE 1\n" + "".join(f"SOLID s{i} + s{i - 1} 1 s{i - 1} 1\n" for i in range(1, 60))
    with pytest.raises(SceneError, match="more than 1000 nodes"):
        prosim_scene.parse(text + "SURFACE 1 TRANSFORM 1 CSG-TREE s59 1 END")


def test_an_editor_knows_named_solids():
    symbols = Symbols(NAMED)
    at = NAMED.index("LEG 11")
    symbol = symbols.occurrence_at(at).symbol
    assert len(symbols.occurrences(symbol)) == 3
    assert "SOLID leg + CYLINDER 1 SPHERE 2" in symbols.hover(at)[2]
    assert {"leg", "CUBE"} <= {one.label for one in symbols.completions(at)}
    assert {"20", "1"} <= {one.label for one in symbols.completions(at + len("LEG "))}


def test_an_image_lights_the_scene(tmp_path, write_scene):
    (tmp_path / "ceu.exr").write_bytes(b"\x76\x2f\x31\x01")
    document = prosim_scene.document(write_scene("LUZES CEU ceu.exr CSG-TREE CUBE 0 SURFACE 0 TRANSFORM 0 END"))
    assert list(prosim_scene.images(document)) == [("ceu.exr", ("lights", 0, "image"))]
    for target in "prosim", "stock":
        sky = prosim_scene.load(document, target=target, transform=lambda matrix: matrix)["light_0"]
        assert sky == {"type": "envmap", "filename": str(tmp_path / "ceu.exr")}
    for wrong, words in ("SKY position 0 0 9", "found 'position'"), ("SKY none.exr", "does not exist"):
        with pytest.raises(SceneError, match=words):
            prosim_scene.check(write_scene(f"LIGHTS {wrong} CSG-TREE CUBE 0 SURFACE 0 TRANSFORM 0 END"))
