"""``prosim render --noise`` and ``--time``, with any integrator."""

import math
import re
import signal
import subprocess
import sys
import time

import mitsuba as mi
import numpy as np
import pytest
from running import ADAPTIVE_PATH, LIT_FLOOR, NOISY, PATH, at_step, done, metadata, pixels, prosim, refused, scene_text


@pytest.mark.parametrize(
    "integrator, wrapped",
    [
        (PATH, "path"),
        ('<integrator type="aov"><string name="aovs" value="d:depth"/><integrator type="direct"/></integrator>', "aov"),
        ('<integrator type="prosim"/>', None),
        (ADAPTIVE_PATH, None),
        ("", "path"),
    ],
)
def test_noise_with_any_integrator(scene, integrator, wrapped):
    scene.write_text(scene_text(integrator, LIT_FLOOR))
    printed, found = done("render", scene, "--noise", 0.02).stdout, metadata(scene)
    assert f"{wrapped} within prosim_adaptive" in printed if wrapped else "within" not in printed
    assert float(found["noise"]) <= 0.02 and found["ended"] == "noise" and "adaptive = graded" in found["integrator"]
    assert f" of 0.02, {float(found['samples']):.1f} samples a pixel" in printed


def test_the_report_says_what_ended_it(scene):
    scene.write_text(NOISY)
    for options, ended, says in [
        (["--noise", 1e-6, "--max-samples", 50], "samples", "ended by the maximum number of samples per pixel, 50"),
        (["--noise-99", 0.2, "--noise", 0.1], "noise", ", that of 99 pixels in 100 0."),
        (["--noise", 1e-6, "--time", 0.2], "time", "s of 0.2, ended by the time"),
    ]:
        assert says in done("render", scene, *options).stdout and metadata(scene)["ended"] == ended


def test_time_alone_says_what_the_noise_is_at_most(scene, variant_rgb):
    """It is about what N-rook samples come to in the end, or some times as much, and never known from one sample."""
    scene.write_text(NOISY)
    printed = done("render", scene, "--time", 1000, "--max-samples", 20).stdout
    assert re.search(r"\nnoise at most about 0\.0\d+ .*, 20\.0 samples a pixel", printed)
    loaded = mi.load_string(scene_text(ADAPTIVE_PATH, LIT_FLOOR))
    integrator = loaded.integrator()
    integrator.noise, integrator.adaptive = 0.001, "graded"
    render = integrator.progressive(loaded).run()
    assert 0.9 < render.noise_bound() / render.reached.noise < 10
    integrator.noise, integrator.adaptive = 0, "none"
    render = integrator.progressive(loaded, spp=1).run()
    assert math.isnan(render.noise_bound())


def test_integrators_that_can_not_measure_the_noise(scene):
    scene.write_text(scene_text('<integrator type="ptracer"/>'))
    refused("one integrator that takes samples from a sensor", "render", scene, "--noise", 0.1)
    scene.write_text(scene_text('<integrator type="prosim"><float name="noise" value="0.1"/></integrator>'))
    refused("noise: scalar_rgb", "render", scene, "-m", "scalar_rgb")


def test_a_signal_after_the_first_pass_leaves_a_whole_image(scene, monkeypatch):
    steps = at_step(monkeypatch, 3, signal.SIGINT)
    scene.write_text(NOISY)
    result = prosim("render", scene, "--noise", 1e-5)
    assert result.exit_code == 1 and ", interrupted\n" in result.stdout, result.output
    assert metadata(scene)["ended"] == "interrupted" and steps == sorted(steps)
    assert pixels(scene.with_suffix(".exr")).max(axis=2).min() > 0


#: The command, which writes its checkpoint often.
OFTEN = """if True:
    from mitsuba_prosim.engine.checkpoint import CheckpointWriter
    from prosim_start import main
    CheckpointWriter.SHORTEST = 0.1
    main()"""


@pytest.mark.slow
def test_a_signal_is_heard_within_seconds_in_a_long_pass(scene):
    scene.write_text(scene_text(content=LIT_FLOOR, width=512, height=512))
    with subprocess.Popen(
        [sys.executable, "-c", OFTEN, "render", scene, "--noise", "1e-5", "-t", "1", "--checkpoint"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        end = time.monotonic() + 60
        while not scene.with_suffix(".state.npz").exists() and time.monotonic() < end:
            time.sleep(0.1)  # until it is at work, and has kept what there is
        process.send_signal(signal.SIGINT)
        printed, _ = process.communicate(timeout=10)
    assert process.returncode == 1 and b", interrupted\n" in printed
    assert pixels(scene.with_suffix(".exr")).max(axis=2).min() > 0


def test_snapshots_are_images_of_one_render(scene):
    """Their own error and counts are in the metadata; the last image is that of a render without them."""
    scene.write_text(NOISY)
    done("render", scene, "--noise", 0.0001, "-o", scene.with_name("alone"))
    done("render", scene, "--snapshots", "0.001,0.0002,0.0001")
    snapshots = {noise: scene.with_name(f"scene.{noise}.exr") for noise in ("0.001", "0.0002", "0.0001")}
    found = {noise: metadata(path) for noise, path in snapshots.items()}
    assert all(float(found[noise]["noise"]) <= float(noise) for noise in found)
    counts = [float(header["samples"]) for header in found.values()]
    assert counts == sorted(counts) and counts[0] < counts[-1]
    for name in "alone.exr", "scene.0.0001.exr":
        assert np.array_equal(pixels(scene.with_suffix(".exr")), pixels(scene.with_name(name)))
