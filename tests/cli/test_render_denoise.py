"""``prosim render --denoise``."""

import sys

import numpy as np
import OpenEXR
import pytest
from running import LIT_FLOOR, done, metadata, pixels, refused, scene_text

OURS = scene_text('<integrator type="prosim"><integer name="samples" value="4"/></integrator>', LIT_FLOOR)


def needs_oidn():
    pytest.importorskip("mitsuba_oidn", reason="mitsuba-oidn is not installed: pip install 'mitsuba-prosim[denoise]'")


def test_the_raw_image_is_never_lost(scene):
    needs_oidn()
    exr, png = scene.with_suffix(".exr"), scene.with_suffix(".png")
    scene.write_text(OURS.replace('<film type="hdrfilm">', '<film type="hdrfilm"><rfilter type="box"/>'))
    printed = done("render", scene, "--denoise", "--seed", 3).stdout
    assert "denoised: noise about" in printed and "box filter" not in printed
    file = OpenEXR.File(str(exr))
    channels = {name: channel.pixels for name, channel in file.channels().items()}
    assert set(channels) == {"RGB", "raw", "denoised", "error.Y", "error_raw.Y", "error_denoised.Y"}
    header = file.header()
    assert "Open Image Denoise" in header["prosim.denoised"]
    assert float(header["prosim.denoised.noise"]) < float(header["prosim.denoised.raw_noise"])
    assert float(header["prosim.samples"]) <= 18 and "samples = 4" in header["prosim.integrator"]
    assert np.isfinite(channels["RGB"]).all() and not np.array_equal(channels["RGB"], channels["raw"])
    before = png.read_bytes()
    assert b"prosim.denoised\0" in before
    done("render", scene, "--denoise", "--seed", 3)
    assert np.array_equal(channels["raw"], OpenEXR.File(str(exr)).channels()["raw"].pixels)
    assert before == png.read_bytes()
    scene.write_text(OURS)
    assert "a box filter" in done("render", scene, "--denoise").stdout and pixels(png).shape == (8, 12, 3)
    done("render", scene)
    assert b"prosim.denoised" not in png.read_bytes()


def test_what_can_not_be_denoised(scene, monkeypatch):
    """Nothing is begun without the package, nor for an integrator that denoises."""
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "mitsuba_oidn", None)
        refused("pip install 'mitsuba-prosim[denoise]'", "render", scene, "--denoise", code=1)
    needs_oidn()
    scene.write_text(scene_text('<integrator type="prosim_denoised"><integrator type="path"/></integrator>'))
    refused("prosim_denoised, already denoises; leave out --denoise", "render", scene, "--denoise")


def test_a_denoised_render_continues_with_another_limit(scene):
    """Without a limit before, and with one that was reached."""
    needs_oidn()
    scene.write_text(OURS)
    done("render", scene, "--denoise", "--checkpoint")
    assert " of 0.001" in done("resume", scene.with_suffix(".state.npz"), "--noise", 0.001).stdout
    done("render", scene, "--denoise", "--checkpoint", "--noise", 0.5, "--resolution", "128x64")
    printed = done("resume", scene.with_suffix(".state.npz"), "--time", 0.05).stdout
    assert "not denoised: the raw image is within the limit" in printed


def test_time_that_is_left_for_the_denoiser_ends_a_render(scene):
    needs_oidn()
    scene.write_text(OURS)
    done("render", scene, "--denoise", "--time", 0.5)
    assert metadata(scene)["ended"] == "time"
