"""Wrong input: each message names the place, what was found and what was expected; nothing is written."""

import time
import warnings

import prosim_scene
import pytest
from prosim_scene import SceneError, SceneWarning
from prosim_scene.language.analysis import SIZE_LIMIT

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


@pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")
def test_a_missing_transform():
    with pytest.raises(SceneError, match=r":4:10: CUBE 0 has no TRANSFORM 0; .*there are 2"):
        prosim_scene.parse(with_line(6, "TRANSFORM 2"))


def test_the_minimal_scene_is_right():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert prosim_scene.parse(MINIMAL).name == "x"


# line of the text, its replacement, column of the error, words of the message
WRONG = [
    # a statement given twice, and parameters
    (1, "NAME: x NAME: y", 9, ["NAME is given twice", "line 1"]),
    (3, "VIEW OBS 0 0 9 OBS 0 0 8", 16, ["OBS is given twice"]),
    (5, "SURFACE 0 kd = 1 1 1 SURFACE 0 kd = 1 1 1", 22, ["SURFACE 0 is given twice"]),
    (6, "TRANSFORM 0\nTRANSFORM 0", 1, ["TRANSFORM 0 is given twice"]),
    (5, "SURFACE 0 ks = .1 .1 .1 n = 5 m = .3", 31, ["the roughness is given twice"]),
    (2, "LIGHTS POINT position 0 5 5 CONE SPOT", 34, ["the distribution of a light is given twice"]),
    # an index without a SURFACE or TRANSFORM
    (4, "CSG-TREE CUBE 1", 10, ["CUBE 1 has no SURFACE 1", "there are 0"]),
    (4, "CSG-TREE + CUBE 0 CUBE 3", 19, ["CUBE 3 has no SURFACE 3"]),
    (4, "CSG-TREE CUBE 3 SURFACE 1 SURFACE 2", 10, ["CUBE 3 has no SURFACE 3", "there are 0, 1 and 2"]),
    # unknown words
    (1, "NOMEE: x", 1, ["unknown word 'NOMEE'", "did you mean 'NOME'"]),
    (4, "CSG-TREE CUBO 0 SFERE 1", 17, ["unknown word 'SFERE'", "did you mean 'SPHERE'"]),
    (4, "CSG-TREE SPHEER 0", 10, ["unknown word 'SPHEER'", "SPHERE"]),
    (3, "VIEW OSB 0 0 9", 6, ["unknown word 'OSB'", "OBS"]),
    (5, "SURFACE 0 material lambertino kd = 1 1 1", 20, ["unknown word 'lambertino'", "did you mean 'lambertiano'"]),
    (5, "SURFACE 0 material condutor ouroo", 29, ["unknown metal 'ouroo'", "did you mean 'ouro'"]),
    (4, "CSG-TREE CUBE 0 t-tijollo", 17, ["unknown texture 't-tijollo'", "did you mean 't-tijolo'"]),
    (2, "LIGHTS POINT positon 0 5 5", 14, ["unknown word 'positon'", "did you mean 'position'"]),
    # a wrong count of numbers
    (3, "VIEW OBS 0 9", 10, ["found 2 numbers after OBS", "expected 3 numbers (x y z)"]),
    (3, "VIEW WINDOW 0 0 1 1 1", 13, ["found 5 numbers after WINDOW", "expected 4 numbers"]),
    (5, "SURFACE 0 kd = 0.5 0.5", 16, ["found 2 numbers after kd", "expected 3 numbers"]),
    (6, "TRANSFORM 0 SCALE (1 2)", 20, ["found 2 numbers after SCALE", "expected 3 numbers"]),
    (6, "TRANSFORM 0 ROTATE-X ()", 13, ["found 0 numbers after ROTATE-X", "expected 1 number (degrees)"]),
    (1, "SAVE-RGB: TRUE FALSE", 1, ["found 2 words after SAVE-RGB", "expected 3"]),
    # numbers that are none, or not finite
    (3, "VIEW OBS 0 nan 9", 12, ["found 'nan'", "expected a finite number"]),
    (3, "VIEW OBS 0 1e999 9", 12, ["found '1e999'", "expected a finite number"]),
    (3, "VIEW OBS 0 -inf 9", 12, ["'-inf'", "expected a finite number"]),
    (1, "NSAMPLES: 5O", 11, ["found '5O', which is not a number"]),
    (1, "NSAMPLES: 2.5", 11, ["expected a whole number"]),
    (3, "VIEW RESOLUTION 65536 65536", 6, ["too many pixels", "268435456 at most"]),
    (1, "MAX-LEVEL: -1", 12, ["expected a whole number, 0 or more"]),
    (1, "AIR-INDEX: 0", 12, ["expected 0.001 or more, 1000 at most"]),
    (1, "SAVE-RGB: FALSE FALSE FALSE", 1, ["leaves out all channels"]),
    (5, "SURFACE 0 kd = 0.5 1.5 0", 20, ["found '1.5' after kd", "1 at most"]),
    (4, "CSG-TREE CUBE 0.5", 15, ["expected a whole number"]),
    (4, "CSG-TREE CUBE", 10, ["found 0 numbers after CUBE", "its index"]),
    # numbers between commas, or with a comma for the point
    (2, "LIGHTS AREA position = 1, 2, 3", 24, ["found '1,'", "nothing but spaces between them, as in 1 2 3"]),
    (2, "LIGHTS AREA position 1,2,3", 22, ["found '1,2,3'", "as in 1 2 3"]),
    (2, "LIGHTS AREA position 1 , 2", 24, ["found ','", "as in 1 2 3"]),
    (3, "VIEW OBS 1; 2; 3", 10, ["found '1;'", "as in 1 2 3"]),
    (5, "SURFACE 0 kd = 0,5 0,5 0,5", 16, ["found '0,5'", "a point for the fraction, as in 0.5"]),
    (6, "TRANSFORM 0 SCALE (1,-1e-3,.5)", 20, ["found '1,-1e-3,.5'", "as in 1 2 3"]),
    (4, "CSG-TREE CUBE 0, t-tijolo", 15, ["found '0,'", "nothing but spaces"]),
    # numbers in brackets
    (2, "LIGHTS AREA position <1, 2, 3>", 22, ["found '<1,'; expected numbers with nothing but", "no brackets: 1 2 3"]),
    (5, "SURFACE 0 kd [.5 .5 -1e-3]", 14, ["found '[.5'", "no brackets: .5 .5 -1e-3"]),
    (6, "TRANSFORM 0 SCALE < 1,2, 3 >", 19, ["found '<'", "no brackets: 1 2 3"]),
    (6, "TRANSFORM 0 SCALE <0,5 0,5 0,5>", 19, ["found '<0,5'", "no brackets, as in 1 2 3"]),
    (2, "LIGHTS AREA position {1, 2, 3}", 22, ["found '1, 2, 3' in braces", "hold arithmetic", "no braces: 1 2 3"]),
    (1, "AMBIENT {0,5} 1 1", 11, ["found ',' in an expression", "a fraction has a point"]),
    # blocks
    (
        3,
        "VIEW { OBS 0 0 9 }",
        6,
        ["found 'OBS 0 0 9' in braces", "blocks need none: a statement goes on up to the next"],
    ),
    (3, "VIEW {\n OBS 0 0 9\n}", 6, ["this '{' is not closed on its line; braces hold arithmetic", "blocks need none"]),
    (4, "CSG-TREE - { CUBE 0 CUBE 0 }", 12, ["found 'CUBE 0 CUBE 0' in braces", "blocks need none"]),
    (5, "SURFACE 0 kd 1 0 0 }", 20, ["found '}'; braces hold arithmetic", "blocks need none"]),
    # switches
    (1, "CAUSTICS ON", 10, ["unknown word 'ON' after CAUSTICS; expected TRUE or FALSE; for on: TRUE"]),
    (1, "DO-SHADOW = desligado", 13, ["unknown word 'desligado' after DO-SHADOW; expected TRUE or FALSE; for off"]),
    (1, "CAUSTICS TRU", 10, ["expected TRUE or FALSE; did you mean 'TRUE'"]),
    (1, "SAVE-RGB R G B", 10, ["unknown word 'R' after SAVE-RGB; expected 3 words, each TRUE or FALSE (r g b)"]),
    (1, "CAUSTICS", 1, ["found 0 words after CAUSTICS; expected TRUE or FALSE"]),
    # a singular scale
    (6, "TRANSFORM 0 SCALE (1 0 1)", 22, ["singular", "expected factors other than 0"]),
    # the tree
    (4, "CSG-TREE + CUBE 0", 10, ["this '+' lacks an operand"]),
    (4, "CSG-TREE CUBE 0 * - CUBE 0", 17, ["after the tree is complete"]),
    (4, "CSG-TREE - +", 12, ["lacks two operands"]),
    (4, "CSG-TREE CUBE 0 NULL NULL NULL", 27, ["a third texture"]),
    # materials
    (5, "SURFACE 0 material dieletrico", 1, ["lacks its index", "n-refr"]),
    (5, "SURFACE 0 material dieletrico quarzo", 31, ["unknown glass 'quarzo'", "did you mean 'quartzo'"]),
    (5, "SURFACE 0 material dieletrico n-ref = 1.5", 31, ["unknown glass 'n-ref'", "bk7", "did you mean 'n-refr'"]),
    (5, "SURFACE 0 material dieletrico ior (air) 1.5", 31, ["unknown glass 'ior'", "is n-refr, as in n-refr = 1.5"]),
    (5, "SURFACE 0 material dieletrico ouro", 31, ["unknown glass 'ouro'", "did you mean 'condutor ouro'"]),
    (5, "SURFACE 0 material condutor n-ref 1 1 1", 29, ["unknown metal 'n-ref'", "k-abs; did you mean 'n-refr'"]),
    (5, "SURFACE 0 metal\nTRANSFORM 0", 1, ["unknown metal 'TRANSFORM'; expected copper, gold, silver"]),
    (5, "SURFACE 0 material lambertiano ouro", 32, ["unknown word 'ouro'", "did you mean 'condutor ouro'"]),
    (5, "SURFACE 0 material dieletrico bk7 n-refr = 1.5", 31, ["expected one of the two"]),
    (5, "SURFACE 0 material dieletrico n-refr = 1.5 transmitancia = 0", 60, ["1e-06 or more"]),
    (5, "SURFACE 0 material dieletrico n-refr = 1.5 abbe = .5", 51, ["1 or more"]),
    (5, "SURFACE 0 material condutor n-refr = 1 1 1", 1, ["lacks its optics", "k-abs"]),
    (5, "SURFACE 0 material condutor ouro k-abs = 1", 29, ["expected one of the two"]),
    (5, "SURFACE 0 material composto n-refr = 1.5 kd = .7 .2 .2 ks = .5 .2 .2", 1, ["kd + ks is above 1"]),
    (4, "CSG-TREE CUBE 0 0", 15, ["found 2 numbers after CUBE", "expected 1 number (its index)"]),
    # lights
    (2, "LIGHTS AREA raio 2", 8, ["this AREA light has no position", "after AREA, such as position 0 20 10"]),
    (2, "LIGHTS AREA center 0 5 5", 13, ["unknown word 'center'", "the place of a light is position x y z"]),
    (2, "LIGHTS AREA position 0 5 5 raio 0", 33, ["expected 1e-15 or more"]),
    (2, "LIGHTS POINT position 0 5 5 CONE direction 0 0 0", 44, ["length 0"]),
    (2, "LIGHTS POINT position 0 5 5 CONE angle 200", 40, ["180 at most"]),
    # textures
    (1, "TEXTURE t-parede mortar = 1", 9, ["has no kind", "brick, stripes or fractal"]),
    (1, "TEXTURE t-x stripes mortar = 1", 21, ["found 'mortar' in a texture of kind stripes"]),
    (4, "CSG-TREE CUBE 0 NULL madeira.png", 22, ["an image stands in the second texture slot"]),
    # words of other statements, and of other languages
    (3, "RESOLUTION 5 5 OBS 0 0 9", 1, ["found 'RESOLUTION', a word of VIEW; expected it after VIEW"]),
    (5, "SURFACE 0 SCALE (1 1 1)", 11, ["a word of TRANSFORM"]),
    (5, "SURFACE 0 kd .5 OBS 0 0 9", 17, ["found 'OBS', a word of VIEW"]),
    (3, "CAMERA 0 0 9", 1, ["unknown word 'CAMERA'", "the camera is VIEW, with OBS, VRP and WINDOW"]),
    (5, "SURFACE 0 material glass", 20, ["for glass: material dieletrico"]),
    (5, "SURFACE 0 material wood", 20, ["material lambertiano", "material condutor and the metal's name"]),
    (5, "SURFACE 0 material condutor mirror", 29, ["unknown metal 'mirror'", "ouro, prata"]),
    (5, "SURFACE 0 kd = red", 16, ["colours are three numbers", "kd = 1 0 0"]),
    (
        5,
        "SURFACE 0 kd = #ff8000",
        11,
        ["found 0 numbers after kd", "'#ff8000' is a remark, and this colour is 1 0.502 0"],
    ),
    # words that mean something within their statement, and its scale
    (3, "VIEW location 0 16 40", 6, ["unknown word 'location'", "the place of the eye is OBS x y z"]),
    (3, "VIEW OBS 0 0 9 look_at 0 0 0", 16, ["unknown word 'look_at'", "looks at is VRP x y z"]),
    (3, "VIEW OBS 0 0 9 position 0 0 0", 16, ["found 'position', a word of LIGHTS; the place of the eye is OBS"]),
    (3, "VIEW OBS 0 0 9 angle 45", 16, ["found 'angle', a word of LIGHTS; the field of view follows from WINDOW"]),
    (1, "BACKGROUND: white", 13, ["unknown word 'white' after BACKGROUND", "65535 65535 65535 for white"]),
    (1, "AMBIENT grey", 9, ["unknown word 'grey' after AMBIENT", "on a scale of 65535, such as AMBIENT"]),
    (2, "LIGHTS POINT position 0 5 5 color 1 1 1", 29, ["unknown word 'color'", "such as Intensity 65535 65535 65535"]),
    (5, "SURFACE 0 pigment red", 11, ["unknown word 'pigment'", "as in SURFACE 0 kd = 1 0 0"]),
    (4, "CSG-TREE TORUS 0", 10, ["unknown word 'TORUS'", "the solids are CUBE, SPHERE, CYLINDER and CONE, "]),
    (5, "SURFACE 0 { kd = .5 .5 .5 }", 11, ["found 'kd = .5 .5 .5' in braces", "blocks need none"]),
    (6, "TRANSFORM 0 SCALE (3 3 3);", 26, ["found ';'; a statement ends where the next one begins"]),
    (5, "SURFACE 0 kd 1 0 0; # red", 18, ["found '0;'; a statement ends where the next one begins"]),
    (1, "% a scene", 1, ["found '%'; expected a remark to begin with #"]),
    (1, "! a scene", 1, ["found '!'; expected a remark to begin with #"]),
    # trees in parentheses and infix trees
    (4, "CSG-TREE CUBE 0 - SPHERE 0", 17, ["found '-' between its operands", "before them: - CUBE 0 SPHERE 0"]),
    (4, "CSG-TREE CUBE 0 + CUBE 1 * CUBE 2 - CUBE 3", 17, ["before them: - + CUBE 0 * CUBE 1 CUBE 2 CUBE 3"]),
    (
        4,
        "CSG-TREE CUBE 0 t-listra * CUBE 1 * CUBE 2 + CUBE 3",
        26,
        ["them: + * * CUBE 0 t-listra CUBE 1 CUBE 2 CUBE 3"],
    ),
    (4, "CSG-TREE CUBE 0" + " + CUBE 0" * 9, 17, ["operators come before their operands, as in - CUBE 1"]),
    (
        4,
        "CSG-TREE (CUBE 0 - SPHERE 0)",
        10,
        ["the tree stands in a remark", "- CUBE 1 SPHERE 2", "parentheses are remarks"],
    ),
    (4, "CSG-TREE (- cubo 0 ESFERA 0)", 10, ["the tree stands in a remark"]),
    (4, "CSG-TREE + (CUBE 0 - SPHERE 0) CUBE 0", 10, ["lacks an operand", "parentheses are remarks"]),
    # a word where a number is expected, and numbers that are no numbers
    (4, "CSG-TREE CUBE tijolo", 15, ["found 'tijolo' after CUBE; expected 1 number (its index)"]),
    (4, "CSG-TREE CUBE 0 tijolo", 17, ["found 'tijolo', the kind of a texture", "did you mean 't-tijolo'"]),
    (4, "CSG-TREE CUBE 0 listras", 17, ["found 'listras'", "did you mean 't-listras'"]),
    (4, "CSG-TREE CUBE 0 tijolos", 17, ["unknown word 'tijolos'", "did you mean 't-tijolo'"]),
    (1, "NSAMPLES: six", 11, ["unknown word 'six' after NSAMPLES; expected 1 number (the number N)"]),
    (5, "SURFACE 0 kd .1 .2 blue", 20, ["unknown word 'blue' after kd; expected 3 numbers (r g b), or 1"]),
    (3, "VIEW OBS 0 t-x 9", 12, ["found 't-x'", "expected 3 numbers (x y z)"]),
    (3, "VIEW RESOLUTION 320x240", 17, ["found '320x240'", "nothing but spaces between them: 320 240"]),
    (3, "VIEW RESOLUTION 320 x 240", 21, ["unknown word 'x' after RESOLUTION", "2 numbers (width height)"]),
    (6, "TRANSFORM 0 SCALE (2x.5X-1)", 20, ["found '2x.5X-1'", "between them: 2 .5 -1"]),
    # shares, and colours on the scale of 255
    (5, "SURFACE 0 kd = 60% 0 0", 16, ["found '60%', which is not a number; write 0.6"]),
    (5, "SURFACE 0 kd = 153 .2 .2", 16, ["1 at most: a share from 0 to 1, not from 0 to 255; 153 of 255 is 0.6"]),
    # digits of other scripts
    (4, "CSG-TREE CUBE ٣", 15, ["unknown word '٣' after CUBE; expected 1 number (its index)"]),
    (5, "SURFACE ٣ kd = .5", 9, ["unknown word '٣' after SURFACE"]),
    # materials by other words
    (5, "SURFACE 0 material metal", 20, ["found 'metal'", "composto; for a metal: material condutor and its name"]),
    (5, "SURFACE 0 material ouro", 20, ["unknown word 'ouro'", "did you mean 'condutor ouro'"]),
    (5, "SURFACE 0 material BK7", 20, ["unknown word 'BK7'", "did you mean 'dieletrico BK7'"]),
    (5, "SURFACE 0 material dieletrico 1.5", 31, ["found '1.5'; expected a glass's name, or n-refr = 1.5"]),
    # other languages
    (1, "// a scene", 1, ["found '//'; expected a remark to begin with #"]),
    (4, "CSG-TREE CUBE 0 /* the table */", 17, ["found '/*'; expected a remark to begin with #"]),
    (5, "SURFACE 0 kd 1 0 0//red", 18, ["found '0//red'; expected a remark to begin with #"]),
    (1, "-- a scene", 1, ["found '-'; expected a remark to begin with #"]),
    (1, '<?xml version="1.0"?>', 1, ["no scene in this language; expected a name that ends in .xml"]),
    (5, "SURFACE 0 kd = (1, 0, 0)", 11, ["'(1, 0, 0)' is a remark, as parentheses are; without them: 1 0 0"]),
    (6, "TRANSFORM 0 ROTATE-X (pi/2)", 23, ["unknown word 'pi/2' after ROTATE-X", "arithmetic stands in braces"]),
    (2, "LIGHTS SPOT position 0 5 5", 8, ["found 'SPOT'", "a light begins with AREA or POINT"]),
    (1, "BACKGROUND sky.exr", 12, ["found 'sky.exr' after BACKGROUND; expected 3 numbers (r g b) before the image"]),
    (4, "CSG-TREE CUBE 0 'wood.png'", 17, ["does not exist", "in double quotes, or in none"]),
    # names of several words
    (1, "NAME: a red ball (mine)", 9, ["found 'red' after a name; expected one word", 'NAME "a red ball"']),
    (1, "NAME my view of Rio NSAMPLES 4", 14, ["found 'of'", 'NAME "my view of Rio"']),
    # marks
    (1, "NAME: x (unclosed", 9, ["this remark is not closed"]),
    (1, 'NAME: "x', 7, ["this quote is not closed"]),
    (1, "NAME: x )", 9, ["found ')' without its '('"]),
    (
        6,
        "TRANSFORM 0 SCALE (1 1 1 ROTATE-X 3",
        26,
        ["found 'ROTATE-X'", "expected ')' before it: the '(' on line 6, column 19 is not closed"],
    ),
    (6, "TRANSFORM 0\nSCALE (1 1 1\nSURFACE 1", 1, ["found 'SURFACE'", "the '(' on line 7, column 7 is not closed"]),
    (6, "TRANSFORM 0 SCALE (1 1 1 (big)\nEND", 1, ["found 'END'", "the '(' on line 6, column 19 is not closed"]),
    (1, "AMBIENT {2 * (3 - (1) + 1} 1 1", 26, ["not complete", "the '(' on line 1, column 14 is not closed"]),
    (3, "VIEW OBS 0 = 0 9", 12, ["found '='", "only follow a keyword"]),
    (7, "", 25, ["END is missing"]),
    (1, "NAME: ../x", 7, ["expected the base name of a file"]),
]


