"""``prosim render`` until the noise is small enough or the time is up, with any integrator."""

import math
import os
import re
import signal
import subprocess
import sys
import time

import mitsuba as mi
import OpenEXR
import pytest
from mitsuba_prosim.cli import progress
from running import XML, pixels, prosim

#: A lamp over a floor: an image with noise.
NOISY = XML.replace(
    '<emitter type="constant"><rgb name="radiance" value="$radiance"/></emitter>',
    """<shape type="rectangle"><transform name="to_world">
        <rotate y="1" angle="180"/><scale value="9"/><translate z="4"/></transform></shape>
    <shape type="sphere"><point name="center" x="1.5" y="1" z="2"/><float name="radius" value="0.3"/>
        <emitter type="area"><rgb name="radiance" value="9"/></emitter></shape>""",
)


def facts(path):
    header = OpenEXR.File(str(path.with_suffix(".exr")), header_only=True).header()
    return {name[7:]: value for name, value in header.items() if name.startswith("prosim.")}


@pytest.mark.parametrize(
    "integrator, wrapped",
    [
        ('"path"/>', "path"),
        ('"aov"><string name="aovs" value="d:depth"/><integrator type="direct"/></integrator>', "aov"),
        ('"prosim"/>', None),
        ('"prosim_adaptive"><integrator type="path"/></integrator>', None),
        (None, "path"),
    ],
)
def test_noise_with_any_integrator(scene, integrator, wrapped):
    own = '<integrator type="path"/>'
    scene.write_text(NOISY.replace(own, f"<integrator type={integrator}" if integrator else ""))
    done = prosim("render", scene, "--noise", 0.02)
    assert done.exit_code == 0, done.output
    assert f"{wrapped} within prosim_adaptive" in done.stdout if wrapped else "within" not in done.stdout
    said = facts(scene)
    assert float(said["noise"]) <= 0.02 and said["ended"] == "noise" and "adaptive = graded" in said["integrator"]
    assert f" of 0.02, {float(said['samples']):.1f} samples a pixel" in done.stdout


def test_what_ended_it_is_said(scene):
    scene.write_text(NOISY)
    for options, ended, says in [
        (["--noise", 1e-6, "--max-samples", 50], "samples", "ended by the most samples that a pixel may have, 50"),
        (["--noise-99", 0.2, "--noise", 0.1], "noise", ", that of 99 pixels in 100 0."),
        (["--noise", 1e-6, "--time", 2], "time", "s of 2, ended by the time"),
    ]:
        done = prosim("render", scene, *options)
        assert done.exit_code == 0 and says in done.stdout and facts(scene)["ended"] == ended


def test_time_alone_says_what_the_noise_is_at_most(scene, variant_rgb):
    """It is about what N-rook samples come to in the end, or some times as much, and never known from one sample."""
    scene.write_text(NOISY)
    done = prosim("render", scene, "--time", 1000, "--max-samples", 20)
    assert done.exit_code == 0, done.output
    assert re.search(r"\nnoise at most about 0\.0\d+ \(--noise measures it\), 20\.0 samples a pixel", done.stdout)
    loaded = mi.load_string(NOISY.replace('"path"/>', '"prosim_adaptive"><integrator type="path"/></integrator>'))
    integrator = loaded.integrator()
    integrator.noise, integrator.adaptive = 0.001, "graded"
    render = integrator.progressive(loaded).run()
    assert 0.9 < render.noise_at_most() / render.reached.noise < 10
    integrator.noise, integrator.adaptive = 0, "none"
    render = integrator.progressive(loaded, spp=1).run()
    assert math.isnan(render.noise_at_most())


def test_an_integrator_that_takes_no_samples_from_a_sensor(scene):
    scene.write_text(NOISY.replace('"path"', '"ptracer"'))
    done = prosim("render", scene, "--noise", 0.1)
    assert done.exit_code == 2 and "ptracer can't be rendered within prosim_adaptive" in done.stderr
    assert "Traceback" not in done.output and not scene.with_suffix(".exr").exists()


def test_noise_that_the_scene_asks_a_scalar_variant_for(scene):
    scene.write_text(NOISY.replace('"path"/>', '"prosim"><float name="noise" value="0.1"/></integrator>'))
    done = prosim("render", scene, "-m", "scalar_rgb")
    assert done.exit_code == 2 and "noise: scalar_rgb" in done.stderr


def test_a_signal_after_the_first_wave_leaves_a_whole_image(scene, monkeypatch):
    told = []

    class Bar(progress.tqdm):
        def update(self, done):
            told.append(self.n + done)
            if len(told) == 3:
                os.kill(os.getpid(), signal.SIGINT)
            return super().update(done)

    monkeypatch.setattr(progress, "tqdm", Bar)
    monkeypatch.setattr(os, "_exit", lambda _: None)
    scene.write_text(NOISY)
    done = prosim("render", scene, "--noise", 1e-5)
    assert done.exit_code == 1 and "ended by a signal" in done.stdout, done.output
    assert facts(scene)["ended"] == "interrupted"
    assert pixels(scene.with_suffix(".exr")).max(axis=2).min() > 0
    assert told == sorted(told)


@pytest.mark.slow
def test_a_signal_is_heard_within_seconds_in_a_long_wave(scene):
    scene.write_text(NOISY.replace('"12"', '"512"').replace('"8"', '"512"'))
    with subprocess.Popen(
        [sys.executable, "-m", "prosim_start", "render", scene, "--noise", "1e-5", "-t", "1", "--keep"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        end = time.monotonic() + 60
        while not scene.with_suffix(".state.npz").exists() and time.monotonic() < end:
            time.sleep(0.1)  # until it is at work, and has kept what there is
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=10)
    assert process.returncode == 1 and b"ended by a signal" in said
    assert pixels(scene.with_suffix(".exr")).max(axis=2).min() > 0
