"""``prosim render``: where its images go, what is kept when something goes wrong, what ends it, why they are black."""

import errno
import math
import os
import re
import signal
import sys
from contextlib import ExitStack
from unittest import mock

import mitsuba as mi
import mitsuba_prosim
import numpy as np
import pytest
from mitsuba_prosim import atomic
from mitsuba_prosim.cli import files, render_task
from mitsuba_prosim.cli.terminal import interruptible
from mitsuba_prosim.engine.plan import Plan
from mitsuba_prosim.scene import rendering
from running import (
    ADAPTIVE_PATH,
    AOV,
    LIT_FLOOR,
    PATH,
    PIPES,
    at_step,
    done,
    metadata,
    names,
    pixels,
    prosim,
    refused,
    scene_text,
)
from tqdm import tqdm
from waiting import started, until


@pytest.mark.parametrize(
    "given, stem",
    [
        *[(f"a.b{suffix}", "a.b") for suffix in ("", ".exr", ".png", ".EXR")],
        *[("there", "there/c.d"), ("new/", "new/c.d"), (None, "c.d")],
    ],
)
def test_names_of_images(tmp_path, monkeypatch, given, stem):
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "there").mkdir()
    for place in tmp_path, "~":
        found = files.output_stem(given and f"{place}/{given}", tmp_path / "c.d", (".exr", ".png"))
        assert found == tmp_path / stem


@pytest.mark.slow
@pytest.mark.parametrize(
    "options, least",
    [((), 0.05), (("--denoise",), 0.5), (("--checkpoint",), 0.7), (("--checkpoint", "--denoise", "--noise", 0.5), 0.3)],
    ids=["image", "denoised", "state", "state in halves"],
)
def test_space_that_is_checked_suffices(write_scene, variant_rgb, monkeypatch, options, least):
    """And is not much more than the files need."""
    sizes, check = [], files.check
    monkeypatch.setattr(files, "check", lambda *how: (sizes.append(how[2]), check(*how)))
    integrator = ADAPTIVE_PATH.replace("100", "4000")
    scene = write_scene(scene_text(integrator, LIT_FLOOR, 128, 96, "independent", 2), "s.xml")
    done("render", scene, *options)
    written = sum(path.stat().st_size for path in scene.parent.iterdir() if path != scene)
    assert least * (sizes[0] - 2**16) < written < sizes[0]


