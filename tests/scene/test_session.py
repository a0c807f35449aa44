"""Messages of Mitsuba's errors, variants, threads that load scenes, and the digest of what they have loaded."""

import re
import threading

import drjit as dr
import mitsuba as mi
import numpy as np
import OpenEXR
import pytest
from mitsuba_prosim import registry
from mitsuba_prosim.engine.estimator import Estimator
from mitsuba_prosim.scene import scene_file, session
from scenes import in_threads


def test_message_without_a_traceback_and_with_its_cause():
    cause = RuntimeError("can't load:\nTraceback (most recent call last):\n  File a, line 1\nValueError: it is wrong")
    error = RuntimeError(words := "dr.while_loop(): encountered an exception (see above).")
    error.__cause__ = cause
    assert session.message(error) == f"{words} can't load:\nit is wrong"


def test_a_variant_without_its_backend(monkeypatch):
    before = mi.variant()
    monkeypatch.setattr(session, "has_backend", lambda variant: variant.startswith("scalar"))
    with pytest.raises(RuntimeError, match="cuda_ad_rgb needs an NVIDIA GPU"):
        session.set_variant("cuda_ad_rgb")
    assert mi.variant() == before and session.default_variant() == "scalar_rgb"


def test_plugins_are_registered_after_an_attempt_that_failed(variant_rgb, monkeypatch):
    """Though Mitsuba has changed the variant in the attempt."""
    with monkeypatch.context() as patch:
        patch.setattr(registry, "modules", lambda: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            session.set_variant("scalar_rgb")
    assert session.set_variant("scalar_rgb") and issubclass(registry.PLUGINS["prosim"], mi.SamplingIntegrator)


@pytest.mark.parametrize("integrator, parallel", [("prosim", False), ("path", True)])
def test_scenes_with_plugins_in_python_are_not_parallel(variant_rgb, write_scene, monkeypatch, integrator, parallel):
    """Mitsuba 3.9 fails now and then if their objects are made in parallel."""
    path = write_scene(f'<scene version="3.0.0"><integrator type="{integrator}"/></scene>', "scene.xml")
    asked, make = [], mi.parser.instantiate
    monkeypatch.setattr(mi.parser, "instantiate", lambda how, state: asked.append(how.parallel) or make(how, state))
    scene_file.instantiate(scene_file.parse(path, {}))
    assert asked == [parallel]


@pytest.mark.parametrize("launched", [True, False])
def test_kernels_keep_their_threads(variant_rgb, launched):
    """Those that still run, and those that are still to be launched. Mitsuba's films add to a copy for each thread."""

    def counted():
        i = dr.arange(mi.UInt32, 2**20)
        sums = dr.zeros(mi.Float, 64)
        dr.scatter_reduce(dr.ReduceOp.Add, sums, mi.Float(1), i % 64, mode=dr.ReduceMode.Expand)
        if launched:
            dr.eval(sums)
        with session.threads(3):
            return np.array(sums)

    assert (in_threads(2, counted) == 2**14).all()


@pytest.mark.parametrize("other", ["load", "trace"])
def test_loading_a_scene_blocks_other_threads(variant_rgb, tmp_path, monkeypatch, other):
    """Mitsuba has one search path and one number of threads for all, and kernels know of objects that are half made."""
    path = tmp_path / "scene.xml"
    film = '<film type="hdrfilm"><integer name="width" value="1"/><integer name="height" value="1"/></film>'
    path.write_text(
        f'<scene version="3.0.0"><integrator type="prosim"/><sensor type="perspective">{film}</sensor></scene>'
    )
    file = scene_file.SceneFile(path, tmp_path)
    scene, both, met = file.load(), threading.Barrier(2), []
    before = [str(folder) for folder in mi.file_resolver()], dr.thread_count()

    def meet(*_):
        try:
            both.wait(0.2)
            met.append("both")
        except threading.BrokenBarrierError:
            pass
        raise InterruptedError

    monkeypatch.setattr(scene_file, "instantiate", meet)
    monkeypatch.setattr(Estimator, "accumulate", meet)
    acts = {"load": file.load, "trace": lambda: scene.integrator().render(scene)}

    def act(name):
        with pytest.raises(InterruptedError):
            acts[name]()

    threads = [threading.Thread(target=act, args=(name,)) for name in ("load", other)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not met and both.broken
    assert ([str(folder) for folder in mi.file_resolver()], dr.thread_count()) == before


# ---- The digest of a scene: of its content, wherever its files lie


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
        paths = [path for _, path in file.named_files()[len(file.state.files) :]]
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
    alike = '<default name="f" value="red"/><default name="fi" value="gre"/>'
    assert files(alike + said.format("$fien.spd")) == ["green.spd"]


def test_material_beside_the_scene_is_a_part_of_it(variant_rgb, tmp_path):
    """It takes the place of Mitsuba's material of the same name."""
    (folder := tmp_path / "data" / "ior").mkdir(parents=True)
    text = '<scene version="3.0.0"><bsdf type="conductor"><string name="material" value="Au"/></bsdf></scene>'
    (tmp_path / "scene.xml").write_text(text)
    digests = set()
    for value in (None, 1, 2):
        for name in ("Au.eta.spd", "Au.k.spd") if value else ():
            (folder / name).write_text(f"400 1\n700 {value}")
        file = scene_file.SceneFile(tmp_path / "scene.xml", tmp_path)
        assert [path for _, path in file.named_files()[1:]] == sorted(folder.iterdir())
        digests.add(file.digest())
    assert len(digests) == 3


def test_a_mesh_of_the_language_is_a_source_but_does_not_travel(variant_rgb, tmp_path):
    """The translation has what it says. What is watched is its own file, and its content is part of the digest."""
    path, mesh = tmp_path / "s.scn", tmp_path / "parts" / "wedge.obj"
    mesh.parent.mkdir()
    path.write_text("LIGHTS POINT position 9 9 9 CSG-TREE MESH 0 parts/wedge.obj SURFACE 0 TRANSFORM 0 END")
    digests = set()
    for top in (1, 2):
        mesh.write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 {top}\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3")
        file = scene_file.SceneFile(path, tmp_path / "made")
        assert mesh not in dict(file.named_files()).values() and file.sources() == [mesh]
        assert file.load().bbox().max.z == top
        digests.add(file.digest())
    assert len(digests) == 2
