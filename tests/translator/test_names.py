"""Names and arithmetic: what they come to, what is wrong with them, that they are kept as written; named solids."""

import math
import random

import numpy as np
import prosim_scene
import pytest
from prosim_scene import SceneError, SceneWarning
from prosim_scene.language import reader
from test_errors import MINIMAL

pytestmark = pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")

SCENE = """DEFAULT $turn = 30
PADRAO: $far {2 * $turn}
DEFAULT $metal = cobre
VIEW OBS {$far * sin($turn)} $turn {-$far}
SURFACE 0 material condutor $metal
TRANSFORM 0 ROTATE-Y ({$turn / 4}) SCALE ($turn 1 1)
END
"""


def value(expression, define=None):
    return prosim_scene.parse(f"VIEW OBS {{{expression}}} 0 0 END", define=define).view.eye[0]


@pytest.mark.parametrize(
    "expression, expected",
    [
        ("(1 + 2)*3", 9),
        ("2^3^2", 512),
        ("-2^2", -4),
        ("sin(90) + cos(180) + sin(-90)", -1),
        ("sin(30) + cos(60) + tan(45)", 2),
        ("atan2(1, 0) + sqrt(16) + abs(-1)", 95),
        ("floor(-1.5) + round(2.5) + mod(-1, 24)", 24),
        ("360 * $frame / 48", 0),
    ],
)
def test_arithmetic(expression, expected):
    assert value(expression) == pytest.approx(expected, rel=1e-15, abs=1e-15)
    assert value("cos(90)") == value("sin(180)") == value("sin(-360)") == 0 and value("cos(-540)") == -1


def test_no_bit_of_a_value_is_lost():
    rng = random.Random(1)
    for x in [0.0, -0.0, 0.1, 1e15, *(rng.choice([-1, 1]) * 10 ** rng.uniform(-300, 15) for _ in range(40))]:
        assert value("$x", {"x": x}) == value("$x", {"x": repr(x)}) == x


def test_names_have_the_values_of_the_caller_or_of_their_defaults(tmp_path, write_scene):
    scene = prosim_scene.parse(SCENE)
    assert scene.view.eye == pytest.approx((30, 30, -60)) and scene.surfaces[0].metal == "Cu_palik"
    assert [step.values for step in scene.transforms[0].steps] == [(7.5,), (30, 1, 1)]
    path = write_scene(SCENE)
    for define in {"turn": 90, "metal": "ouro"}, {"turn": "90", "metal": "ouro"}:
        opened = prosim_scene.document(path, define)
        assert opened.scene.view.eye == pytest.approx((180, 90, -180)) and opened.scene.surfaces[0].metal == "Au"
        assert prosim_scene.check(path, define=define) == opened.scene == prosim_scene.check(opened)
        node = prosim_scene.load(path, define=define)
        to_world = node["view"]["to_world"]  # Mitsuba's type, if another test of this process has imported Mitsuba
        assert np.array(getattr(to_world, "matrix", to_world))[:3, 3] == pytest.approx((180, 90, -180))
        assert "180" in prosim_scene.translate(path, tmp_path / "out", define=define).read_text()
    with pytest.raises(SceneError, match=r"pass it to prosim_scene\.document"):
        prosim_scene.check(opened, define=define)


def test_names_may_have_letters_of_any_language():
    text = f"DEFAULT $não = 2\nDEFAULT $círculo_2 = {{$não + 1}}\nNSAMPLES {{2*$círculo_2}} MAX-LEVEL $não\n{MINIMAL}"
    for define, expected in (None, (6, 2)), ({"não": 4}, (10, 4)):
        for written in text, prosim_scene.format(text):
            scene = prosim_scene.parse(written, define=define)
            assert (scene.samples, scene.max_level) == expected
    with pytest.raises(SceneError, match=r"s.scn:3:13: .*; \$círculo_2 stands for 'x', by -D"):
        prosim_scene.parse(text, "s.scn", {"círculo_2": "x"})


def test_frame_and_time_have_values_of_their_own():
    text = "VIEW OBS $frame $time 1 END"
    assert prosim_scene.parse(text).view.eye == (0, 0, 1)
    assert prosim_scene.parse(text, define={"frame": 12}).view.eye == (12, 0.5, 1)
    assert prosim_scene.parse(text, define={"frame": 12, "time": 3}).view.eye == (12, 3, 1)
    assert prosim_scene.parse(f"DEFAULT $frame 6 {text}").view.eye == (6, 0.25, 1)


def test_names_stand_for_words_of_all_kinds():
    text = "DO-SHADOW $b NAME $w BACKGROUND 0 0 0 $f CSG-TREE CUBE 0 $t SURFACE 0 material $m TRANSFORM 0 END"
    define = {"b": False, "w": "cone", "f": "a b.png", "t": "T-Listra", "m": "lambertiano"}
    scene = prosim_scene.parse(text, define=define)
    assert (scene.shadows, scene.name, scene.background.image) == (False, "cone", "a b.png")
    assert scene.csg[0].textures[0].name == "t-stripes" and scene.surfaces[0].material == "lambertian"
    glass = prosim_scene.parse("SURFACE 0 material $m n-refr 1.5 END", define={"m": "dieletrico"})
    assert glass.surfaces[0].material == "dielectric"


