"""Wrong input: each message names the place, what was found and what was expected; nothing is written."""

import math
import os
import sys

import mitsuba as mi
import numpy as np
import prosim_scene
import pytest
from prosim_scene import SceneError, SceneWarning
from prosim_scene.language.analysis import SIZE_LIMIT
from prosim_scene.language.words import WORDS

pytestmark = pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning", "error::RuntimeWarning")

MINIMAL = """NAME: x
LIGHTS POINT position 0 5 5 Intensity 60000 60000 60000
VIEW OBS 0 0 9 VRP 0 0 0
CSG-TREE CUBE 0
SURFACE 0 material lambertiano kd = 0.5 0.5 0.5
TRANSFORM 0 SCALE (1 1 1)
END
"""


def with_line(number, line):
    lines = MINIMAL.splitlines()
    lines[number - 1] = line
    return "\n".join(lines) + "\n"


ABOVE = "POINT position 0 20 0"
LAMPS = {  # further lights -> whether the AREA light shades the cube, which is around the origin, from another light
    f"{ABOVE} AREA position 0 10 0 radius 2": True,
    f"{ABOVE} AREA position 30 10 0 radius 2": False,
    f"{ABOVE} AREA position 0 -10 0 radius 2": False,
    f"{ABOVE} AREA position 0 10 0 radius .5": False,
    f"{ABOVE} AREA position 2.8 10 0 radius 3": True,
    f"{ABOVE} direction 0 -1 0 CONE angle 20 AREA position 0 10 0 radius 2": True,
    f"{ABOVE} direction 0 1 0 SPOT exponent 2 AREA position 0 10 0 radius 2": False,
    "AREA position 0 10 0 radius 1 AREA position 0 10 0 radius 2": True,
    "POINT position 0 5 0 AREA position 0 9 0 radius 2": False,
    "AREA position 0 10 0 radius 2": False,
}


@pytest.mark.parametrize("lights", LAMPS)
@pytest.mark.parametrize("shadows", ["TRUE", "FALSE"])
def test_area_light_that_shades_surfaces_causes_warning(write_scene, recwarn, lights, shadows):
    path = write_scene(with_line(2, f"DO-SHADOW {shadows}\nLIGHTS {lights}"))
    prosim_scene.translate(path)
    messages = [str(warning.message) for warning in recwarn if "shades surfaces from" in str(warning.message)]
    assert len(messages) == (LAMPS[lights] and shadows == "TRUE")
    assert all(":3:" in text and "in line 3" in text for text in messages)


