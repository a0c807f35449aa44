"""The digest of a scene: of its content, wherever its files lie."""

import re

import mitsuba as mi
import numpy as np
import OpenEXR
from mitsuba_prosim.live.loaded_scene import LoadedScene
from mitsuba_prosim.scene import scene_file


def test_the_digest_is_that_of_the_content(variant_rgb, tmp_path):
    """Of the text and of all that it names, wherever these lie; comments have no say."""

    def made(folder, text="", colour=1.0, name="picture.exr", said=None, **definitions):
        folder.mkdir()
        OpenEXR.File({}, {c: np.full((2, 2), colour, np.float32) for c in "RGB"}).write(str(folder / name))
        (folder / "more.xml").write_text(f'<scene version="3.0.0">{text}</scene>')
        (folder / "scene.xml").write_text(
            '<scene version="3.0.0"><default name="x" value="1"/><include filename="more.xml"/><emitter type="envmap">'
            f'<string name="filename" value="{said or name}"/></emitter></scene>'
        )
        file = scene_file.SceneFile(folder / "scene.xml", folder, definitions=definitions)
        assert name in dict(file.named_files())
        return file.digest()

    first = made(tmp_path / "a")
    assert made(tmp_path / "b") == first == made(tmp_path / "c", "<!-- nothing -->")
    assert made(tmp_path / "d", name=str(tmp_path / "another.exr")) == first
    assert made(tmp_path / "e", colour=0.5) != first
    assert made(tmp_path / "f", '<emitter type="constant"/>') != first
    named = {"name": "sky.7.exr", "said": "sky.$x.exr", "x": "7"}
    assert made(tmp_path / "g", **named) == made(tmp_path / "h", **named) != made(tmp_path / "i", **named, colour=0.5)


def test_the_files_of_spectra_are_those_that_mitsuba_reads(variant_rgb, tmp_path):
    """One each: neither folders, nor neighbours, nor those of its name further on in the search path."""
    said = '<bsdf type="diffuse"><spectrum name="reflectance" filename="{}"/></bsdf>'
    for number, name in enumerate(("red.spd", "green.spd", "a/red.spd", "a/b/red.spd", "a/blue.spd", "scene.exr")):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(f"400 {number}\n700 {number}")
    (tmp_path / "a" / "part.xml").write_text(f'<scene version="3.0.0">{said.format("$file")}</scene>')
    (tmp_path / "a" / "more.xml").write_text('<scene version="3.0.0"><include filename="last.xml"/></scene>')
    (tmp_path / "a" / "last.xml").write_text(f'<scene version="3.0.0">{said.format("blue.spd")}</scene>')

    def files(text, **definitions):
        (tmp_path / "scene.xml").write_text(f'<scene version="3.0.0">{text}</scene>')
        file = scene_file.SceneFile(tmp_path / "scene.xml", tmp_path, definitions=definitions)
        paths = [path for _, path in file.named_files()]
        read = re.findall(r"400:(\d)", mi.parser.write_string(file.state))
        assert [path.read_text()[4] for path in paths] == read
        return [str(path.relative_to(tmp_path)) for path in paths]

    default = '<!-- <default name="file" value="a"/> --><default value="red.spd" name="file"/>'
    assert files(default + said.format("$file")) == ["red.spd"]
    assert files(default + said.format("$file"), file="green.spd") == ["green.spd"]
    assert files(f'<path value="a"/><!-- {said.format("$none")} -->' + said.format("red.spd")) == ["a/red.spd"]
    assert files(said.format("red.spd") + '<path value="a"/>') == ["red.spd"]
    assert files(default + '<include filename="a/part.xml"/>') == ["red.spd"]
    assert files('<include filename="a/more.xml"/>') == ["a/blue.spd"]  # what includes has its own folder searched
    assert files('<path value="a/b"/>' + default + '<include filename="a/part.xml"/>') == ["red.spd"]
    assert files('<default name="f" value="red"/><default name="fi" value="gre"/>' + said.format("$fien.spd")) == [
        "green.spd"
    ]


def test_a_mesh_of_the_language_is_a_source_but_does_not_travel(variant_rgb, tmp_path):
    """The translation has what it says. What is watched is its own file, and its content is part of the digest."""
    path, mesh = tmp_path / "s.scn", tmp_path / "parts" / "wedge.obj"
    mesh.parent.mkdir()
    path.write_text("LIGHTS POINT position 9 9 9 CSG-TREE MESH 0 parts/wedge.obj SURFACE 0 TRANSFORM 0 END")
    digests = set()
    for top in (1, 2):
        mesh.write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 {top}\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3")
        file = scene_file.SceneFile(path, tmp_path / "made")
        names = [path for _, path in file.named_files()]
        assert mesh not in names and file.sources() == [*names, mesh]
        scene = LoadedScene(file)
        assert scene.files == [mesh] and scene.scene.bbox().max.z == top
        digests.add(file.digest())
    assert len(digests) == 2
