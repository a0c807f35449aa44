"""Numbers and names at the edge of what Mitsuba and its files can hold: errors that name the place, or sound files."""

import math
import os
import sys

import mitsuba as mi
import numpy as np
import prosim_scene
import pytest
from prosim_scene import SceneError
from prosim_scene.language.words import WORDS

SOLID = "CSG-TREE SPHERE 0 SURFACE 0 {surface} TRANSFORM 0 {transform}"

pytestmark = pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning", "error::RuntimeWarning")


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