# line of the text, its replacement, column of the error, its code, and what is suggested
WRONG = [
    # given twice
    (5, "SURFACE 0 kd = 1 1 1 SURFACE 0 kd = 1 1 1", 22, "twice", ""),
    (5, "SURFACE 0 ks = .1 .1 .1 n = 5 m = .3", 31, "twice", ""),
    # an index without a SURFACE or TRANSFORM
    (4, "CSG-TREE CUBE 1", 10, "no-index", ""),
    # unknown words
    (4, "CSG-TREE CUBO 0 SFERE 1", 17, "unknown-word", "'SPHERE'"),
    (1, "METHOD adaptive fast", 17, "unknown-word", "expected neighbours, graded, thesis, variance or none"),
    (4, "CSG-TREE CUBE 0 t-tijollo", 17, "unknown-name", "'t-tijolo'"),
    # a wrong count of values
    (6, "TRANSFORM 0 ROTATE-X ()", 13, "count", "1 number (degrees)"),
    (6, "TRANSFORM 0 MATRIX (1 0 0)", 21, "count", "12 numbers (a matrix of 3 rows and 4 columns), or 16"),
    (6, "TRANSFORM 0 MATRIX 1 0 0 0 0 1 0 0 0 0 1 0 2 3 4 1", 13, "range", "2 3 4 1; expected 0 0 0 1, and the trans"),
    (6, "TRANSFORM 0 MATRIX (1 0 0 0 0 1 0 0 1 1 0 0)", 1, "transforms", "this transform is singular"),
    (1, "CAUSTICS", 1, "count", "TRUE or FALSE"),
    (1, "SAVE-RGB TRUE TRUE: TRUE", 19, "count", ""),
    (4, "CSG-TREE CUBE 0 NULL NULL NULL", 27, "count", ""),
    # numbers that are none, or not allowed
    (3, "VIEW OBS 0 nan 9", 12, "unknown-word", ""),
    (3, "VIEW OBS 0 1e999 9", 12, "range", "1e+15 at most"),
    (1, "NSAMPLES: 5O", 11, "not-a-number", ""),
    (3, "VIEW RESOLUTION 65536 65536", 6, "range", "268435456 at most"),
    (1, "SAVE-RGB: FALSE FALSE FALSE", 1, "range", "TRUE for one"),
    (1, "DO-SHADOW 2", 11, "range", "TRUE or FALSE"),
    (5, "METHOD facets gaussian SURFACE 0 material conductor gold m = 3", 58, "range", "radians; expected 2 at most"),
    (5, "SURFACE 0 kd = 153 .2 .2", 16, "range", "from 0 to 1; a colour value 153 of 255 is written 0.6"),
    (6, "TRANSFORM 0 SCALE (1 0 1)", 22, "range", "expected a number other than 0\n"),
    (6, "TRANSFORM 0 SCALE (1 1e-20 1)", 22, "range", "1e-15 or more in magnitude"),
    (2, "LIGHTS AREA position 0 5 5 radius -3", 35, "range", "expected a positive number\n"),
    (2, "LIGHTS AREA position 0 5 5 radius 1e-20", 35, "range", "a positive number, 1e-15 or more\n"),
    (2, "LIGHTS AREA position 0 5 5 Intensity -1 0 0", 38, "range", "expected 0 or a positive number\n"),
    (1, "NSAMPLES 0", 10, "range", "expected a whole number from 1 to 1000\n"),
    (4, "CSG-TREE CUBE -1", 15, "range", "expected 0 or a positive whole number\n"),
    (5, "SURFACE 0 n-refr 0", 18, "range", "expected a number from 0.001 to 1000\n"),
    (5, "SURFACE 0 m = .00001", 15, "range", "expected 0, or a number from 0.0001 to 1000\n"),
    (5, "SURFACE 0 transmittance = 0", 27, "range", "expected a positive number, 1 at most\n"),
    (2, "LIGHTS POINT position 0 5 5 CONE direction 0 0 0", 44, "range", ""),
    (4, "CSG-TREE CUBE ٣", 15, "unknown-word", ""),
    # numbers and blocks as other languages write them
    (2, "LIGHTS AREA position = 1, 2, 3", 24, "foreign", "as in 1 2 3"),
    (5, "SURFACE 0 kd = 1.45 .2 .2", 16, "range", "expected a number from 0 to 1\n"),
    (5, "SURFACE 0 kd = 60% 0 0", 16, "not-a-number", "write 0.6"),
    (6, "TRANSFORM 0 SCALE (3 3 3);", 26, "foreign", ""),
    (1, "// a scene", 1, "foreign", "begin with #"),
    # words of other languages, and their meaning in a statement
    (1, "CAUSTICS ON", 10, "unknown-word", "write TRUE"),
    (4, "CSG-TREE CUBE 0 radius .5", 17, "unexpected", "radius has no effect on CUBE; it is for CONE and TORUS"),
    (4, "CSG-TREE TORO 0 raio 0", 22, "range", "expected a number from 0.001 to 0.99"),
    (4, "CSG-TREE CONE 0 radius t-brick", 17, "count", "1 number (the radius)"),
    (4, "CSG-TREE PRISM 0", 10, "unknown-word", "CUBE, SPHERE, CYLINDER"),
    (2, "LIGHTS SPOT position 0 5 5", 8, "unexpected", "AREA or POINT"),
    # words in the wrong place
    (3, "RESOLUTION 5 5 OBS 0 0 9", 1, "unexpected", "after VIEW"),
    (1, "NAME: a red ball (mine)", 9, "unknown-word", 'NAME "a red ball"'),
    (3, "BLURB 0 0 9", 1, "unknown-word", "unknown word 'BLURB'; expected"),  # no guess that is not near
    # the tree
    (4, "CSG-TREE CUBE 0 * - CUBE 0", 17, "tree", ""),
    (4, "CSG-TREE CUBE 0 t-listra - SPHERE 0 * CUBE 0", 26, "infix", "- CUBE 0 t-listra SPHERE 0"),
    (4, "CSG-TREE (- cubo 0 ESFERA 0)", 10, "tree-in-comment", ""),
    # named solids
    (1, "SOLID CUBE CUBE 1", 7, "name", "'CUBE' is a keyword; expected another name"),
    (1, "SOLID x", 7, "incomplete", "expected its tree after x"),
    (1, "SOLID x CUBE 0 SOLID X CUBE 0", 22, "twice", "SOLID X stands twice"),
    (4, "CSG-TREE x 1 SOLID x CUBE 0", 10, "unknown-word", "SOLID stands below, and has to stand above"),
    (4, "SOLID legs CUBE 0 CSG-TREE leg 1", 28, "unknown-word", "legs or the next"),
    (4, "SOLID x CUBE 1 TRANSFORM 1 CSG-TREE x 2", 37, "no-index", "no SURFACE 1 or SURFACE 2 and no TRANSFORM 2"),
    # degenerate views
    (3, "VIEW OBS 0 5 0 VRP 0 0 0 VPN 0 0 1", 6, "view", "OBS lies on the view plane"),
    (3, "VIEW OBS 0 5 0 VRP 0 0 0 VUP 0 1 0", 26, "view", "parallel to VPN"),
    (3, "VIEW OBS 0 0 5 VRP 0 0 0 VUP 0 0 0", 26, "view", "length 0"),
    (3, "VIEW OBS 0 0 5 WINDOW 1 0 1 5", 16, "view", "is empty"),
    (3, "VIEW OBS 0 0 5 WINDOW 1 1 1.000000001 2", 16, "view", "too large or too small"),
    (3, "VIEW OBS 0 0 5 VPN 0 0 1e-200", 16, "view", "length 0"),
    (3, "VIEW OBS 0 0 1e-200 VRP 0 0 0", 6, "view", "same point"),
    # materials
    (5, "SURFACE 0 material dieletrico ouro", 31, "unknown-name", "'conductor ouro'"),
    (5, "SURFACE 0 material BK7", 20, "unknown-word", "'dielectric BK7'"),
    (5, "SURFACE 0 material dieletrico bk7 n-refr = 1.5", 31, "optics", "one of the two"),
    (5, "SURFACE 0 material composto n-refr = 1.5 kd = .7 .2 .2 ks = .5 .2 .2", 1, "optics", "kd + ks"),
    # lights and textures
    (2, "LIGHTS AREA raio 2", 8, "incomplete", "position 0 20 10"),
    (1, "TEXTURE t-parede mortar = 1", 9, "incomplete", "brick, stripes or fractal"),
    (1, "TEXTURE t-x stripes mortar = 1", 21, "unexpected", "brick"),
    (4, "CSG-TREE CUBE 0 NULL madeira.png", 22, "texture", ""),
    (4, "CSG-TREE CUBE 0 'wood.png'", 17, "csg", "double quotes"),
    # marks
    (1, "NAME: x (unclosed", 9, "unclosed", ""),
    (1, 'NAME: "x', 7, "unclosed", ""),
    (1, "NAME: x )", 9, "unclosed", ""),
    (6, "TRANSFORM 0 SCALE (1 1 1 ROTATE-X 3", 19, "unclosed", "this '(' is not closed"),
    (6, "TRANSFORM 0 SCALE (1 1 1 ROTATE-X 3)", 26, "unexpected", "found 'ROTATE-X'; expected )"),
    (7, "", 25, "no-end", "END"),
]


