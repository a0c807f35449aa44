"""``prosim render --keep`` and ``--part``, ``prosim resume`` and ``prosim merge``."""

import errno
import json
import os
import random
import re
import subprocess
import sys

import numpy as np
import OpenEXR
import pytest
from mitsuba_prosim import atomic
from mitsuba_prosim.cli import resume
from mitsuba_prosim.engine import origin
from mitsuba_prosim.engine.checkpoint import Checkpoint, CheckpointWriter
from running import names, pixels, prosim
from test_render_targets import NOISY

LAMP = (
    NOISY.replace(
        '"path"/>', '"prosim_adaptive"><integrator type="path"/><integer name="band" value="100"/></integrator>'
    )
    .replace('"12"', '"32"')
    .replace('"8"', '"24"')
)


@pytest.fixture
def lamp(scene):
    scene.write_text(LAMP)
    return scene


def done(*arguments):
    result = prosim(*arguments)
    assert result.exit_code == 0, result.output
    return result


def change(path, **values):
    """Other facts of a checkpoint."""
    with np.load(path) as archive:
        contents = dict(archive)
    contents["facts"] = np.array(json.dumps(json.loads(str(contents["facts"])) | values))
    with open(path, "wb") as file:
        np.savez(file, **contents)


def refused(says, *arguments):
    before = names(arguments[1].parent)
    result = prosim(*arguments)
    assert result.exit_code == 2 and re.search(says, result.stderr), result.output
    assert "Traceback" not in result.output and names(arguments[1].parent) == before


def alike(*paths):
    first, *others = (
        (path.with_suffix(".png").read_bytes(), pixels(path.with_suffix(".exr")).tobytes()) for path in paths
    )
    return all(first == other for other in others)


def stop_within(monkeypatch, portions):
    """The process dies after so many portions, as far as the files are concerned: the state of each is written."""
    monkeypatch.setattr(CheckpointWriter, "SHORTEST", 0.0)
    monkeypatch.setattr(CheckpointWriter, "SHARE", 1e9)
    keep, left = CheckpointWriter.__call__, [portions]

    def call(self, render, last=False):
        keep(self, render, last)
        left[0] -= 1
        if left[0] == 0:
            raise KeyboardInterrupt

    monkeypatch.setattr(CheckpointWriter, "__call__", call)


@pytest.mark.parametrize("options", [pytest.param((), marks=pytest.mark.slow), ("--noise", 0.02)])
def test_a_render_that_has_died_goes_on(lamp, tmp_path, monkeypatch, options):
    done("render", lamp, "-o", tmp_path / "whole", *options)
    with monkeypatch.context() as patch:
        stop_within(patch, 3)
        assert prosim("render", lamp, "-o", tmp_path / "a", "--keep", *options).exit_code != 0
    state = tmp_path / "a.state.npz"
    assert state.exists() and not (tmp_path / "a.exr").exists()
    done("resume", state)
    done("resume", state, "-o", tmp_path / "again", "--exposure", 0)
    assert alike(tmp_path / "whole", tmp_path / "a", tmp_path / "again")
    assert names(tmp_path)[-1] == "whole.png" and (tmp_path / "again.state.npz").exists()


@pytest.mark.slow
def test_another_aim_and_another_place(lamp, tmp_path):
    done("render", lamp, "-o", tmp_path / "a", "--keep")
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    lamp.rename(moved / "lamp.xml")
    refused("scene.xml is not there any more, nor beside", "resume", tmp_path / "a.state.npz")
    said = done("resume", tmp_path / "a.state.npz", "--noise", 0.02, "--scene", moved / "lamp.xml", "-o", moved / "b")
    assert re.search(r"noise 0\.0\d+ of 0\.02", said.stdout)
    third = moved.rename(tmp_path / "third")  # beside the state it is found
    said = done("resume", third / "b.state.npz", "--max-samples", 400, "--noise", 1e-9)
    assert "most samples that a pixel may have, 400" in said.stdout
    done("resume", third / "b.state.npz", "--max-samples", 4000, "--time", 0.1)
    refused("the 0.1 s that were asked for before are used up", "resume", third / "b.state.npz", "--noise", 1e-9)


def test_what_does_not_belong_together_is_refused(lamp, tmp_path):
    state = tmp_path / "a.state.npz"
    done("render", lamp, "-o", tmp_path / "a", "--keep")
    lamp.write_text(LAMP.replace('value="9"', 'value="8"', 1))
    refused("scene.xml is not what the state was made of", "resume", state)
    lamp.write_text(LAMP.replace("<scene", "<!-- the same --><scene", 1))
    assert "It was finished before." in done("resume", state).stdout
    refused("is an EXR image, not the state of a render. Did you mean .*a.state.npz?", "resume", tmp_path / "a.exr")
    refused("the state of a render, not a scene. To go on with it: prosim resume ", "render", state)
    refused("is the state of a whole image", "merge", state)
    for name, value, says in [
        ("origin", origin.here() | {"mitsuba-prosim": "0.0.9"}, "mitsuba-prosim 0.0.9 there"),
        ("origin", origin.here() | {"variant": "llvm_other"}, "llvm_other"),
        ("about", {}, "was not kept by prosim render"),
    ]:
        done("render", lamp, "-o", tmp_path / "a", "--keep")
        change(state, **{name: value})
        refused(says, "resume", state)
    OpenEXR.File({"prosim.state": "{}"}, {"R": np.zeros((2, 2), np.float32)}).write(str(state))
    refused("was written by an older version", "resume", state)


