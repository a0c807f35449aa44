"""An output never follows a link: the link is replaced, and the file to which it leads stays. A folder of outputs that
the user names may be a link.
"""

import pytest
from running import done, names, prosim, refused, scene_text

LAYERS = scene_text('<integrator type="prosim"/>', width=8, height=8)


@pytest.fixture
def scene(write_scene):
    return write_scene(LAYERS, "scene.xml")


@pytest.fixture
def link(scene, tmp_path_factory):
    """Makes a link in the scene's folder to a file outside, and returns the outside file."""
    outside = tmp_path_factory.mktemp("outside") / "rc"
    outside.write_text("mine")

    def make(name):
        (scene.parent / name).symlink_to(outside)
        return outside

    return make


COMPARE = "prosim", "path", "--rounds", 1, "--sqrt-spp", "1,2", "--reference-seconds", 0


@pytest.mark.parametrize(
    "name, command",
    [
        ("scene.exr", ["render"]),
        ("scene.png", ["render"]),
        ("scene.state.npz", ["render", "--checkpoint"]),
        ("scene.1-of-1.npz", ["render", "--part", "1/1"]),
        ("scene.9.exr", ["render", "--snapshots", "9"]),
        ("scene.0000.exr", ["render", "--frames", "0"]),
        ("scene.0000.png", ["render", "--frames", "0"]),
        ("s.xml", ["translate"]),
        ("s-meshes/m.ply", ["translate"]),
        ("a-mix.exr", ["mix"]),
        pytest.param("scene-compare.html", ["compare"], marks=pytest.mark.slow),
        pytest.param("scene-compare.json", ["compare"], marks=pytest.mark.slow),
    ],
)
def test_link_in_the_place_of_an_output_is_replaced(scene, link, palito, name, command):
    command, *options = command
    if command == "mix":
        done("render", scene, "--layers", "lights", "-o", scene.with_name("a"))
        arguments = scene.with_name("a.exr"), "lamp1=0.5"
    elif command == "translate":
        scene = palito.rename(palito.with_name("s.scn"))
        done("translate", scene)
        old = scene.with_name("s.xml") if name == "s.xml" else next(scene.with_name("s-meshes").iterdir())
        name, content = str(old.relative_to(scene.parent)), old.read_bytes()
        old.unlink()
        arguments = (scene,)
    else:
        arguments = scene, *(COMPARE if command == "compare" else options)
    outside = link(name)
    if command == "translate":
        outside.write_bytes(content)  # the translation replaces no other file
    before = outside.read_bytes()
    done(command, *arguments)
    result = scene.parent / name
    assert result.is_file() and not result.is_symlink() and result.stat().st_size > 100
    assert outside.read_bytes() == before and names(outside.parent) == ["rc"]


def test_link_to_a_folder_of_meshes_is_refused(palito, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    palito.with_name("listing-meshes").symlink_to(elsewhere)
    refused("the folder of the meshes would replace this file or link", "translate", palito)
    assert names(elsewhere) == []


def test_folder_of_outputs_may_be_a_link(scene, palito, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    (folder := scene.with_name("out")).symlink_to(elsewhere)
    done("render", scene, "-o", folder)
    done("translate", palito, "-o", folder)
    assert names(elsewhere) == ["listing-meshes", "listing.xml", "scene.exr", "scene.png"] and folder.is_symlink()


def test_link_to_a_missing_folder_is_found_before_the_render(scene, monkeypatch):
    from mitsuba_prosim.scene import rendering

    monkeypatch.setattr(rendering, "progressive", lambda *_, **__: pytest.fail("has rendered"))
    scene.with_name("out").symlink_to("nowhere")
    for output in "out/a", "out/b/a":
        refused("this is a link that leads to no folder", "render", scene, "-o", scene.parent / output)


def test_format_names_the_file_to_which_a_link_leads(palito):
    palito.write_text("\n\n\n" + palito.read_text())
    (link := palito.with_name("link.scn")).symlink_to(palito)
    assert f"{link}, a link to {palito}: tidied" in prosim("format", link).stdout