@pytest.mark.parametrize("number, line, column, code, suggested", WRONG)
def test_wrong_input(number, line, column, code, suggested, write_scene):
    text = with_line(number, line)
    path = write_scene(text)
    with pytest.raises(SceneError) as error:
        prosim_scene.translate(path)
    message = str(error.value)
    assert message.startswith(f"{path}:{error.value.line}:{error.value.column}: ")
    assert error.value.line in (number, number + line.count("\n"), number - (number == 7))
    assert (error.value.column, error.value.code) == (column, code) and suggested in message, message
    source, caret = message.splitlines()[-2:]
    before = column > 61  # a long line is clipped
    assert source.startswith("    …") == before
    assert caret.strip("~ ") == "^" and caret.index("^") == 4 + before + min(column - 1, 60)
    assert source[4:].strip("…") in text
    assert [p.name for p in path.parent.iterdir()] == ["s.scn"]


@pytest.mark.parametrize(
    "line, number, code, place",
    [
        ("SURFACE 7 kd = 1 1 1", 1, "unused", "1:1"),
        ("DEFAULT $n = 1", 1, "unused", "1:9"),
        ("LIGHTS", 2, "no-lights", "2:1"),
        ("LIGHTS POINT position 0 5 5 angle 3", 2, "no-effect", "2:29"),
        ("SURFACE 0 material lambertiano ks = .1 .1 .1", 5, "no-effect", "5:32"),
        ("SURFACE 0 material dieletrico bk7 espessura 2", 5, "no-effect", "5:35"),
        ("END (fim) e mais", 7, "after-end", "7:11"),
        ("CSG-TREE", 4, "no-tree", "4:1"),
        ("AMBIENT .2 .2 .2", 1, "dark", "1:1"),
    ],
)
def test_doubtful_input_is_a_warning(line, number, code, place):
    with pytest.warns(SceneWarning) as warned:
        prosim_scene.parse(with_line(number, line), "s")
    assert (code, True) in {(one.message.code, str(one.message).startswith(f"s:{place}: ")) for one in warned}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("line", ["NAME: x (CUBE 1 - SPHERE 2)", "AMBIENT 0 0 0", 'BACKGROUND 1 1 1 "sky.exr"'])
