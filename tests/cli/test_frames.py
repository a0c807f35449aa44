"""``prosim render --frames``: each frame is the image of the scene alone, and made once, as is what frames share."""

import gc
import os
import signal

import drjit as dr
import numpy as np
import pytest
from mitsuba_prosim.cli import files
from mitsuba_prosim.cli.terminal import Progress
from mitsuba_prosim.engine.work import WorkItem
from running import LAMP, XML, metadata, names, pixels, prosim, refused
from running import done as run
from scenes import kernels

FILM = """DEFAULT $kd = 0.4
NSAMPLES 2
VIEW RESOLUTION 12 8 WINDOW -3 -2 3 2 OBS {9 * sin(30 * $frame)} 3 {9 * cos(30 * $frame)}
LIGHTS AREA position 4 {6 + $time} 4 raio 2
CSG-TREE - CUBE 0 SPHERE 1
SURFACE 0 material lambertiano kd = {$kd + $frame / 100} .5 .5
SURFACE 1 material condutor ouro m = 0.2
TRANSFORM 0 TRANSLATE (-.5 -.5 -.5) SCALE (2 2 2)
TRANSFORM 1 SCALE (1.2 1.2 1.2)
END
"""


@pytest.fixture
def film(write_scene, variant_rgb):
    return write_scene(FILM, "film.scn")


def rendered(*arguments):
    """How many frames a command says that it has rendered, and how many were there."""
    line = run("render", *arguments).stdout.splitlines()[-1]
    made, of = line.partition(".png: ")[2].split(" frames")[0].split(" of ")
    assert (int(made) == int(of)) == ("rendered before" not in line)
    return int(made), int(of) - int(made)


def kept(folder):
    return {path.name: path.stat().st_ino for path in folder.iterdir() if path.suffix == ".exr"}


@pytest.mark.slow
def test_each_frame_is_the_image_of_the_scene_alone(film):
    assert rendered(film, "--frames", "0:6:2", "--seed", 5) == (3, 0)
    frames = [f"film.{n}.{kind}" for n in ("0000", "0002", "0004") for kind in ("exr", "png")]
    assert names(film.parent) == [*frames, "film.scn"]
    alone = film.with_name("alone")
    run("render", film, "-D", "frame=4", "--seed", 9, "-o", alone)
    assert rendered(film, "--frames", 4, "--seed", 5, "-o", film.with_name("one")) == (1, 0)
    for name in "alone.png", "one.0004.png":
        assert film.with_name(name).read_bytes() == film.with_name("film.0004.png").read_bytes()
        exr = film.with_name(name).with_suffix(".exr")
        assert np.array_equal(pixels(exr), pixels(film.with_name("film.0004.exr")))
    assert not np.array_equal(pixels(film.with_name("film.0002.exr")), pixels(film.with_name("film.0004.exr")))
    assert metadata(film.with_name("film.0004.exr"))["seed"] == "9"


@pytest.mark.slow
def test_a_frame_is_rendered_again_where_the_scene_has_changed(film):
    """Neither a comment nor the encoding is a change."""
    options = "--frames", "0:2"
    assert rendered(film, *options) == (2, 0)
    before = kept(film.parent)
    film.write_text("(a comment)\n" + FILM, encoding="utf-16")
    assert rendered(film, *options, "-D", "kd=0.4") == (0, 2) and kept(film.parent) == before
    film.with_name("film.0001.exr").unlink()
    assert rendered(film, *options) == (1, 1)
    film.with_name("film.0000.exr").write_bytes(b"none")
    film.write_text(FILM.replace("+ $frame / 100", "+ $frame / 50"))
    assert rendered(film, *options) == (2, 0)


@pytest.mark.slow
def test_a_frame_is_rendered_again_where_an_option_has_changed(film):
    options = "--frames", "0:2"
    assert rendered(film, *options) == (2, 0)
    for other in ["-D", "kd=0.3"], ["--seed", 1], ["--exposure", 1], ["--denoise"], ["--noise", 0.05]:
        assert rendered(film, *options, *other) == (2, 0), other
    assert rendered(film, *options, *other) == (0, 2)


@pytest.mark.slow
def test_frames_share_kernels(film):
    """No scene of an earlier frame is in memory."""
    first, later = (kernels(lambda frames=frames: rendered(film, "--frames", frames)) for frames in (0, "1:4"))
    assert len(first) > 3 and later <= first


