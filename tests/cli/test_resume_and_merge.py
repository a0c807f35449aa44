"""``prosim render --checkpoint`` and ``--part``, ``prosim resume`` and ``prosim merge``."""

import re
from dataclasses import replace

import numpy as np
import pytest
from mitsuba_prosim.cli import render_task
from mitsuba_prosim.engine import checkpoint, environment
from mitsuba_prosim.engine.checkpoint import CheckpointWriter
from running import LAMP, alike, done, metadata, names, pixels, prosim, refused


@pytest.fixture
def lamp(scene):
    scene.write_text(LAMP)
    return scene


def die_after(monkeypatch, steps):
    """The process dies after this many steps, as far as the files are concerned: the state of each is written."""
    monkeypatch.setattr(CheckpointWriter, "SHORTEST", 0.0)
    monkeypatch.setattr(CheckpointWriter, "SHARE", 1e9)
    keep, left = CheckpointWriter.__call__, [steps]

    def call(self, render):
        keep(self, render)
        left[0] -= 1
        if left[0] == 0:
            raise KeyboardInterrupt

    monkeypatch.setattr(CheckpointWriter, "__call__", call)


@pytest.mark.slow
@pytest.mark.parametrize("options", [(), ("--noise", 0.02)])
def test_a_render_that_has_died_is_continued(lamp, tmp_path, monkeypatch, options):
    done("render", lamp, "-o", tmp_path / "whole", *options)
    with monkeypatch.context() as patch:
        die_after(patch, 3)
        assert prosim("render", lamp, "-o", tmp_path / "a", "--checkpoint", *options).exit_code != 0
    state = tmp_path / "a.state.npz"
    assert state.exists() and not (tmp_path / "a.exr").exists()
    done("resume", state)
    done("resume", state, "-o", tmp_path / "again", "--exposure", 0)
    assert alike(tmp_path / "whole", tmp_path / "a", tmp_path / "again")
    assert names(tmp_path)[-1] == "whole.png" and (tmp_path / "again.state.npz").exists()


@pytest.mark.slow
def test_a_continued_render_writes_the_other_snapshots(lamp, tmp_path, monkeypatch):
    options = "--noise", 0.0001, "--snapshots", "0.5,0.0002"
    done("render", lamp, "-o", tmp_path / "whole", *options)
    with monkeypatch.context() as patch:
        die_after(patch, 20)
        assert prosim("render", lamp, "-o", tmp_path / "a", "--checkpoint", *options).exit_code != 0
    first = (tmp_path / "a.0.5.exr").read_bytes()
    done("resume", tmp_path / "a.state.npz")
    assert (tmp_path / "a.0.5.exr").read_bytes() == first
    for snapshot in "0.5", "0.0002":
        assert np.array_equal(*(pixels(tmp_path / f"{name}.{snapshot}.exr") for name in ("whole", "a")))


def test_the_state_of_a_finished_render_is_there_before_its_image(lamp, tmp_path, monkeypatch):
    """The denoiser may fail, or the user ends the process while it works."""
    with monkeypatch.context() as patch:
        patch.setattr(render_task, "finished_image", lambda *_: 1 / 0)
        assert prosim("render", lamp, "-o", tmp_path / "a", "--checkpoint", "--spp", 4).exit_code != 0
    assert "The render was finished before." in done("resume", tmp_path / "a.state.npz").stdout


@pytest.mark.slow
def test_another_target_and_another_place(lamp, tmp_path):
    done("render", lamp, "-o", tmp_path / "a", "--checkpoint")
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    lamp.rename(moved / "lamp.xml")
    refused("scene.xml does not exist, nor does the folder of", "resume", tmp_path / "a.state.npz")
    report = done("resume", tmp_path / "a.state.npz", "--noise", 0.02, "--scene", moved / "lamp.xml", "-o", moved / "b")
    assert re.search(r"error 0\.0\d+ of 0\.02", report.stdout)
    third = moved.rename(tmp_path / "third")  # beside the state it is found
    report = done("resume", third / "b.state.npz", "--max-samples", 400, "--noise", 1e-9)
    assert "maximum number of samples per pixel, 400" in report.stdout


