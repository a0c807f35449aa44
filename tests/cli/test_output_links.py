"""An output never follows a link: the link is replaced, and the file to which it leads stays. A folder of outputs that
the user names may be a link.
"""

import pytest
from running import done, names, refused, scene_text

LAYERS = scene_text('<integrator type="prosim"/>', width=8, height=8)


@pytest.fixture
def scene(write_scene):
    return write_scene(LAYERS, "scene.xml")


@pytest.fixture
def outside(tmp_path_factory):
    """A file outside of the scene's folder."""
    path = tmp_path_factory.mktemp("outside") / "rc"
    path.write_text("mine")
    return path


COMPARE = "prosim", "path", "--rounds", 1, "--sqrt-spp", "1,2", "--reference-seconds", 0


@pytest.mark.parametrize(
    "outputs, command",
    [
        ("scene.exr scene.png", ["render"]),
        ("scene.state.npz", ["render", "--checkpoint"]),
        ("scene.1-of-1.npz", ["render", "--part", "1/1"]),
        ("scene.9.exr", ["render", "--snapshots", "9"]),
        ("scene.0000.exr scene.0000.png", ["render", "--frames", "0"]),
        ("a-mix.exr", ["mix", "lamp1=0.5"]),
        pytest.param("scene-compare.html scene-compare.json", ["compare", *COMPARE], marks=pytest.mark.slow),
    ],
)
def test_link_in_the_place_of_an_output_is_replaced(scene, outside, outputs, command):
    command, *options = command
    if command == "mix":
        done("render", scene, "--layers", "lights", "-o", scene.with_name("a"))
    for name in outputs.split():
        scene.with_name(name).symlink_to(outside)
    done(command, scene.with_name("a.exr") if command == "mix" else scene, *options)
    for result in map(scene.with_name, outputs.split()):
        assert result.is_file() and not result.is_symlink() and result.stat().st_size > 100
    assert outside.read_text() == "mine" and names(outside.parent) == ["rc"]


def test_link_in_the_place_of_a_translation_is_replaced(palito, outside):
    """If it leads to an earlier translation, because no other file is replaced."""
    done("translate", palito)
    results = palito.with_suffix(".xml"), next(palito.with_name("listing-meshes").iterdir())
    for result in results:
        outside.write_bytes(before := result.read_bytes())
        result.unlink()
        result.symlink_to(outside)
        done("translate", palito)
        assert result.is_file() and not result.is_symlink() and outside.read_bytes() == before
    assert names(outside.parent) == ["rc"]


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
