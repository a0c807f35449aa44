"""``prosim render``: where its images go, and what of them is kept when something goes wrong."""

import errno
import os
import re
import signal
import subprocess
import sys
import time

import mitsuba as mi
import numpy as np
import pytest
from mitsuba_prosim import atomic
from mitsuba_prosim.cli import files
from mitsuba_prosim.cli.interrupts import interruptible
from mitsuba_prosim.engine.plan import Plan
from mitsuba_prosim.scene import rendering
from running import at_step, done, metadata, names, pixels, prosim, refused, scene_text


@pytest.mark.parametrize(
    "given, stem",
    [
        *[(f"a.b{suffix}", "a.b") for suffix in ("", ".exr", ".png", ".EXR")],
        ("x.exr.png", "x"),
        ("x.", "x"),
        ("x.y.", "x.y"),
        ("there", "there/c.d"),
        ("new/", "new/c.d"),
        (None, "c.d"),
    ],
)
def test_names_of_images(tmp_path, monkeypatch, given, stem):
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "there").mkdir()
    for place in tmp_path, "~":
        found = files.output_stem(given and f"{place}/{given}", tmp_path / "c.d", (".exr", ".png"))
        assert found == tmp_path / stem


@pytest.mark.parametrize(
    "command, given, says",
    [
        ("render", "", "expected a name or a folder"),
        ("translate", "", "expected a name or a folder"),
        ("render", "{}/x.jpg", ".exr and .png"),
        *[("render", "{}/other" + suffix, ".exr and .png") for suffix in (".scn", ".npz")],
        ("render", "{}/pipe", ".exr and .png"),
        ("render", "-", ".exr and .png"),
        ("compare", "{}/x.png", ".html and .json"),
        ("translate", "{}/pal.xml", "give a folder"),
        ("translate", "{}/" + "a" * 260, "File name too long"),
        ("render", "/proc/image", "No such file"),
        *[("render", "{}/" + name, "too long") for name in ("a" * 252, "é" * 126)],
        ("render", "{}/listing.scn/a", "Not a directory"),
    ],
)
def test_wrong_places(palito, monkeypatch, command, given, says):
    """They are found before the render."""
    monkeypatch.setattr(rendering, "progressive", lambda *_, **__: pytest.fail("has rendered"))
    os.mkfifo(palito.with_name("pipe"))
    refused(says, command, palito, "-o", given.format(palito.parent))


def test_a_device_is_not_overwritten(palito):
    """By an image or a translation, whose names lead to it."""
    pipe = palito.with_name("pipe")
    os.mkfifo(pipe)
    for name in ("listing.png", "listing.xml"):
        palito.with_name(name).symlink_to(pipe)
    for command in ("render", "translate"):
        refused("this is a device or a pipe, not a file", command, palito)
    assert pipe.is_fifo()


def test_no_input_is_overwritten(palito, variant_rgb):
    """The scene, and a picture under its name."""
    scene = palito.rename(palito.with_name("scene.png"))
    refused(f"{scene} is an input of this command", "render", scene)
    scene.rename(palito)
    sky = palito.with_name("listing.png")
    mi.Bitmap(np.full((2, 4, 3), 9, np.uint8)).write(str(sky))
    palito.write_text(re.sub("(BACKGROUND:.*) NULL", r"\1 listing.png", palito.read_text()))
    refused(f"{sky} is an input of this command", "render", palito)


def test_an_image_is_rescued_from_a_full_disk(scene, monkeypatch, tmp_path_factory):
    write, elsewhere = atomic.write, tmp_path_factory.mktemp("elsewhere")

    def full(contents):
        if next(iter(contents)).parent == scene.parent:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(scene.parent))
        return write(contents)

    monkeypatch.setattr(atomic, "write", full)
    monkeypatch.setattr(atomic.tempfile, "tempdir", str(elsewhere))
    scene.write_text(BANDS)
    result = prosim("render", scene, "--checkpoint")
    assert result.exit_code == 1 and "No space left on device" in result.stderr
    folder = next(path for path in elsewhere.iterdir() if path.name.startswith(atomic.RESCUE))
    assert names(folder) == ["scene.exr", "scene.png", "scene.state.npz"] and str(folder / "scene.exr") in result.stderr
    assert pixels(folder / "scene.exr").shape == (8, 12, 3)


BANDS = scene_text(
    '<integrator type="prosim"><integer name="samples" value="2"/><integer name="band" value="48"/></integrator>'
)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_keeps_the_image_so_far(scene, monkeypatch, number):
    at_step(monkeypatch, 1, number)
    scene.write_text(BANDS)
    before = signal.getsignal(number)
    result = prosim("render", scene)
    assert result.exit_code == 1 and "interrupted\n" in result.stdout
    assert signal.getsignal(number) is before
    image = pixels(scene.with_suffix(".exr"))
    assert image[0].min() > 0 and image[-1].min() > 0
    assert float(metadata(scene)["samples"]) < 2  # in the last rows one


def test_a_signal_before_the_first_sample_writes_nothing(scene, monkeypatch):
    """It comes while the render is prepared, and is not forgotten when it begins."""
    made = Plan.of

    def interrupted(*arguments):
        os.kill(os.getpid(), signal.SIGINT)
        return made(*arguments)

    monkeypatch.setattr(Plan, "of", interrupted)
    scene.write_text(BANDS)
    refused("Interrupted before the first sample", "render", scene, code=130)


def test_stop_is_called_again_until_the_end(monkeypatch, capfd):
    """A renderer forgets it that has not begun yet. Who sits at a terminal sees one line."""
    monkeypatch.setattr(os, "isatty", lambda _: True)
    calls = []
    with interruptible(lambda: calls.append(True)):
        os.kill(os.getpid(), signal.SIGINT)
        first = len(calls)
        deadline = time.monotonic() + 10
        while len(calls) < first + 3 and time.monotonic() < deadline:
            time.sleep(0.01)
    assert len(calls) >= first + 3
    assert capfd.readouterr().err.count("once more") == 1


@pytest.mark.parametrize("number, handler", [(signal.SIGHUP, signal.SIG_IGN), (signal.SIGUSR1, lambda *_: None)])
def test_ignored_and_other_signals_stop_nothing(scene, monkeypatch, number, handler):
    steps = at_step(monkeypatch, 1, number)
    scene.write_text(BANDS)
    before = signal.signal(number, handler)
    try:
        done("render", scene)
    finally:
        signal.signal(number, before)
    assert len(steps) > 1 and float(metadata(scene)["samples"]) >= 2


@pytest.mark.slow
def test_a_signal_is_heard_while_mitsubas_own_integrator_renders(scene):
    """It holds up Python's signal handlers until it is done, which would take minutes."""
    scene.write_text(scene_text(width=512, height=512, sampler="independent", spp=65536))
    with subprocess.Popen(
        [sys.executable, "-m", "prosim_start", "render", scene, "-m", "scalar_rgb", "-v"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        for line in process.stderr:
            if b"Starting render job" in line:
                break
        process.send_signal(signal.SIGTERM)
        printed, _ = process.communicate(timeout=60)
    assert process.returncode == 1 and printed.endswith(b"interrupted\n")
    assert names(scene.parent) == ["scene.exr", "scene.png", "scene.xml"]