@pytest.mark.parametrize("number, line, column, words", WRONG)
@pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")
def test_wrong_input(number, line, column, words, tmp_path):
    text = with_line(number, line)
    path = tmp_path / "wrong.scn"
    path.write_text(text)
    with pytest.raises(SceneError) as error:
        prosim_scene.translate(path)
    message = str(error.value)
    assert message.startswith(f"{path}:{error.value.line}:{error.value.column}: ")
    assert error.value.line in (number, number + line.count("\n"), number - (number == 7))
    assert error.value.column == column, message
    for word in words:
        assert word in message
    source, caret = message.splitlines()[-2:]
    before = column > 61  # what is left out of a long line is marked
    assert source.startswith("    …") == before
    assert caret.strip("~ ") == "^" and caret.index("^") == 4 + before + min(column - 1, 60)
    assert source[4:].strip("…") in text
    assert [p.name for p in tmp_path.iterdir()] == ["wrong.scn"]


@pytest.mark.parametrize(
    "number, line, code",
    [
        (1, "NOMEE: x", "unknown-word"),
        (1, "NAME: x NAME: y", "twice"),
        (1, "NAME: x (unclosed", "unclosed"),
        (1, "NSAMPLES: 5O", "not-a-number"),
        (1, "NSAMPLES: 2.5", "range"),
        (1, "NSAMPLES: {1/0}", "expression"),
        (1, "NSAMPLES: $n", "undefined"),
        (3, "VIEW OBS 0 9", "count"),
        (4, "CSG-TREE CUBE 1", "no-index"),
        (4, "CSG-TREE CUBE 0 - SPHERE 0", "infix"),
        (4, "CSG-TREE + CUBE 0", "tree"),
        (5, "SURFACE 0 material condutor ouroo", "unknown-name"),
        (5, "SURFACE 0 material dieletrico", "optics"),
        (5, "SURFACE 0 SCALE (1 1 1)", "unexpected"),
        (7, "", "no-end"),
    ],
)
def test_each_kind_of_error_has_a_code(number, line, code):
    readers = [prosim_scene.parse, prosim_scene.format]
    for read in readers[: 1 + (code != "undefined")]:  # the layout needs no values
        with pytest.raises(SceneError) as error:
            read(with_line(number, line))
        assert error.value.code == code


