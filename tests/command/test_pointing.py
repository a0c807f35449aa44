"""An error in an XML scene shows its place as one in a scene of the language does."""

import re

import pytest
from running import prosim

XML = """<scene version="3.0.0">
    <sensor type="perspective"/>
    <shape type="sphere">
\t<float name="radius" value="1"/></shape>
</scene>
"""


@pytest.mark.parametrize(
    "old, new, line, under",
    [
        ('type="sphere"', 'type="spheree"', "    <shape", "shape"),
        ('"1"/>', '"wide"/>', " <float name", "float"),
        ("</shape>", "", "</scene>", "scene>"),
    ],
)
def test_places_in_xml_have_a_caret(tmp_path, old, new, line, under):
    scene = tmp_path / "a scene.xml"
    scene.write_text(XML.replace(old, new), encoding="utf-8")
    done = prosim("render", scene, "-m", "scalar_rgb")
    assert done.exit_code == 2
    quoted, caret = done.output.splitlines()[-2:]
    assert quoted.startswith(f"    {line}") and caret.strip() == "^"
    assert quoted[caret.index("^") :].startswith(under)


def test_what_can_not_be_shown_is_said_alone(tmp_path):
    """Words without a place, or with one that is not there to be read."""
    from mitsuba_prosim.scene_files.pointing import pointed

    gone = f"At {tmp_path}/gone.xml (line 3, col 6): failed"
    for words in ("[Film] too wide", gone, 'Loading "a.ply" (line 1, col 1)'):
        assert pointed(words) == words
    short = tmp_path / "short.xml"
    short.write_text("<scene/>\n", encoding="utf-8")
    said = f"While loading {short} (line {{}}, col 2): wrong\n  - more"
    assert pointed(said.format(9)) == said.format(9)
    assert re.search(r"more\n    <scene/>\n     \^$", pointed(said.format(1)))
    outer = f"Error while loading {tmp_path}/gone.xml (line 1, col 2): while processing <include>:\n"
    assert pointed(outer + said.format(1)).endswith("     ^")
