"""``prosim render --denoise``."""

import sys

import mitsuba as mi
import numpy as np
import OpenEXR
import pytest
from running import XML, names, pixels, prosim
from test_render_targets import NOISY

OURS = NOISY.replace(
    '<integrator type="path"/>', '<integrator type="prosim"><integer name="samples" value="4"/></integrator>'
)


def test_the_raw_image_is_never_lost(scene):
    pytest.importorskip("mitsuba_oidn", reason="mitsuba-oidn is not installed: pip install 'mitsuba-prosim[denoise]'")
    scene.write_text(OURS.replace('<film type="hdrfilm">', '<film type="hdrfilm"><rfilter type="box"/>'))
    done = prosim("render", scene, "--denoise", "--seed", 3)
    assert done.exit_code == 0, done.output
    assert "denoised: noise about" in done.stdout and "box filter" not in done.stdout
    file = OpenEXR.File(str(scene.with_suffix(".exr")))
    channels = file.channels()
    assert set(channels) == {"RGB", "raw", "denoised", "error.Y", "error_raw.Y", "error_denoised.Y"}
    header = file.header()
    assert "Open Image Denoise" in header["prosim.denoised"]
    assert float(header["prosim.denoised.noise"]) < float(header["prosim.denoised.raw_noise"])
    assert float(header["prosim.samples"]) <= 18 and "samples = 4" in header["prosim.integrator"]
    assert b"prosim.denoised\0" in scene.with_suffix(".png").read_bytes()
    assert np.isfinite(channels["RGB"].pixels).all() and not np.array_equal(
        channels["RGB"].pixels, channels["raw"].pixels
    )
    raw = channels["raw"].pixels
    before = scene.with_suffix(".exr").read_bytes(), scene.with_suffix(".png").read_bytes()
    assert prosim("render", scene, "--denoise", "--seed", 3).exit_code == 0
    np.testing.assert_array_equal(raw, OpenEXR.File(str(scene.with_suffix(".exr"))).channels()["raw"].pixels)
    assert before[1] == scene.with_suffix(".png").read_bytes()
    assert prosim("render", scene).exit_code == 0
    assert b"prosim.denoised" not in scene.with_suffix(".png").read_bytes()


def test_without_the_package_nothing_is_begun(scene, monkeypatch):
    monkeypatch.setitem(sys.modules, "mitsuba_oidn", None)
    done = prosim("render", scene, "--denoise")
    assert done.exit_code == 1 and "pip install 'mitsuba-prosim[denoise]'" in done.stderr
    assert names(scene.parent) == ["scene.xml"]


def test_a_wide_filter_is_spoken_of(scene):
    pytest.importorskip("mitsuba_oidn", reason="mitsuba-oidn is not installed: pip install 'mitsuba-prosim[denoise]'")
    scene.write_text(XML)
    done = prosim("render", scene, "--denoise")
    assert done.exit_code == 0 and "a box filter" in done.stdout
    assert pixels(scene.with_suffix(".png")).shape == (8, 12, 3)
    assert isinstance(mi.Bitmap(str(scene.with_suffix(".exr"))), mi.Bitmap)


def test_what_does_not_go_together(scene):
    within = '<integrator type="prosim_denoised"><integrator type="path"/></integrator>'
    scene.write_text(XML.replace('<integrator type="path"/>', within))
    done = prosim("render", scene, "--denoise")
    assert done.exit_code == 2 and "prosim_denoised, already denoises; leave out --denoise" in done.stderr
    assert names(scene.parent) == ["scene.xml"]