@pytest.mark.parametrize(
    "line, number, words",
    [
        ("SURFACE 7 kd = 1 1 1", 1, "SURFACE 7 is not used: no primitive has this index"),
        ("LIGHTS", 2, "no lights"),
        ("LIGHTS POINT position 0 5 5 angle 3", 2, "angle has no effect on a UNIFORM light; it is for a CONE or SPOT"),
        ("SURFACE 0 material lambertiano ks = .1 .1 .1", 5, "5:32: ks has no effect on a lambertiano"),
        (
            "SURFACE 0 transmitancia = .5",
            5,
            "transmitancia has no effect on a surface without a material; it is for a diel",
        ),
        ("END (fim) e mais", 7, "what follows END is ignored"),
        ("CSG-TREE", 4, "no CSG-TREE"),
        ("LIGHTS POINT position 0 5 5 Intensity 1 1 1", 2, "2:29: this Intensity is all but dark: 65535 is 1.0"),
        ("AMBIENT .2 .2 .2", 1, "1:1: this AMBIENT is all but dark"),
        ("BACKGROUND 255 255 255", 1, "1:1: this BACKGROUND is all but dark"),
        ("#declare X = 5;", 1, r"1:1: this line is a remark.* DEFAULT \$X = 5, and is written \$X"),
        ("CSG-TREE CUBE 0\n#define R .5", 4, r"5:1: this line is a remark.* DEFAULT \$R = .5"),
        ('TRANSFORM 0 SCALE (1 1 1)\n#include "colors.inc"', 6, "7:1: this line is a remark.*; a scene is one file"),
        ("CSG-TREE CUBE 0\n#while (i < 3)", 4, "5:1: this line is a remark.*; the language has no loops"),
        ("#version 3.7;", 1, "1:1: this line is a remark.*; the language has no versions"),
        ("#ifdef (R)", 1, "1:1: this line is a remark.*; the language has no conditions"),
        ("CSG-TREE CUBE 0 (CUBE 0 - SPHERE 0)", 4, "4:17: this remark reads like a part of the tree"),
        ("CSG-TREE CUBE 0 ((CUBE 0 + CONE 1) * SPHERE 0)", 4, "4:17: this remark reads like a part of the tree"),
    ],
)
def test_doubtful_input_is_a_warning(line, number, words):
    with pytest.warns(SceneWarning, match=words):
        prosim_scene.parse(with_line(number, line))


