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
import OpenEXR
import pytest
from mitsuba_prosim import atomic
from mitsuba_prosim.cli import output, progress
from mitsuba_prosim.cli.interrupts import interruptible
from mitsuba_prosim.engine.plan import Plan
from mitsuba_prosim.scene import rendering
from running import XML, names, pixels, prosim
from tqdm.auto import tqdm


@pytest.mark.parametrize("suffix", ["", ".exr", ".png"])
def test_output_names(scene, suffix):
    done = prosim("render", scene, "-o", scene.with_name("new") / f"a.b{suffix}")
    assert done.exit_code == 0, done.output
    assert names(scene.with_name("new")) == ["a.b.exr", "a.b.png"]


def test_output_folder(scene):
    (scene.parent / "there").mkdir()
    for folder in "there", "new/":
        assert prosim("render", scene, "-o", f"{scene.parent}/{folder}").exit_code == 0
        assert names(scene.parent / folder) == ["scene.exr", "scene.png"]


def test_names_that_are_nearly_ours(tmp_path, monkeypatch):
    """A name twice with a suffix, one that ends before it, and the user's folder, which no shell has put in."""
    monkeypatch.setenv("HOME", str(tmp_path))
    for given, name in (("x.exr.png", "x"), ("x.", "x"), ("x.y.", "x.y"), ("a.b.exr", "a.b")):
        assert output.stem(f"{tmp_path}/{given}", tmp_path / "scene", (".exr", ".png")) == tmp_path / name
        assert output.stem(f"~/{given}", tmp_path / "scene", (".exr", ".png")) == tmp_path / name


@pytest.mark.parametrize(
    "command, given, says",
    [
        ("render", "", "expected a name or a folder, found nothing"),
        ("translate", "", "expected a name or a folder, found nothing"),
        ("render", "{}/a/b/x", "there is no folder '{}/a'; one new folder is made"),
        ("translate", "{}/a/b", "there is no folder '{}/a'; one new folder is made"),
        ("compare", "{}/a/b/", "there is no folder '{}/a'; one new folder is made"),
    ],
)
def test_what_is_no_place_for_an_image(palito, command, given, says):
    done = prosim(command, palito, "-o", given.format(palito.parent))
    assert done.exit_code == 2 and says.format(palito.parent) in done.stderr
    assert names(palito.parent) == ["listing.scn"]


@pytest.mark.parametrize(
    "command, name, says",
    [
        ("render", "x.jpg", ".exr and .png, not .jpg"),
        ("render", "x.html", ".exr and .png"),
        ("render", "other.scn", ".exr and .png, not .scn"),
        ("render", "film.mp4", ".exr and .png, not .mp4"),
        ("compare", "x.png", ".html and .json and .csv, not .png"),
        ("translate", "pal.xml", "folder"),
    ],
)
def test_output_of_another_kind(palito, command, name, says):
    done = prosim(command, palito, "-o", palito.with_name(name))
    assert done.exit_code == 2 and says in done.stderr
    assert names(palito.parent) == ["listing.scn"]


def test_a_folder_whose_name_is_too_long(palito):
    done = prosim("translate", palito, "-o", palito.with_name("a" * 260))
    assert done.exit_code == 2 and "File name too long" in done.stderr


def test_the_scene_is_not_overwritten(palito):
    scene = palito.rename(palito.with_name("listing.png"))
    done = prosim("render", scene)
    assert done.exit_code == 2 and "is the scene itself" in done.stderr


@pytest.mark.parametrize("command", ["render", "compare"])
def test_what_is_no_name_of_an_image(palito, command):
    scene = palito.rename(palito.with_name("listing.pov"))
    pipe = palito.with_name("pipe")
    os.mkfifo(pipe)
    for given, says in ((scene, "this is the scene itself"), (pipe, "which are files"), ("-", "which are files")):
        done = prosim(command, scene, "-o", given)
        assert done.exit_code == 2 and says in done.stderr and "give their name, or a folder" in done.stderr
    assert names(palito.parent) == ["listing.pov", "pipe"]