# the first line of the minimal scene, what the caller defines, column of the error, words of the message
@pytest.mark.parametrize(
    "line, define, column, words",
    [
        ("NSAMPLES {$n + 1}", {}, 11, "$n has no value; expected DEFAULT $n = 1 above its use, -D n=1"),
        ("DEFAULT $n = ouro NSAMPLES {$n + 1}", {}, 29, "expected a finite number in arithmetic; $n stands for 'ouro'"),
        ("DEFAULT $n = CUBE LIGHTS $n", {}, 26, "a word that is a value; $n stands for 'CUBE'"),
        ("DEFAULT $n = 2000 NSAMPLES $n", {}, 28, "; $n stands for '2000'\n"),
        ("NSAMPLES {7 / (2 - 2)}", {}, 11, "divides by 0"),
        ("NSAMPLES {10^400}", {}, 11, "'10^400' is not a finite number"),
        ("NSAMPLES {(1}", {}, 13, "expected an operator (+ - * / ^) or ')'"),
        ("NSAMPLES {2 * angle}", {}, 15, "unknown word 'angle' in an expression; expected a name such as $angle"),
        ("NSAMPLES {sinn(3)}", {}, 11, "did you mean 'sin'"),
        ("NSAMPLES {sin(1, 2)}", {}, 11, "found 2 numbers in sin(); expected 1"),
        ("NSAMPLES {1\n}", {}, 10, "this '{' is not closed on its line"),
        ("NSAMPLES $n-1", {}, 10, "expected letters, digits and _ after $"),
        ("AMBIENT 1 1 {1 / ($n - 2)}", {"n": 2}, 14, "divides by 0; $n stands for '2', by -D n=2"),
        ("SURFACE $n", {"n": "x"}, 9, "; $n stands for 'x', by -D n=x"),
    ],
)
def test_each_error_names_its_place_and_the_name(line, define, column, words):
    with pytest.raises(SceneError) as caught:
        prosim_scene.parse(f"{line}\n{MINIMAL}", "s.scn", define)
    assert str(caught.value).startswith(f"s.scn:1:{column}: ") and words in str(caught.value)


@pytest.mark.parametrize(
    "define, words",
    [
        ({"turm": 3}, "does not use .turm, .*did you mean '.turn'"),
        ({"frame": 3}, "does not use .frame, which -D frame=3"),
        ({"turn": math.nan}, "turn = nan is not a value"),
        ({"a-b": 1}, "'a-b' cannot be a name"),
    ],
)
def test_a_wrong_value_from_the_caller(define, words):
    with pytest.raises(SceneError, match=f"^s.scn: .*{words}"):
        prosim_scene.parse(SCENE, "s.scn", define)


def test_deep_arithmetic_exhausts_nothing():
    assert value("(" * 1500 + "1" + ")" * 1500) == 1
    assert value("-" * 1500 + "1") == 1
    assert value("1" + "+1" * 1500) == 1501


def test_the_formatter_keeps_what_is_written_and_needs_no_values():
    tidy = prosim_scene.format(SCENE)
    assert tidy.startswith("DEFAULT $turn = 30\nPADRAO $far = {2 * $turn}\nDEFAULT $metal = cobre\n\nVIEW\n")
    assert "    ROTATE-Y ({$turn / 4})\n    SCALE ($turn 1 1)\n" in tidy
    assert prosim_scene.format(tidy) == tidy and prosim_scene.parse(tidy) == prosim_scene.parse(SCENE)
    tidy = prosim_scene.format("VIEW OBS $x {1/$y} 2.0 SURFACE 0 material $kind CSG-TREE CUBE 0 $t END")
    assert "    OBS $x {1/$y} 2.0\n" in tidy and "    material $kind\n" in tidy and "    CUBE 0 $t\n" in tidy
    assert prosim_scene.format(tidy) == tidy
    with pytest.raises(SceneError, match="expected a number"):
        prosim_scene.format("VIEW OBS $x {1/} 2 END")


# ---- Named solids, and light from an image


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
UP = "ROTATE-Y (20) TRANSLATE (-6 0 0)"
WRITTEN_OUT = f"""CSG-TREE - + + CYLINDER 21 SPHERE 22 + CYLINDER 23 SPHERE 24 CUBE 25 {REST}
SURFACE 21 kd = .7 .3 .2 SURFACE 23 kd = .7 .3 .2 SURFACE 25 kd = .7 .3 .2
SURFACE 22 material condutor ouro SURFACE 24 material condutor ouro
TRANSFORM 21 SCALE (.2 .2 2) {UP} TRANSFORM 22 SCALE (.3 .3 .3) {UP}
TRANSFORM 23 SCALE (.2 .2 2) TRANSLATE (4 0 0) {UP} TRANSFORM 24 SCALE (.3 .3 .3) TRANSLATE (4 0 0) {UP}
TRANSFORM 25 SCALE (4 .2 4) {UP} END"""