@pytest.mark.parametrize(
    "line, number",
    [
        ("CSG-TREE CUBE 0 (CUBE 0: o chao - azul + um cubo)", 4),
        ("CSG-TREE CUBE 0 (- CUBE 0 SPHERE 1)", 4),
        ("NAME: x (CUBE 1 - SPHERE 2)", 1),
        ("NAME: x\n# declare the view\n#define the light\n#if it works\n# for (say) a\n#end", 1),
        ("AMBIENT 0 0 0", 1),
        ("BACKGROUND 0 300 0", 1),
        ('BACKGROUND 1 1 1 "sky.exr"', 1),
    ],
)
def test_right_input_is_no_warning(line, number):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        prosim_scene.parse(with_line(number, line))


@pytest.mark.parametrize(
    "number, line",
    [
        (3, "BLURB 0 0 9"),
        (1, "NSAMPLES: six"),
        (5, "SURFACE 0 material condutor adamantium"),
        (5, "SURFACE 0 kd = reddish"),
        (4, "CSG-TREE TORUS 0"),
    ],
)
@pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")
def test_no_guess_that_is_not_near(number, line):
    with pytest.raises(SceneError, match=r"unknown (word|metal)") as error:
        prosim_scene.parse(with_line(number, line))
    assert "did you mean" not in str(error.value)