def test_a_device_is_not_overwritten(palito):
    """By an image or a translation, whose names lead to it."""
    pipe = palito.with_name("pipe")
    os.mkfifo(pipe)
    for name in ("listing.png", "listing.xml"):
        palito.with_name(name).symlink_to(pipe)
    for command in ("render", "translate"):
        done = prosim(command, palito)
        assert done.exit_code == 2 and "this is a device or a pipe, not a file" in done.stderr
    assert pipe.is_fifo() and names(palito.parent) == ["listing.png", "listing.scn", "listing.xml", "pipe"]


def test_nothing_that_the_image_is_made_of_is_overwritten(palito, variant_rgb):
    """A picture under the scene's own name; a part, and a state, under that of the image."""
    sky = palito.with_name("listing.png")
    mi.Bitmap(np.full((2, 4, 3), 9, np.uint8)).write(str(sky))
    before = sky.read_bytes()
    palito.write_text(re.sub("(BACKGROUND:.*) NULL", r"\1 listing.png", palito.read_text()))
    options = ["--resolution", "16x16", "--samples", 1]
    done = prosim("render", palito, *options)
    assert done.exit_code == 2 and f"{sky} is what the image is made of" in done.stderr and sky.read_bytes() == before
    assert prosim("render", palito, *options, "--part", "1/1").exit_code == 0
    assert prosim("render", palito, *options, "--keep", "-o", palito.with_name("kept")).exit_code == 0
    for command, name in ("merge", "listing.1-of-1.npz"), ("resume", "kept.state.npz"):
        path = palito.with_name(name)
        before = path.read_bytes()
        done = prosim(command, path, "-o", path)
        assert done.exit_code == 2 and "not .npz" in done.stderr
        assert path.read_bytes() == before


@pytest.mark.parametrize(
    "place, says",
    [
        ("/proc/image", "/proc: no file of .* No such file"),
        ("a" * 252, "too long"),
        ("a" * 260, "too long"),
        ("é" * 126, "too long"),
        ("scene.xml/a", "not a folder"),
    ],
)
def test_what_cannot_be_written_is_found_before_the_render(scene, monkeypatch, place, says):
    monkeypatch.setattr(rendering, "progressive", lambda *_, **__: pytest.fail("has rendered"))
    done = prosim("render", scene, "-o", scene.parent / place)
    assert done.exit_code == 2 and re.search(says, done.stderr)
    assert names(scene.parent) == ["scene.xml"]


def test_an_image_that_cannot_be_written_after_all_is_kept(scene, monkeypatch, tmp_path_factory):
    """On a disk that has become full meanwhile, say."""
    write, elsewhere = atomic.write, tmp_path_factory.mktemp("elsewhere")

    def full(contents):
        if next(iter(contents)).parent == scene.parent:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(scene.parent))
        return write(contents)

    monkeypatch.setattr(atomic, "write", full)
    monkeypatch.setattr(atomic.tempfile, "tempdir", str(elsewhere))
    done = prosim("render", scene)
    assert done.exit_code == 1 and "No space left on device" in done.stderr
    folder = next(elsewhere.iterdir())
    assert names(folder) == ["scene.exr", "scene.png"] and str(folder / "scene.exr") in done.stderr
    assert pixels(folder / "scene.exr").shape == (8, 12, 3)


BANDS = XML.replace(
    '"path"/>', '"prosim"><integer name="samples" value="2"/><integer name="band" value="48"/></integrator>'
)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_keeps_the_image_so_far(scene, monkeypatch, number):
    """One that comes when the first band is done."""

    class Bar(tqdm):
        def update(self, done):
            os.kill(os.getpid(), number)
            return super().update(done)

    monkeypatch.setattr(progress, "tqdm", Bar)
    monkeypatch.setattr(os, "_exit", lambda _: None)  # there may be a second band
    scene.write_text(BANDS)
    before = signal.getsignal(number)
    done = prosim("render", scene)
    assert done.exit_code == 1 and "interrupted\n" in done.stdout
    assert signal.getsignal(number) is before
    image = pixels(scene.with_suffix(".exr"))
    assert image[0].min() > 0 and image[-1].min() > 0
    header = OpenEXR.File(str(scene.with_suffix(".exr")), header_only=True).header()
    assert float(header["prosim.samples"]) < 2  # in the last rows one