def test_right_input_is_no_warning(line):
    assert prosim_scene.parse(with_line(1, line)).view.eye == (0, 0, 9)


ENGLISH = "LIGHTS AREA position 0 9 9 radius 2 VIEW EYE 0 0 9 CSG-TREE CUBE 0 SURFACE 0 {} TRANSFORM 0 END"
THESIS = "LIGHTS AREA position 0 9 9 raio 2 VIEW OBS 0 0 9 CSG-TREE CUBE 0 SURFACE 0 {} TRANSFORM 0 END"
PORTUGUESE = "LUZES EXTENSA posição 0 9 9 VISTA CSG CUBO 0 SUPERFICIE 0 {} TRANSFORMAÇÃO 0 FIM"


@pytest.mark.parametrize(
    "text, words",
    [
        (THESIS.format("material condutor ouro material x"), "expected condutor, dielectric, lambertian or composite"),
        (PORTUGUESE.format("material x"), "expected condutor, dieletrico, lambertiano or composto"),
        (ENGLISH.format("material gold"), "did you mean 'conductor gold'"),
        (PORTUGUESE.format("material condutor"), "a condutor has either a metal's name"),
        (PORTUGUESE.format("material conductor"), "a conductor has either a metal's name"),  # as the writer wrote it
        (ENGLISH.replace("0 0 9", "0 0 0"), "EYE and VRP are the same point"),
        (PORTUGUESE.replace("VISTA", "VISTA OLHO 0 0 0"), "OLHO and VRP are the same point"),
        (PORTUGUESE.format("material CUBE"), "found 'CUBE'"),  # a quotation
        (PORTUGUESE.format("material dieletrico x"), "expected bk7, .*, diamante, zirconia, agua or n-refr"),
    ],
)
def test_messages_have_the_words_of_the_scene(write_scene, text, words):
    with pytest.raises(SceneError, match=words):
        prosim_scene.check(write_scene(text.replace("{}", "kd = .5")))