@pytest.mark.parametrize(
    "noise, asked, options",
    [
        (float("nan"), {}, "--time 25"),
        (float("nan"), {"time": 12.5, "max_samples": 16}, "--time 25 --max-samples 64"),
        (0.0019, {"noise": 0.002}, "--noise 0.00095"),
        (0.0041, {"noise": 0.002, "time": 12.5}, "--noise 0.001 --time 25"),
    ],
)
def test_what_takes_a_finished_image_further(noise, asked, options):
    sampling = {"noise": 0.0, "time": 0.0, "max_samples": 0} | asked
    assert resume.further(Checkpoint({"noise": [noise], "seconds": 12.5, "sampling": sampling}, {}, {})) == options


@pytest.mark.parametrize(
    "options, says",
    [
        (["--keep", "-m", "scalar_rgb"], "--keep: scalar_rgb"),
        (["--part", "1/2", "-m", "scalar_rgb"], "--part: scalar_rgb"),
        (["--part", "1/2", "--time", "2"], "go by the whole image"),
        (["--part", "3/2"], "K is 1 to M"),
        (["--part", "3"], "not of the form K/M"),
        (["--keep"], "this scene's integrator is PathIntegrator. Say how it should be sampled"),
    ],
)
def test_wrong_use(scene, options, says):
    refused(re.escape(says), "render", scene, *options)


def test_noise_that_the_scene_asks_a_part_for(lamp):
    lamp.write_text(LAMP.replace('"path"/>', '"path"/><float name="noise" value="0.1"/>'))
    refused("go by the whole image", "render", lamp, "--part", "1/2")


def test_parts_make_the_image_and_it_goes_on(lamp, tmp_path, monkeypatch):
    every = ["--adaptive", "none"]
    done("render", lamp, "-o", tmp_path / "whole", *every)
    for number in (1, 2, 3):
        said = done("render", lamp, "-o", tmp_path / "a", "--part", f"{number}/3", *every)
        assert said.stdout.startswith(f"{tmp_path}/a.{number}-of-3.npz: part {number} of 3, 32 x 24 pixels")
    first, second, third = parts = [tmp_path / f"a.{number}-of-3.npz" for number in (1, 2, 3)]
    assert not (tmp_path / "a.exr").exists()
    refused("of 3 parts, part 2 is missing", "merge", first, third)
    said = done("merge", third, first, second, "--keep").stdout
    assert said.endswith(
        f"The 3 parts can be removed: all that is known of the image is in {tmp_path}/a.state.npz as well.\n"
    )
    assert alike(tmp_path / "whole", tmp_path / "a")
    # All that a small noise begins with is in the parts.
    said = done("resume", tmp_path / "a.state.npz", "-o", tmp_path / "on", "--noise", 0.00005, "--adaptive", "graded")
    assert re.search(r"noise \S+ of 5e-05", said.stdout)
    refused("all parts of an image are to have one aim", "resume", second, "--noise", 0.01)
    with monkeypatch.context() as patch:
        stop_within(patch, 2)
        assert prosim("render", lamp, "-o", tmp_path / "a", "--part", "2/3", *every).exit_code != 0
    refused("a.2-of-3.npz is not finished", "merge", *parts)
    done("resume", second)
    said = done("resume", second).stdout
    assert f"It was finished before. When all parts are: prosim merge {tmp_path}/a.*-of-3.npz\n" in said
    said = done("merge", *parts, "-o", tmp_path / "b").stdout
    assert "The 3 parts can be removed, unless the image is to be continued: prosim merge --keep" in said
    assert alike(tmp_path / "whole", tmp_path / "b")


def test_a_disk_that_is_full(lamp, tmp_path_factory, monkeypatch):
    """The render goes on without its state, which is kept where there is room in the end."""
    write, elsewhere = atomic.write, tmp_path_factory.mktemp("elsewhere")

    def full(contents):
        path = next(iter(contents))
        if path.name.endswith(".state.npz") and path.parent == lamp.parent:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        return write(contents)

    monkeypatch.setattr(CheckpointWriter, "SHORTEST", 0.0)
    monkeypatch.setattr(atomic, "write", full)
    monkeypatch.setattr(atomic.tempfile, "tempdir", str(elsewhere))
    result = prosim("render", lamp, "--keep")
    assert result.exit_code == 1 and result.stderr.count("the render goes on") == 1
    (folder,) = elsewhere.iterdir()
    assert f"The result is in {folder / 'scene.state.npz'}" in result.stderr
    assert names(lamp.parent) == ["scene.exr", "scene.png", "scene.xml"]
    done("resume", folder / "scene.state.npz", "-o", folder / "b")
    assert alike(lamp, folder / "b")


#: States are written more often than usual, so that something is there to go on with.
HURRIED = (
    "from mitsuba_prosim.engine.checkpoint import CheckpointWriter as W; W.SHORTEST, W.SHARE = 0.1, 1; "
    "from prosim_start import main; main()"
)


@pytest.mark.slow
def test_killed_at_any_moment_and_gone_on_with(lamp, tmp_path):
    """By the signal that none can handle."""
    lamp.write_text(LAMP.replace('"32"', '"128"').replace('"24"', '"128"'))
    aim, state = ["--noise", "0.006"], tmp_path / "a.state.npz"
    done("render", lamp, "-o", tmp_path / "whole", *aim)
    chance, killed = random.Random(1), 0
    while True:
        arguments = ["resume", state] if state.exists() else ["render", lamp, "--keep", "-o", tmp_path / "a", *aim]
        command = [sys.executable, "-c", HURRIED, *map(str, arguments)]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
            try:
                assert process.wait(timeout=chance.uniform(1, 2) if killed < 2 else 100) == 0
                break
            except subprocess.TimeoutExpired:
                process.kill()
                killed += 1
    assert killed >= 1 and alike(tmp_path / "whole", tmp_path / "a")