def test_a_signal_before_the_first_sample_writes_nothing(scene, monkeypatch):
    """It comes while the render is prepared, and is not forgotten when it begins."""
    made = Plan.of

    def interrupted(*arguments):
        os.kill(os.getpid(), signal.SIGINT)
        return made(*arguments)

    monkeypatch.setattr(Plan, "of", interrupted)
    scene.write_text(BANDS)
    done = prosim("render", scene)
    assert done.exit_code == 130 and "Interrupted before the image had begun" in done.stderr
    assert names(scene.parent) == ["scene.xml"]


def test_a_renderer_that_forgot_a_signal_is_told_again(monkeypatch, capfd):
    """And who sits at the terminal is told once that it was heard."""
    monkeypatch.setattr(os, "isatty", lambda _: True)
    calls = []
    with interruptible(lambda: calls.append(True)):
        os.kill(os.getpid(), signal.SIGINT)
        first = len(calls)
        deadline = time.monotonic() + 10
        while len(calls) < first + 3 and time.monotonic() < deadline:
            time.sleep(0.01)
    assert len(calls) >= first + 3
    assert capfd.readouterr().err == "\nEnding; once more ends it at once.\n"


def test_a_signal_that_is_ignored_stays_so(scene, monkeypatch):
    class Bar(tqdm):
        def update(self, done):
            os.kill(os.getpid(), signal.SIGHUP)
            return super().update(done)

    monkeypatch.setattr(progress, "tqdm", Bar)
    scene.write_text(BANDS)
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        done = prosim("render", scene)
    finally:
        signal.signal(signal.SIGHUP, before)
    assert done.exit_code == 0 and "interrupted" not in done.stdout
    assert pixels(scene.with_suffix(".exr")).min() > 0


def test_a_signal_that_another_handler_hears_stops_nothing(scene, monkeypatch):
    """Python tells of it by the same way as of those that end a render."""
    heard, stopped = [], []
    before = signal.signal(signal.SIGUSR1, lambda *_: heard.append(True))
    try:
        with interruptible(lambda: stopped.append(True)) as signals:
            os.kill(os.getpid(), signal.SIGUSR1)
        assert heard and not signals and not stopped

        class Bar(tqdm):
            def update(self, done):
                os.kill(os.getpid(), signal.SIGUSR1)
                return super().update(done)

        monkeypatch.setattr(progress, "tqdm", Bar)
        scene.write_text(BANDS)
        done = prosim("render", scene)
    finally:
        signal.signal(signal.SIGUSR1, before)
    assert done.exit_code == 0 and len(heard) > 1
    header = OpenEXR.File(str(scene.with_suffix(".exr")), header_only=True).header()
    assert float(header["prosim.samples"]) >= 2


def test_a_signal_is_heard_while_mitsubas_own_integrator_renders(scene):
    """It holds up Python's signal handlers until it is done, which would take minutes."""
    scene.write_text(
        XML.replace('"4"', '"65536"').replace('"12"', '"512"').replace('"8"', '"512"').replace("nrook", "independent")
    )
    with subprocess.Popen(
        [sys.executable, "-m", "prosim_start", "render", scene, "-m", "scalar_rgb", "-v"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        for line in process.stderr:
            if b"Starting render job" in line:
                break
        process.send_signal(signal.SIGTERM)
        said, _ = process.communicate(timeout=60)
    assert process.returncode == 1 and said.endswith(b"interrupted\n")
    assert names(scene.parent) == ["scene.exr", "scene.png", "scene.xml"]


def test_suffixes_that_are_no_kind_of_file(tmp_path):
    assert output.stem("a.b", tmp_path, (".exr",)).name == "a.b"
    assert output.stem("a.EXR", tmp_path, (".exr",)).name == "a"
    assert output.stem(None, tmp_path / "c.d", (".exr",)) == tmp_path / "c.d"
