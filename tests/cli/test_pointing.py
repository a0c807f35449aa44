"""An error in an XML scene shows its place as one in a scene of the language does."""

import re

import pytest
from mitsuba_prosim.scene.errors import with_line, with_suggestion
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
def test_places_in_xml_have_a_caret(write_scene, old, new, line, under):
    done = prosim("render", write_scene(XML.replace(old, new), "a scene.xml"), "-m", "scalar_rgb")
    assert done.exit_code == 2
    quoted, caret = done.output.splitlines()[-2:]
    assert quoted.startswith(f"    {line}") and caret.strip() == "^"
    assert quoted[caret.index("^") :].startswith(under)
    assert ('"spheree" not found! Did you mean sphere?\n' in done.output) == ("spheree" in new)


def test_the_plugin_that_is_meant_is_of_the_kind_that_is_named(variant_rgb):
    words = 'failed to instantiate {} plugin of type "{}": [PluginManager] Plugin "{}" not found!'
    for kind, name, meant in [
        ("bsdf", "roughconductorr", " Did you mean roughconductor?"),
        ("bsdf", "prosim_composit", " Did you mean prosim_composite?"),
        ("rfilter", "mitchel", " Did you mean mitchell?"),
        ("shape", "roughconductorr", ""),
        ("bsdf", "xyzzy", ""),
    ]:
        said = words.format(kind, name, name)
        assert with_suggestion(f"{said}\nmore") == f"{said}{meant}\nmore"


def test_no_line_of_another_folder_is_shown_by_a_scenes_own_words(tmp_path):
    scene, part, secret = tmp_path / "scene" / "scene.xml", tmp_path / "scene" / "part.xml", tmp_path / "secret.xml"
    scene.parent.mkdir()
    for path in (secret, part):
        path.write_text(f"<{path.stem}/>")
    scene.symlink_to(part)
    (scene.parent / "link.xml").symlink_to(secret)
    (tmp_path / "named.xml").symlink_to(part)
    for path, shown in ((secret, False), (scene.parent / "link.xml", False), (part, True), (scene, True)):
        words = f'could not parse floating point value "At "{path}" (line 1, col 2)"'
        assert (with_line(words, scene) != words) == shown
    words = f"While loading {tmp_path}/named.xml (line 1, col 2): wrong"
    assert with_line(words, tmp_path / "named.xml").endswith("\n    <part/>\n     ^")


def test_what_can_not_be_shown_is_said_alone(tmp_path, write_scene):
    """Words without a place, or with one that is not there to be read."""
    gone = f"At {tmp_path}/gone.xml (line 3, col 6): failed"
    for words in ("[Film] too wide", gone, 'Loading "a.ply" (line 1, col 1)'):
        assert with_line(words) == words
    short = write_scene("<scene/>\n", "short.xml")
    said = f"While loading {short} (line {{}}, col 2): wrong\n  - more"
    assert with_line(said.format(9)) == said.format(9)
    assert re.search(r"more\n    <scene/>\n     \^$", with_line(said.format(1)))
    outer = f"Error while loading {tmp_path}/gone.xml (line 1, col 2): while processing <include>:\n"
    assert with_line(outer + said.format(1)).endswith("     ^")
