"""A picture that is black says why it may be."""

import re

import pytest
from running import done

SCENE = """LIGHTS {light}
VIEW RESOLUTION 8 6 WINDOW -4 -3 4 3 {view}
CSG-TREE SPHERE 0
SURFACE 0 {surface}
TRANSFORM 0
END
"""
LAMP, VIEW = "POINT position 9 9 9", "OBS 0 0 10 VRP 0 0 0"

AREA = "AREA position 90 90 90 raio 4"


@pytest.mark.parametrize(
    "light, view, says",
    [
        ("", VIEW, "the scene has no lights"),
        (LAMP, "OBS 0 0 10 VRP 0 0 20", "nothing is in view"),
        (LAMP, "OBS 0 0 0 VRP 0 0 -1", "the eye is within a solid"),
        ("POINT position 0 0 -9", VIEW, "they lie in shadow"),
        (LAMP + " CONE direction 0 1 0 angle 5", VIEW, "the lights shine elsewhere"),
        (AREA, VIEW + "|kd 0 0 0", "light arrives at the visible surfaces, and none is reflected"),
        (LAMP + " POINT position 9 0 9 CONE direction 1 0 0 angle 5", VIEW + "|material condutor ouro", "or mirrors"),
        (LAMP, VIEW, None),
    ],
)
def test_black_pictures_say_why(tmp_path, light, view, says):
    view, _, surface = view.partition("|")
    (tmp_path / "scene.scn").write_text(SCENE.format(light=light, view=view, surface=surface))
    said = done("render", tmp_path / "scene.scn", "--samples", 1).output
    assert ("the picture is black" in said) == (says is not None) and (says or "") in said


def test_a_picture_shown_brighter_is_not_black(tmp_path):
    (tmp_path / "scene.scn").write_text(SCENE.format(light=LAMP + " Intensity 3 3 3", view=VIEW, surface=""))
    command = ["render", tmp_path / "scene.scn", "--samples", 1, "--exposure"]
    said = done(*command, -9).output
    enough = re.search(r"the picture is black: its brightest value is .*--exposure (-?\d+) makes it bright", said)[1]
    assert "black" not in done(*command, enough).output