def test_a_missing_file_is_a_scene_error(tmp_path):
    with pytest.raises(SceneError, match="No such file"):
        prosim_scene.translate(tmp_path / "none.scn")
    with pytest.raises(SceneError, match="directory"):
        prosim_scene.translate(tmp_path)


def test_large_files_are_refused(tmp_path):
    path = tmp_path / "large.scn"
    with path.open("wb") as file:
        file.truncate(100_000_000)
    start = time.perf_counter()
    for read in (prosim_scene.read, prosim_scene.translate):
        with pytest.raises(SceneError, match="larger than 16 MiB"):
            read(path)
    with pytest.raises(SceneError, match="larger than 16 MiB"):
        prosim_scene.parse("(" * (SIZE_LIMIT + 1))
    assert time.perf_counter() - start < 20  # it is not read at all


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")
@pytest.mark.parametrize(
    "text, words",
    [
        ("NSAMPLES " + "9" * 1_000_000 + " END", "9"),
        ("NSAMPLES " + "9" * 1_000_000 + "x END", "not a number"),
        ("AMBIENT " + "9." + "9" * 1_000_000 + "%%", "not a number"),
        ("AMBIENT " + "1" * 1_000_000 + " 1 1 END", "finite"),
        ("SURFACE " + "1" * 1_000_000 + " END", "9 digits at most"),
        ("(" * 1_000_000, "not closed"),
        ("()" * 500_000 + "x", "unknown word"),
        ("CSG-TREE " + "+ " * 100_000 + "END", "lacks two operands"),
        ("CSG-TREE " + "+" * 100_000 + " CUBE 0 END", "lacks"),
        ("x" * 1_000_000, "unknown word"),
        ("\x00" * 1000, "unknown word"),
        ("NAME: " + "y" * 1_000_000 + " END", "200 at most"),
    ],
)
def test_monstrous_input_ends_soon_with_a_short_message(text, words):
    with pytest.raises(SceneError, match=words) as error:
        prosim_scene.parse(text, "monster.scn")
    assert len(str(error.value)) < 2000