@pytest.mark.parametrize(
    "command, given, says",
    [
        ("render", "", "give a name or a folder"),
        ("render", "{}/x.jpg", ".exr and .png"),
        ("render", "{}/other.npz", ".exr and .png"),
        *[("render", place, ".exr and .png") for place in ("{}/x.tga", "/dev/null", "-", "{}/pipe")],
        ("translate", "-", "give a folder"),
        ("compare", "{}/x.png", "for .html"),
        ("translate", "{}/pal.xml", "give a folder"),
        ("translate", "{}/" + "a" * 260, "File name too long"),
        ("render", "/proc/image", "No such file"),
        *[("render", "{}/" + name, "too long") for name in ("a" * 252, "é" * 126, "a" * 300)],
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
    assert set(os.listdir(folder)) == {"scene.exr", "scene.png", "scene.state.npz"}
    assert str(folder / "scene.exr") in result.stderr
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
    """It comes while the render is prepared, and is not forgotten when it begins; or before workers have a sample."""
    scene.write_text(BANDS)
    with monkeypatch.context() as patch:
        patch.setattr(Plan, "of", lambda *how, of=Plan.of: os.kill(os.getpid(), signal.SIGINT) or of(*how))
        refused("Interrupted before the first sample", "render", scene, code=130)
    at_step(monkeypatch, 3, signal.SIGINT)
    monkeypatch.setattr("mitsuba_prosim.engine.checkpoint.CheckpointWriter.SHORTEST", 0)
    monkeypatch.setattr("mitsuba_prosim.engine.work.Executor.__call__", lambda *_: (None for _ in range(9)))
    refused("Interrupted before the first sample", "render", scene, "--checkpoint", code=130)


def test_a_signal_while_resources_are_released_comes_too_late(scene, monkeypatch):
    released = ExitStack()
    released.callback(os.kill, os.getpid(), signal.SIGINT)
    monkeypatch.setattr(render_task, "log", lambda *_: released)
    done("render", scene)


def test_a_second_signal_ends_the_process_while_resources_are_released(scene, monkeypatch):
    """When the first one has ended the image (it was taken for the first one again)."""
    codes, released = [], ExitStack()
    released.callback(until, lambda: codes)
    released.callback(os.kill, os.getpid(), signal.SIGINT)
    monkeypatch.setattr(render_task, "log", lambda *_: released)
    at_step(monkeypatch, 1, signal.SIGINT)
    monkeypatch.setattr(os, "_exit", codes.append)
    scene.write_text(BANDS)
    prosim("render", scene)
    assert codes == [130]


def test_stop_is_called_again_until_the_end(monkeypatch, capfd):
    """A renderer forgets it that has not begun yet. Who sits at a terminal sees one line."""
    monkeypatch.setattr(os, "isatty", lambda _: True)
    calls = []
    with interruptible(lambda: calls.append(True)):
        os.kill(os.getpid(), signal.SIGINT)
        first = len(calls)
        until(lambda: len(calls) >= first + 3)
    assert capfd.readouterr().err.count("once more") == 1


@pytest.mark.parametrize("number, handler", [(signal.SIGHUP, signal.SIG_IGN), (signal.SIGUSR1, lambda *_: None)])
def test_ignored_signals_do_not_stop_the_render(scene, monkeypatch, number, handler):
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
    command = [sys.executable, "-m", "prosim_start", "render", scene, "-m", "scalar_rgb", "-v"]
    with started(command, **PIPES) as process:
        next(line for line in process.stderr if b"Starting render job" in line)
        process.send_signal(signal.SIGTERM)
        until(lambda: process.poll() is not None)
        assert process.returncode == 1 and process.stdout.read().endswith(b"interrupted\n")
    assert sorted(os.listdir(scene.parent)) == ["scene.exr", "scene.png", "scene.xml"]


# ---- --noise and --time, with any integrator


@pytest.fixture
def noisy(write_scene):
    """A lamp over a floor: an image with noise."""
    return write_scene(scene_text(content=LIT_FLOOR), "scene.xml")


@pytest.mark.parametrize(
    "integrator, wrapped", [(AOV.format('<integrator type="direct"/>'), "aov"), (ADAPTIVE_PATH, None)]
)
def test_noise_with_any_integrator(scene, integrator, wrapped):
    scene.write_text(scene_text(integrator, LIT_FLOOR))
    printed, found = done("render", scene, "--noise", 0.02).stdout, metadata(scene)
    assert f"{wrapped} within prosim_adaptive" in printed if wrapped else "within" not in printed
    assert float(found["noise"]) <= 0.02 and found["ended"] == "noise" and "adaptive = graded" in found["integrator"]
    bound = f"(95 %: below {float(found['noise_at_most']):.3g})"
    error = f"error {float(found['noise']):.2g} of 0.02 {bound}"
    assert f"{error}, {float(found['samples']):.1f} samples a pixel" in printed


def test_the_report_says_what_ended_it(noisy):
    for options, ended, says in [
        (["--noise", 1e-6, "--max-samples", 50], "samples", "ended by the maximum number of samples per pixel, 50"),
        (["--noise-99", 0.2, "--noise", 0.1], "noise", ", error of 99 % of the pixels 0."),
        (["--noise", 1e-6, "--time", 0.2], "time", "reached the time limit at error "),
    ]:
        assert says in done("render", noisy, *options).stdout and metadata(noisy)["ended"] == ended


def test_time_limit_reports_an_upper_bound_of_the_error(noisy, variant_rgb):
    """It is about what N-rook samples come to in the end, or some times as much, and never known from one sample."""
    printed = done("render", noisy, "--time", 1000, "--max-samples", 20).stdout
    assert re.search(r"\nerror at most about 0\.0\d+ .*, 20\.0 samples a pixel", printed)
    loaded = mi.load_string(scene_text(ADAPTIVE_PATH, LIT_FLOOR))
    integrator = loaded.integrator()
    integrator.noise, integrator.adaptive = 0.0002, "graded"
    render = integrator.progressive(loaded).run()
    assert 0.9 < render.noise_bound() / render.reached.noise < 10
    integrator.noise, integrator.adaptive = 0, "none"
    render = integrator.progressive(loaded, spp=1).run()
    assert math.isnan(render.noise_bound())


def test_integrators_that_can_not_measure_the_noise(scene):
    scene.write_text(scene_text('<integrator type="prosim"><float name="noise" value="0.1"/></integrator>'))
    refused("noise: scalar_rgb", "render", scene, "-m", "scalar_rgb")


def test_a_signal_after_the_first_pass_leaves_a_whole_image(noisy, monkeypatch):
    steps = at_step(monkeypatch, 3, signal.SIGINT)
    result = prosim("render", noisy, "--noise", 1e-5)
    assert result.exit_code == 1 and ", interrupted\nerror below " in result.stdout, result.output
    assert metadata(noisy)["ended"] == "interrupted" and steps == sorted(steps)
    assert pixels(noisy.with_suffix(".exr")).max(axis=2).min() > 0


@pytest.mark.slow
def test_snapshots_are_images_of_one_render(noisy):
    """Their own error and counts are in the metadata; the last image is that of a render without them."""
    done("render", noisy, "--noise", 0.0001, "-o", noisy.with_name("alone"))
    done("render", noisy, "--snapshots", "1,0.0002,0.0001")
    found = {noise: metadata(noisy.with_name(f"scene.{noise}.exr")) for noise in ("1", "0.0002", "0.0001")}
    assert all(float(found[noise]["noise"]) <= float(noise) for noise in found)
    counts = [float(header["samples"]) for header in found.values()]
    assert counts == sorted(counts) and counts[0] == 4  # of the first pass
    for name in "alone.exr", "scene.0.0001.exr":
        assert np.array_equal(pixels(noisy.with_suffix(".exr")), pixels(noisy.with_name(name)))
    ended = done("render", noisy, "--noise", 1, "--snapshots", "1,0.0000001")
    assert "--snapshots 0.0000001: not written, because the render ended earlier" in ended.stderr
    done("render", noisy, "--snapshots", "0.1s,0.2s")
    assert float(metadata(noisy.with_name("scene.0.2s.exr"))["seconds"]) > 0.195
    noisy.with_name("scene.3s.exr").mkdir()
    refused("scene.3s.exr: this is a folder", "render", noisy, "--snapshots", "3s,9s")


def test_snapshots_do_not_end_a_scene_with_a_limit(noisy):
    limit = '<integrator type="prosim_adaptive"><float name="noise" value="0.0001"/>'
    noisy.write_text(noisy.read_text("utf-8").replace(PATH, f"{limit}{PATH}</integrator>"), "utf-8")
    assert " of 0.0001 " in done("render", noisy, "--snapshots", 1).stdout
    assert float(metadata(noisy.with_name("scene.1.exr"))["samples"]) < float(metadata(noisy)["samples"])


def test_closed_terminal_ends_neither_an_image_nor_a_film(noisy, monkeypatch):
    """Messages cannot be written then; a second signal still ends the process."""
    monkeypatch.setattr(tqdm, "write", mock.Mock(side_effect=OSError(errno.EIO, "Input/output error")))
    done("render", noisy, "--noise", 1, "--snapshots", "0.0000001")
    noisy.write_text(scene_text().replace('value="0.5"', 'value="$frame"'))
    assert "2 of 2 frames rendered" in done("render", noisy, "--frames", "0:2").stdout
    assert tqdm.write.call_count == 4  # two warnings, as frame 0 is black, and two reports
    codes, write = [], os.write
    monkeypatch.setattr(os, "_exit", codes.append)
    monkeypatch.setattr(os, "write", lambda file, text: write(file if file > 2 else -1, text))
    with interruptible(lambda: None):
        for _ in range(2):
            os.kill(os.getpid(), signal.SIGTERM)
        until(lambda: codes)


# ---- Black pictures


DIM = """LIGHTS POINT position 9 9 9 Intensity 3 3 3
VIEW RESOLUTION 8 6 WINDOW -4 -3 4 3 OBS 0 0 10 VRP 0 0 0 CSG-TREE SPHERE 0 SURFACE 0 TRANSFORM 0 END"""


def test_a_picture_shown_brighter_is_not_black(tmp_path):
    (tmp_path / "scene.scn").write_text(DIM)
    command = ["render", tmp_path / "scene.scn", "--samples", 1, "--exposure"]
    said = done(*command, -9).output
    enough = re.search(r"the picture is black: its brightest value is .*--exposure (-?\d+) makes them bright", said)[1]
    assert "black" not in done(*command, enough).output
    (tmp_path / "scene.scn").write_text(DIM.replace("3 3 3", "300 300 300").replace("-4 -3 4 3", "-.8 -.6 .8 .6"))
    told = [done(*command, exposure, "--noise", 0.1).output for exposure in (0, 9, 17)]
    assert [re.findall("brighten|dim all", one) for one in told] == [["brighten"], [], ["dim all"]]


def test_what_makes_a_picture_black_has_its_name_in_the_scene(tmp_path):
    shaded = DIM.replace("9 9 9", "0 0 .5").replace("SPHERE 0 ", "\n+ SPHERE 0\nCUBE 1\n")
    (tmp_path / "scene.scn").write_text(shaded.replace("END", "SURFACE 1 TRANSFORM 1 TRANSLATE (2 -1 -5) END"))
    names = "such as that of SPHERE 0 (line 3), CUBE 1 (line 4): "
    assert names in done("render", tmp_path / "scene.scn", "--spp", 1).output
    assert names in mitsuba_prosim.render(tmp_path / "scene.scn", spp=1, progress=False).verdict


# ---- Links in the place of outputs


LAYERS = scene_text('<default name="frame" value="0"/><integrator type="prosim"/>', width="8", height="1$frame")


@pytest.fixture
def outside(tmp_path_factory):
    """A file outside of the scene's folder."""
    path = tmp_path_factory.mktemp("outside") / "rc"
    path.write_text("mine")
    return path


@pytest.mark.parametrize(
    "outputs, command",
    [
        ("scene.exr scene.png", ["render"]),
        ("scene.state.npz", ["render", "--checkpoint"]),
        ("scene.1-of-1.npz", ["render", "--part", "1/1"]),
        ("scene.9.exr", ["render", "--snapshots", "9"]),
        ("scene.0000.exr scene.0000.png", ["render", "--frames", "0"]),
        ("a-mix.exr", ["mix", "lamp1=0.5"]),
    ],
)
def test_link_in_the_place_of_an_output_is_replaced(scene, outside, outputs, command):
    """The link is replaced, and the file to which it leads stays."""
    scene.write_text(LAYERS)
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


def test_folder_of_outputs_may_be_a_link(scene, palito, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    (folder := scene.with_name("out")).symlink_to(elsewhere)
    done("render", scene, "-o", folder)
    done("translate", palito, "-o", folder)
    assert names(elsewhere) == ["listing-meshes", "listing.xml", "scene.exr", "scene.png"] and folder.is_symlink()


def test_link_to_a_missing_folder_is_found_before_the_render(scene, monkeypatch):
    monkeypatch.setattr(rendering, "progressive", lambda *_, **__: pytest.fail("has rendered"))
    scene.with_name("out").symlink_to("nowhere")
    for output in "out/a", "out/b/a":
        refused("this is a link that leads to no folder", "render", scene, "-o", scene.parent / output)