def test_a_use_of_a_named_solid_is_its_tree_written_out(write_scene):
    meshes = []
    for text in NAMED, WRITTEN_OUT:
        path = prosim_scene.translate(write_scene(text))
        meshes.append({file.name: file.read_bytes() for file in path.parent.rglob("*.ply")})
    assert meshes[0] == meshes[1] and len(meshes[0]) == 2
    scene = prosim_scene.parse(NAMED)
    assert [node.index for node in scene.csg if isinstance(node, prosim_scene.Leaf)] == [21, 22, 23, 24, 25]
    assert prosim_scene.parse(prosim_scene.format(NAMED)) == scene


@pytest.mark.parametrize("index", ["$i", "{0 + 1}", "01", "(a 7) 1", "\n= 1"])
def test_primitives_are_named_by_their_index_and_uses_without_comments(write_scene, index):
    tree = f"SOLID leg SPHERE 2 CSG-TREE + CUBE {index} - leg (a {{) $i CUBE {index}"
    tables = "SURFACE 1 SURFACE 2 TRANSFORM 1 TRANSFORM 2 SCALE (.1 .1 .1) TRANSLATE (.5 .5 .5) END"
    path = write_scene(f"DEFAULT $i = 1 LIGHTS POINT position 9 9 9 {tree} {tables}")
    expected = (
        r"nothing is visible of a SPHERE in leg \$i \(line .\), CUBE 1 \(line .\): .*; operators come before "
        r"their operands: - \(line .\) has the operands leg \$i \(line .\) and CUBE 1 \(line .\)\n"
    )
    with pytest.warns(SceneWarning, match=expected):
        assert " SURFACE 1 of CUBE 1, leg $i (line " in prosim_scene.translate(path).read_text(encoding="utf-8")


def test_solids_of_solids_do_not_grow_without_a_limit(monkeypatch):
    monkeypatch.setattr(reader, "MAX_PRIMITIVES", 1000)
    text = "SOLID s0 + CUBE 1 CUBE 1\n" + "".join(f"SOLID s{i} + s{i - 1} 1 s{i - 1} 1\n" for i in range(1, 60))
    with pytest.raises(SceneError, match="more than 1000 primitives"):
        prosim_scene.parse(text + "SURFACE 1 TRANSFORM 1 CSG-TREE s59 1 END")


def test_an_image_lights_the_scene(tmp_path, write_scene):
    (tmp_path / "ceu.exr").write_bytes(b"\x76\x2f\x31\x01")
    document = prosim_scene.document(write_scene("LUZES CEU ceu.exr CSG-TREE CUBE 0 SURFACE 0 TRANSFORM 0 END"))
    assert list(prosim_scene.images(document)) == [("ceu.exr", ("lights", 0, "image"))]
    for target in "prosim", "stock":
        sky = prosim_scene.load(document, target=target)["light_0"]
        assert sky == {"type": "envmap", "filename": str(tmp_path / "ceu.exr")}
    for wrong, words in ("SKY position 0 0 9", "found 'position'"), ("SKY none.exr", "does not exist"):
        with pytest.raises(SceneError, match=words):
            prosim_scene.check(write_scene(f"LIGHTS {wrong} CSG-TREE CUBE 0 SURFACE 0 TRANSFORM 0 END"))


@pytest.mark.parametrize(
    "solid, words",
    [
        ("a + a 1 SPHERE 0", "unknown word 'a'; expected .*; a solid cannot contain itself"),
        ("a SPHERE 0 radius 2", "radius has no effect on SPHERE"),
        ("a + SPHERE 0", "this '.' lacks an operand"),
        ("a", "this solid is empty"),
        ("á CUBO 0 NULL NULL NULL", "this is a third texture"),
    ],
)
@pytest.mark.parametrize("tree", ["a 1", "- a 1 SPHERE 0", "+ SPHERE 0 + A 1 a 2"])
def test_the_use_of_a_wrong_solid_is_not_another_error(solid, words, tree):
    surfaces = "SURFACE 0 kd .5 TRANSFORM 0 TRANSFORM 1 TRANSFORM 2"
    with pytest.raises(SceneError, match=words) as caught:
        prosim_scene.parse(f"SOLID {solid}\nSOLID b + a 2 CUBE 0\nCSG-TREE + b 1 {tree}\n{surfaces}\nEND")
    assert caught.value.line == 1 and not caught.value.others


def test_an_index_of_a_solid_that_is_not_used_is_not_called_unknown():
    text = "SOLID a CUBE 5 CSG-TREE SPHERE 0 SURFACE 0 kd .5 TRANSFORM 0 SURFACE 5 kd .5 TRANSFORM 5 TRANSFORM 1 END"
    with pytest.warns(SceneWarning, match="no primitive that CSG-TREE uses has the index 5; delete this, or"):
        prosim_scene.parse(text)
    with pytest.warns(SceneWarning, match="no primitive has the index 1; delete this"):
        prosim_scene.parse(text.replace("SOLID a CUBE 5 ", "").replace("SPHERE 0", "+ SPHERE 0 CUBE 5"))