@pytest.mark.slow
@pytest.mark.parametrize("tree", ["+ " * 30_000 + "CUBE 0 " * 30_001, "- CUBE 0 " * 30_000 + "CUBE 0"])
def test_a_tree_of_30000_levels(tree):
    scene = prosim_scene.parse(with_line(4, "CSG-TREE " + tree))
    assert len(scene.csg) == 60_001 and len(repr(scene)) > 60_001


def test_images_are_read_in_the_scenes_folder_only(tmp_path):
    (tmp_path / "scene").mkdir()
    (tmp_path / "outside.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    (tmp_path / "scene" / "text.png").write_text("no picture")
    (tmp_path / "scene" / "circle.png").symlink_to("circle.png")
    path = tmp_path / "scene" / "x.scn"
    for image, words in (
        ("../outside.png", "outside the scene's folder; .*--allow-outside, allow_outside=True"),
        (f'"{tmp_path}/outside.png"', "outside"),
        ("none.png", "does not exist"),
        ("circle.png", "does not exist"),
        ("text.png", r"'text.png' is no image; expected one of PNG, .* or TGA"),
    ):
        path.write_text(with_line(4, f"CSG-TREE CUBE 0 {image}"))
        with pytest.raises(SceneError, match=words):
            prosim_scene.translate(path)
        path.write_text(with_line(1, f"BACKGROUND 0 0 0 {image}"))
        with pytest.raises(SceneError, match=words):
            prosim_scene.check(path)
    path.write_text(with_line(4, "CSG-TREE CUBE 0 ../outside.png"))
    assert "../outside.png" in prosim_scene.translate(path, allow_outside=True).read_text()


def test_wrong_options_are_scene_errors(tmp_path):
    path = tmp_path / "x.scn"
    path.write_text(MINIMAL)
    for options in (
        {"target": "pov"},
        {"light_units": "lumen"},
        {"tolerance": 0},
        {"tolerance": float("nan")},
        {"samples": 0},
        {"samples": 1001},
        {"resolution": (0, 1)},
        {"resolution": (65536, 65536)},
        {"resolution": (1.5, 1)},
    ):
        for function in (prosim_scene.translate, prosim_scene.load, prosim_scene.check):
            with pytest.raises(SceneError, match=f"{next(iter(options))} is .*; expected"):
                function(path, **options)
    path.write_text(with_line(3, "VIEW OBS 0 0 9 VRP 0 5 5"))
    with pytest.raises(SceneError, match="stands at VRP"):
        prosim_scene.translate(path)


def test_encodings(tmp_path):
    path = tmp_path / "x.scn"
    text = with_line(2, "LUZES ponto posição 0 5 5 intensidade 1000 1000 1000 direção 0 -1 0 CONE ângulo 20 (só isto)")
    for encoding in ("utf-8", "latin-1", "utf-8-sig", "utf-16"):
        path.write_bytes(text.replace("\n", "\r\n").encode(encoding))
        assert prosim_scene.parse(prosim_scene.read(path)) == prosim_scene.parse(text)
    assert prosim_scene.parse(text).lights[0].angle == 20
    for encoding in ("utf-16-le", "utf-16-be", "utf-32"):
        path.write_bytes(text.encode(encoding))
        with pytest.raises(SceneError, match="no text in UTF-8"):
            prosim_scene.read(path)


@pytest.mark.parametrize(
    "lines, reasons",
    [
        # what cannot be read, and what the rest lacks
        (
            {5: "SURFACE 0 kkd = 1", 4: "CSG-TREE + CUBE 0 CONE 3"},
            ["CONE 3 has no SURFACE 3 and no T", "unknown word 'kkd'"],
        ),
        (
            {5: "SURFACE 0 kd = 7", 6: "TRANSFORM 1"},
            ["CUBE 0 has no TRANSFORM 0; expected a statement TRANS", "found '7'"],
        ),
        (
            {3: "VIEW OBS 1 2", 6: "TRANSFORM 0 SCALE (1 2)"},
            ["found 2 numbers after OBS", "found 2 numbers after SCALE"],
        ),
        ({4: "CSG-TREE + CUBE 1 CUBE 2"}, ["CUBE 1 has no SURFACE 1 and no", "CUBE 2 has no SURFACE 2 and no"]),
        ({3: "VIEW OBS 1 2", 7: "(the end)"}, ["found 2 numbers after OBS", "the file ends here and END is missing"]),
        (
            {6: "SURFACE 0 kd = 7\nTRANSFORM 0 SCALE (1 1 1)"},
            ["SURFACE 0 is given twice; the first is on line 5", "found '7' after kd"],
        ),
        ({1: "AMBIENT $x 0 0", 3: "VIEW OBS 0 0 $y"}, ["nothing above says what $x", "nothing above says what $y"]),
        ({4: "CSG-TREE CUBE 0 t-x", 5: "SURFACE 0 material composto"}, ["a composto lacks its index"]),
        # what only follows from another error
        ({3: "VIEW OBS 1 2", 7: "ENDE"}, ["found 2 numbers after OBS", "unknown word 'ENDE'"]),
        ({6: "TRANSFORM 0 (SCALE 1 1 1", 7: "the END"}, ["this remark is not closed"]),
        ({4: "CSG-TREE + CUBE 0 CONE"}, ["found 0 numbers after CONE"]),
        ({5: "SURFCE 0 kd = 1"}, ["unknown word 'SURFCE'"]),
        ({5: "SURFACE 7 SURFCE 0 kd = 1"}, ["unknown word 'SURFCE'"]),
        ({6: "TRANSFORM 0 SCALE (1 2)"}, ["found 2 numbers after SCALE"]),
        ({6: "TRANSFORM {0 SCALE (1 1 1)"}, ["this '{' is not closed"]),
        ({1: "AMBIENT $x $x $x NSAMPLES $x"}, ["nothing above says what $x stands for"]),
        ({1: "DEFAULT $x = (1", 3: "VIEW OBS 0 0 $x"}, ["this remark is not closed"]),
    ],
)
@pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")
def test_errors_are_told_together_but_not_what_follows_from_them(lines, reasons):
    text = MINIMAL.splitlines()
    for number, line in lines.items():
        text[number - 1] = line
    with pytest.raises(SceneError) as caught:
        prosim_scene.parse("\n".join(text) + "\n", "s.scn")
    told = [caught.value, *caught.value.others]
    assert told == sorted(told, key=lambda one: (one.line, one.column))
    assert len(told) == len(reasons) and all(one.reason.startswith(begin) for one, begin in zip(told, reasons))
    assert [line for line in str(caught.value).splitlines() if line.startswith("s.scn:")] == [
        f"s.scn:{one.line}:{one.column}: {one.reason}" for one in told
    ]


def test_of_very_many_errors_some_are_told():
    with pytest.raises(SceneError, match=r"and 5 more errors$") as caught:
        prosim_scene.parse("".join(f"SURFACE {i} kd = 7\n" for i in range(1, 11)) + MINIMAL)
    assert len(caught.value.others) == 9 and str(caught.value).count("found '7'") == 5
