"""The eye, a light, or a part of a light inside an opaque solid."""

import re

import prosim_scene
import pytest
from test_mesh_files import obj

#: Lights, a tree, what is inside a solid, and the solid; "" if nothing is. CUBE 1 is 4 wide, around the origin.
CASES = [
    ("POINT position 1 1 1", "CUBE 1", "light", "CUBE 1"),
    ("AREA position 0 0 0 radius .1", "CUBE 1", "light", "CUBE 1"),
    ("AREA position 0 2 0 radius .5", "CUBE 1", "a part of the light", "CUBE 1"),
    ("AREA position 0 2.5 0 radius .5", "CUBE 1", "", ""),  # on the solid
    ("AREA position 0 0 0 radius 9", "CUBE 1", "", ""),  # around the solid
    ("POINT position 1 1 1", "+ SPHERE 9 CUBE 1", "light", "CUBE 1"),
    ("POINT position 1 1 1", "+ CUBE 1 CUBE 2", "light", "CUBE 1"),
    ("POINT position 1 1 1", "- CUBE 1 CUBE 2", "", ""),  # in a room
    ("POINT position 1.9 1 1", "- CUBE 1 CUBE 2", "light", "CUBE 1"),
    ("AREA position 1.5 1 1 radius .2", "- CUBE 1 CUBE 2", "a part of the light", "CUBE 1"),
    ("POINT position 1 1 1", "- CUBE 1 - CUBE 2 CUBE 2", "light", "CUBE 1"),
    ("POINT position 1 1 1", "* CUBE 1 CUBE 2", "light", "CUBE 1"),
    ("POINT position 1.9 1 1", "* CUBE 1 CUBE 2", "", ""),
    ("POINT position 1 1 1", "CUBE 3", "", ""),  # in glass
    ("POINT position 1 1 1", "+ CUBE 3 CUBE 1", "light", "CUBE 1"),  # opaque solids have the common volume
    ("POINT position 1 1 1", "- CUBE 1 CUBE 3", "", ""),
    ("POINT position 1 1 1", "* CUBE 3 CUBE 1", "", ""),
    ("POINT position 1 1 1", "* CUBE 1 CUBE 3", "light", "CUBE 1"),
    ("POINT position 1 1 1", "CYLINDER 4", "light", "CYLINDER 4"),  # mirrored
    ("POINT position 1.8 1.8 1", "CYLINDER 4", "", ""),
    ("POINT position 0 0 1", "SPHERE {2 + 3}", "light", "SPHERE 5"),
    ("POINT position 1 1 1", 'MESH 1 "cube.obj"', "light", "MESH 1"),
    ("POINT position 1 1 1", "block (of stone) 6", "light", "block 6"),
]
SCENE = """LIGHTS {lights}
VIEW EYE {eye} VRP 0 0 -20
SOLID block - CUBE 1 SPHERE 9
CSG-TREE
 {tree}
SURFACE 1 SURFACE 2 SURFACE 3 material dielectric bk7 SURFACE 4 SURFACE 5 SURFACE 9
SURFACE 7
SURFACE 8 material dielectric bk7
TRANSFORM 1 TRANSLATE -.5 -.5 -.5 SCALE 4 4 4 {move}
TRANSFORM 2 TRANSLATE -.5 -.5 -.5 SCALE 3 3 3 {move}
TRANSFORM 3 TRANSLATE -.5 -.5 -.5 SCALE 4 4 4 {move}
TRANSFORM 4 SCALE 2 2 -3 TRANSLATE 0 0 2 {move}
TRANSFORM 5 SCALE 2 2 2 {move}
TRANSFORM 6
TRANSFORM 7 SCALE .5 .5 .5 TRANSLATE -1 -1 -1 {move}
TRANSFORM 8 SCALE .5 .5 .5 TRANSLATE .8 .8 .8 {move}
TRANSFORM 9 TRANSLATE 50 50 50
END
"""


@pytest.fixture
def told(write_scene, recwarn):
    """The warnings about enclosure of a scene, which are about their places."""

    def warned(lights="", tree="CUBE 1", eye="0 0 99", move=""):
        path = write_scene(SCENE.format(lights=lights, tree=tree, eye=eye, move=move))
        path.with_name("cube.obj").write_bytes(obj())
        prosim_scene.check(path)
        return [w.message for w in recwarn if "is opaque" in str(w.message)]

    return warned


@pytest.mark.parametrize("lights, tree, what, solid", CASES)
def test_light_in_an_opaque_solid_is_named(told, lights, tree, what, solid):
    warned = told(lights, tree)
    assert len(warned) == bool(what)
    for one in warned:
        assert re.search(rf"{what} on line 1 is inside {solid} \(line 5\), which is opaque; move it ", one.reason)
        assert one.reason.startswith("a part") == what.startswith("a part") and one.line == 1


@pytest.mark.parametrize(
    "lights, tree, what, solid",
    [case for case in CASES if re.fullmatch("POINT position [^A-Z]*", case[0]) and "MESH" not in case[1]],
)
def test_eye_in_an_opaque_solid_is_named(told, lights, tree, what, solid):
    """Also in a scene far from the origin."""
    eye = " ".join(str(float(x) + 1e4) for x in lights.split()[-3:])
    warned = told(eye=eye, tree=tree, move="TRANSLATE 1e4 1e4 1e4")
    assert [one.line for one in warned] == [2] * bool(what)
    assert all(one.reason.startswith(f"the eye is inside {solid} (line 5)") for one in warned)


def test_each_light_is_named(told):
    warned = told(lights="POINT position 1 1 1 AREA position 9 9 9\nPOINT position 1 1 0")
    found = [(one.reason[:21], one.line) for one in warned]
    assert found == [("the light on line 1 i", 1), ("the light on line 2 i", 2)]


@pytest.mark.parametrize(
    "tree, eye, closed",
    [
        ("- CUBE 1 CUBE 2", "0 0 99", True),
        ("+ - CUBE 1 CUBE 2 CUBE 3", "0 0 99", True),  # glass in the room
        ("- CUBE 1 CUBE 2", "0 1 1", False),  # the eye is in the room, too
        ("+ - CUBE 1 CUBE 2 CUBE 8", "0 1 1", False),  # and the light in glass
        ("- - CUBE 1 CUBE 7 CUBE 8", "-.8 -.8 -.8", True),  # the eye is in another room
        ("- CUBE 1 CUBE 2\nDO-SHADOW: no", "0 0 99", False),
        ("- - CUBE 1 CUBE 2 CYLINDER 4", "0 0 99", False),  # the room is open
        ("CUBE 3", "0 0 99", False),  # glass
    ],
)
def test_light_in_a_closed_hollow_is_named(write_scene, recwarn, tree, eye, closed):
    move = "TRANSLATE 1e4 1e4 1e4"
    eye, light = (" ".join(str(float(x) + 1e4) for x in place.split()) for place in (eye, "1 1 1"))
    prosim_scene.check(write_scene(SCENE.format(lights=f"POINT position {light}", tree=tree, eye=eye, move=move)))
    found = [w.message for w in recwarn if "is in a closed hollow of an opaque solid" in str(w.message)]
    assert [one.line for one in found] == [1] * closed