@pytest.mark.slow
def test_passes_of_a_wide_filter_share_a_kernel(write_scene, variant_rgb, monkeypatch):
    """The constants of the filter are in the same order in each kernel, whatever was traced before."""
    compute, used = WorkItem.compute, set()

    def recorded(item):
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
            dr.kernel_history_clear()
            result = compute(item)
            history = dr.kernel_history([dr.KernelType.JIT])
        used.add(max((kernel["operation_count"], kernel["hash"]) for kernel in history))
        return result

    monkeypatch.setattr(WorkItem, "compute", recorded)
    gc.collect()  # kernels know of all scenes in memory, also of those of other tests
    run("render", write_scene(LAMP, "s.xml"), "--time", 0.5)
    assert len(used) == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    "target, name, keep", [(Progress, "show", False), (files, "save", False), (Progress, "show", True)]
)
def test_an_interrupted_film_keeps_its_frames(film, monkeypatch, target, name, keep):
    """A signal comes while the first frame is written, or in the second frame, which ``--checkpoint`` keeps."""
    options = ("--frames", "0:3", *(["--checkpoint"] if keep else []))
    assert rendered(film, *options, "-o", film.with_name("whole")) == (3, 0)
    act, in_second, calls = getattr(target, name), target is Progress, []

    def acting(*arguments):
        calls.append(film.with_name("film.0000.png").exists() == in_second)
        if sum(calls) > in_second:
            os.kill(os.getpid(), signal.SIGINT)
        return act(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(target, name, acting)
        patch.setattr(os, "_exit", lambda _: None)
        done = prosim("render", film, *options)
    assert done.exit_code == 1 and "1 of 3 frames rendered; interrupted" in done.stdout
    written = {"film.0000.exr", "film.0000.png"}
    written |= {"film.0000.state.npz", "film.0001.state.npz"} if keep else set()
    assert {name for name in names(film.parent) if "film.0" in name} == written
    assert rendered(film, *options) == (2, 1)
    for number in range(3):
        name = f".000{number}.png"
        assert film.with_name("film" + name).read_bytes() == film.with_name("whole" + name).read_bytes()


def test_frames_need_the_name_frame(film):
    film.write_text(FILM.replace("$frame", "$time"))
    fixed = prosim("render", film, "--frames", "0:2", "-D", "time=3")
    assert fixed.exit_code == 2 and f"frame 0: {film}: the scene does not use $frame" in fixed.stderr


def test_scenes_in_xml_have_frames_too(scene):
    scene.write_text(XML.replace('radiance" value="0.5"', 'frame" value="9"').replace("$radiance", "0.$frame"))
    assert rendered(scene, "--frames", "25:27") == (2, 0)
    assert pixels(scene.with_name("scene.0025.exr"))[0, 0, 0] == pytest.approx(0.25)
    assert rendered(scene, "--frames", "25:28") == (1, 2)
    scene.write_text(XML.replace("<film", '<float name="fov" value="4$frame"/><film'))
    done = prosim("render", scene, "--frames", "0:3", "-D", "radiance=0", "-o", scene.with_name("dark"))
    assert done.exit_code == 0 and "3 of 3 frames rendered, 3 of them black" in done.stdout
    assert done.stderr.count("frame 0: the picture is black: ") == done.stderr.count("black") == 1


def test_a_wrong_frame_is_named_and_those_before_it_are_kept(film):
    done = prosim("render", film, "--frames", "0:9", "-D", "kd=0.99")
    assert done.exit_code == 2
    assert f"frame 2: {film}:6:37: found '1.01' after kd" in done.stderr
    assert "film.0001.png" in names(film.parent) and "film.0002.png" not in names(film.parent)
    refused("the scene does not use $turn", "render", film, "-D", "turn=3")


def test_translate_has_names(film):
    run("translate", film, "-D", "frame=3", "-o", film.with_name("out"))
    assert "0.43, 0.5, 0.5" in film.with_name("out").joinpath("film.xml").read_text()
    assert "found '2' after kd" in (said := prosim("translate", film, "--check", "-D", "kd=2").stderr.splitlines()[0])
    assert said.endswith("; $kd stands for '2', by -D kd=2")