def test_warnings_point_at_the_caller(write_scene):
    """They are not about a file of the project."""
    path = write_scene(with_line(1, "AMBIENT .2 .2 .2").replace("position 0 5 5", "position 0 5 5 radius 3"))
    for call in prosim_scene.parse, prosim_scene.check, prosim_scene.translate, prosim_scene.load:
        with pytest.warns(SceneWarning) as warned:
            call(prosim_scene.read(path) if call is prosim_scene.parse else path)
        assert len(warned) >= 1 + (call is not prosim_scene.parse)
        assert {one.filename for one in warned} == {__file__}


def test_a_file_that_cannot_be_read_is_a_scene_error(tmp_path):
    path = tmp_path / "large.scn"
    path.touch()
    os.truncate(path, 100_000_000)
    for one, words in ((tmp_path / "none.scn", "No such file"), (tmp_path, "directory"), (path, "larger than 4 MiB")):
        for read in (prosim_scene.read, prosim_scene.translate):
            with pytest.raises(SceneError, match=words):
                read(one)
    with pytest.raises(SceneError, match="larger than 4 MiB"):
        prosim_scene.parse("(" * (SIZE_LIMIT + 1))


@pytest.mark.slow
@pytest.mark.parametrize(
    "text, words",
    [
        ("NSAMPLES " + "9" * 1_000_000 + "x END", "not a number"),
        ("(" * 1_000_000, "not closed"),
        ("VIEW OBS " + " ".join(f"$x{i}" for i in range(50_000)) + " END", "many more errors"),
        ("CSG-TREE CUBE 0" + " t-x" * 10**6, "a third texture"),
        ("NAME (\n" * 500_000, "many more errors"),
        ("VIEW OBS {" + "1+" * 10**6 + "1}", "longer than 10000 characters"),
        ("SOLID s0 CUBE 1" + "".join(f"\nSOLID s{i} s{i - 1} 1" for i in range(1, 20_000)), "more than 500000"),
    ],
)
def test_monstrous_input_ends_soon_with_a_short_message(text, words):
    with pytest.raises(SceneError, match=words) as error:
        prosim_scene.parse(text, "monster.scn")
    assert len(str(error.value)) < 2000