@pytest.mark.slow
@pytest.mark.parametrize("first, reached, then, target", [("noise", 0.5, "time", 4), ("time", 0.01, "noise", 0.003)])
def test_limit_of_the_scene_that_is_reached_does_not_end_a_render_with_another(
    write_scene, tmp_path, first, reached, then, target
):
    limit = f'type="prosim_adaptive"><float name="{first}" value="{reached}"/><string name="adaptive" value="graded"/>'
    scene = write_scene(LAMP.replace('type="prosim_adaptive">', limit), "limit.xml")
    done("render", scene, "--checkpoint")
    before = float(metadata(scene)["samples"])
    for _ in range(2):
        done("resume", tmp_path / "limit.state.npz", f"--{then}", target)
        assert float(metadata(scene)["samples"]) > 2 * before


@pytest.mark.slow
def test_limit_that_is_reached_does_not_end_a_render_with_another(lamp, tmp_path):
    state = tmp_path / "a.state.npz"
    done("render", lamp, "-o", tmp_path / "a", "--checkpoint", "--time", 0.03)
    assert re.search(r"error \S+ of 0.001 \(95 %", done("resume", state, "--noise", 0.001).stdout)
    assert "400.0 samples a pixel" in done("resume", state, "--time", 1000, "--max-samples", 400).stdout


def test_resume_refuses_another_scene(lamp, tmp_path):
    state = tmp_path / "a.state.npz"
    done("render", lamp, "-o", tmp_path / "a", "--checkpoint", "--spp", 4)
    lamp.write_text(LAMP.replace('value="9"', 'value="8"', 1))
    refused("scene.xml is not the scene of this state", "resume", state)
    lamp.write_text(LAMP.replace("<scene", "<!-- the same --><scene", 1))
    assert "The render was finished before. To improve" in done("resume", state).stdout
    refused("is the state or a part of a render; continue it by prosim resume", "render", state)
    refused("is the state of a whole image, not a part of one; continue it by prosim resume", "merge", state)
    saved, here = checkpoint.load(state), environment.this_environment()
    for other, says in [
        ({"environment": here | {"mitsuba-prosim": "0.0.9"}}, "mitsuba-prosim 0.0.9 there"),
        ({"environment": here | {"variant": "llvm_other"}}, "llvm_other"),
        ({"about": {}}, "prosim render did not write this state"),
    ]:
        checkpoint.save(replace(saved, **other), state)
        refused(says, "resume", state)


def test_noise_of_the_scene_with_a_part(lamp):
    lamp.write_text(LAMP.replace('"path"/>', '"path"/><float name="noise" value="0.1"/>'))
    refused("limits noise and time", "render", lamp, "--part", "1/2")


@pytest.mark.slow
def test_parts_make_the_image_and_it_is_continued(lamp, tmp_path, monkeypatch):
    every = ["--adaptive", "none"]
    done("render", lamp, "-o", tmp_path / "whole", *every)
    for number in (1, 2, 3):
        report = done("render", lamp, "-o", tmp_path / "a b", "--part", f"{number}/3", *every).stdout
        assert report.startswith(f"{tmp_path}/a b.{number}-of-3.npz: part {number} of 3, 32 x 24 pixels")
    first, second, third = parts = [tmp_path / f"a b.{number}-of-3.npz" for number in (1, 2, 3)]
    assert not (tmp_path / "a b.exr").exists()
    refused("of 3 parts, these are missing: 2", "merge", first, third)
    assert f"can be removed: {tmp_path}/a b.state.npz" in done("merge", third, first, second, "--checkpoint").stdout
    assert alike(tmp_path / "whole", tmp_path / "a b")
    # All that a small noise begins with is in the parts.
    options = "--noise", 2e-4, "--adaptive", "graded"
    report = done("resume", tmp_path / "a b.state.npz", "-o", tmp_path / "on", *options)
    assert re.search(r"error \S+ of 0.0002 .*, ([3-9]\d|\d{3,})\.\d samples", report.stdout)
    refused("all parts of an image have one target", "resume", second, "--noise", 0.01)
    with monkeypatch.context() as patch:
        die_after(patch, 2)
        assert prosim("render", lamp, "-o", tmp_path / "a b", "--part", "2/3", *every).exit_code != 0
    refused("a b.2-of-3.npz is not finished", "merge", *parts)
    done("resume", second)
    assert "When all parts are finished, prosim merge" in done("resume", second).stdout
    assert "can be removed, unless" in done("merge", *parts, "-o", tmp_path / "b").stdout
    assert alike(tmp_path / "whole", tmp_path / "b")
    done("render", lamp, "-o", tmp_path / "few", *every, "--spp", 4, "--checkpoint")
    assert "samples a pixel" in done("resume", tmp_path / "few.state.npz", "--noise", 0.0005).stdout