def test_images_are_read_in_the_scenes_folder_only(tmp_path):
    (tmp_path / "scene").mkdir()
    (tmp_path / "outside.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    (tmp_path / "scene" / "circle.png").symlink_to("circle.png")
    path = tmp_path / "scene" / "x.scn"
    for image, words in (
        ("../outside.png", r"outside the scene's folder; .*--allow-outside \(allow_outside=True\)"),
        (f'"{tmp_path}/outside.png"', "outside"),
        ("circle.png", "does not exist"),
    ):
        path.write_text(with_line(4, f"CSG-TREE CUBE 0 {image}"))
        with pytest.raises(SceneError, match=words):
            prosim_scene.translate(path)
        path.write_text(with_line(1, f"BACKGROUND 0 0 0 {image}"))
        with pytest.raises(SceneError, match=words):
            prosim_scene.check(path)
    path.write_text(with_line(4, "CSG-TREE CUBE 0 ../outside.png"))
    assert "../outside.png" in prosim_scene.translate(path, allow_outside=True).read_text()


def test_encodings(tmp_path):
    path = tmp_path / "x.scn"
    text = with_line(2, "LUZES ponto posição 0 5 5 intensidade 1000 1000 1000 direção 0 -1 0 CONE ângulo 20 (só isto)")
    for encoding in ("utf-8", "latin-1", "utf-8-sig", "utf-16"):
        path.write_bytes(text.replace("\n", "\r\n").encode(encoding))
        assert prosim_scene.parse(prosim_scene.read(path)) == prosim_scene.parse(text)
    assert prosim_scene.parse(text).lights[0].angle == 20
    for encoding in ("utf-16-le", "utf-16-be", "utf-32"):
        path.write_bytes(text.encode(encoding))
        with pytest.raises(SceneError, match="this is not a text in UTF-8"):
            prosim_scene.read(path)


@pytest.mark.parametrize(
    "lines, codes",
    [
        ({5: "SURFACE 0 kd = 7", 6: "TRANSFORM 1"}, ["no-index", "range"]),
        ({6: "SURFACE 0 kd = 7\nTRANSFORM 0 SCALE (1 1 1)"}, ["twice", "range"]),
        ({4: "CSG-TREE CUBE 0 t-x", 5: "SURFACE 0 material composto"}, ["unknown-name", "optics"]),
        # errors that only follow from another one are not told
        ({5: "SURFACE 0 kkd = 1", 4: "CSG-TREE + CUBE 0 CONE 3"}, ["unknown-word"]),
        ({3: "VIEW OBS 1 2", 7: "ENDE"}, ["count", "unknown-word"]),
        ({1: "DEFAULT $x = (1", 3: "VIEW OBS 0 0 $x"}, ["unclosed"]),
    ],
)
def test_errors_are_reported_together_without_their_consequences(lines, codes):
    text = MINIMAL.splitlines()
    for number, line in lines.items():
        text[number - 1] = line
    with pytest.raises(SceneError) as caught:
        prosim_scene.parse("\n".join(text) + "\n", "s.scn")
    told = [caught.value, *caught.value.others]
    assert [one.code for one in told] == codes
    assert told == sorted(told, key=lambda one: (one.line, one.column))
    assert [line for line in str(caught.value).splitlines() if line.startswith("s.scn:")] == [
        f"s.scn:{one.line}:{one.column}: {one.reason}" for one in told
    ]


def test_of_very_many_errors_some_are_told():
    with pytest.raises(SceneError, match=r"and 5 more errors$") as caught:
        prosim_scene.parse("".join(f"SURFACE {i} kd = 7\n" for i in range(1, 11)) + MINIMAL)
    assert len(caught.value.others) == 9 and str(caught.value).count("found '7'") == 5


# ---- Numbers and names at the edge of what Mitsuba and its files can hold


SOLID = "CSG-TREE SPHERE 0 SURFACE 0 {surface} TRANSFORM 0 {transform}"


def solid(surface="", transform="", rest=""):
    return f"{rest}\n{SOLID.format(surface=surface, transform=transform)}\nEND\n"


BEYOND = {
    "a light that shines too much": "LIGHTS AREA position 0 0 5 Intensity 1e15 0 0 raio 1e-9 END",
    "a bright light a little away": "LIGHTS POINT position 0 0 5e9 Intensity 1e12 0 0 END",
    "a light around VRP": "LIGHTS AREA position 0 0 5 raio 6 END",
    "a slope": solid("m = 1e-200"),
    "scales of squares": solid(transform="SCALE (1e15 1e15 1e15) " * 20),
    "a needle": solid(transform="SCALE (1e-7 1e-7 1e7)"),
    "an empty name": 'CSG-TREE SPHERE 0 "" SURFACE 0 TRANSFORM 0 END',
    "a long path": f'BACKGROUND 0 0 0 "{"a/" * 5000}x.png" END',
    "NUL in a name": 'CSG-TREE SPHERE 0 "a\0.png" SURFACE 0 TRANSFORM 0 END',
}


def test_no_number_of_the_language_is_beyond_single_precision():
    for word in WORDS:
        if word.numbers.count:
            assert not any(map(word.numbers.allows, (1e39, -1e39, math.inf, -math.inf, math.nan))), word


@pytest.mark.parametrize("target", ["prosim", "stock"])
@pytest.mark.parametrize("name", BEYOND)
def test_numbers_beyond_the_limits_are_errors_at_their_line(name, target, write_scene):
    path = write_scene(BEYOND[name])
    with pytest.raises(SceneError) as error:
        prosim_scene.translate(path, target=target, tolerance=1)
    assert error.value.line >= 1 and len(str(error.value)) < 600
    assert os.listdir(path.parent) == ["s.scn"]


WITHIN = {
    "lights": "LIGHTS AREA position 0 0 5 raio 1e-6 POINT position 0 0 1e6 SPOT exponent 1e6 angle 179 END",
    "surfaces": solid("n = 1e6", "SCALE (1e-5 1e-5 1e-5)", "LIGHTS VIEW OBS 0 0 1e-3 WINDOW -1e-4 -1e-4 1e-4 1e-4"),
    "slopes": solid("m = 1e-4", rest="LIGHTS POINT position 0 0 1e3"),
    "far": solid(
        "material condutor ouro m = 1e3", "SCALE (1e9 1e9 1e9)", "LIGHTS VIEW OBS 0 0 1e10 WINDOW -1e9 -1e9 1e9 1e9"
    ),
    "angle": "LIGHTS AREA position 0 0 5 CONE angle .05 AREA position 0 0 5 SPOT exponent 1e6 angle .05 END",
}


@pytest.mark.slow
@pytest.mark.parametrize("name", WITHIN)
@pytest.mark.parametrize("target", ["prosim", "stock"])
def test_numbers_within_the_limits_give_finite_images(name, target, write_scene, variant_rgb):
    text = WITHIN[name] if "VIEW" in WITHIN[name] else "VIEW " + WITHIN[name]
    path = write_scene(text.replace("VIEW", "VIEW RESOLUTION 9 9"))
    scene = mi.load_file(str(prosim_scene.translate(path, target=target, tolerance=1)), parallel=False)
    assert np.isfinite(np.array(mi.render(scene, spp=4))).all()


@pytest.mark.parametrize("name", ["$width", "a&b <c>", "a--b", "a 'b'", "ação", "a\\$b", "%20", "a\u202fb\xa0c"])
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_any_printable_name_gives_xml_that_loads(name, tmp_path, variant_rgb):
    folder = tmp_path / name
    folder.mkdir()
    image = name.replace("\\", "") + ".png"
    mi.Bitmap(np.full((4, 4, 3), 128, np.uint8)).write(str(folder / image))
    path = folder / f"{name}.scn"
    path.write_text(f'LIGHTS VIEW RESOLUTION 9 9 CSG-TREE SPHERE 0 "{image}" SURFACE 0 TRANSFORM 0 END', "utf-8")
    xml = prosim_scene.translate(path, tmp_path / "out", tolerance=1)
    assert len(mi.load_file(str(xml), parallel=False).shapes()) == 1


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such names")
@pytest.mark.parametrize("name", [b"a\xff", b"a\x01", b"a\nb"])
def test_names_that_xml_cannot_hold_are_errors(name, tmp_path, write_scene):
    path = tmp_path / os.fsdecode(name + b".scn")
    path.write_text("LIGHTS END")
    with pytest.raises(SceneError, match="not valid in XML"):
        prosim_scene.translate(path)
    prosim_scene.check(path)
    (tmp_path / os.fsdecode(name + b".png")).write_bytes(b"\x89PNG\r\n\x1a\n")
    if b"\x01" in name:
        scene = write_scene(f'NAME: "a--b & c" BACKGROUND 0 0 0 "{os.fsdecode(name)}.png" END')
        with pytest.raises(SceneError, match=r"1:35: the image .* is not valid in XML"):
            prosim_scene.translate(scene)
