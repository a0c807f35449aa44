"""``prosim render --denoise`` and ``--layers``, and ``prosim mix``."""

import sys

import numpy as np
import OpenEXR
import pytest
from running import LIT_FLOOR, PATH, done, metadata, pixels, refused, scene_text
from scenes import channels

OURS = scene_text('<integrator type="prosim"><integer name="samples" value="4"/></integrator>', LIT_FLOOR)
DENOISED = f'<integrator type="prosim_denoised">{PATH}</integrator>'


@pytest.mark.slow
def test_the_raw_image_is_never_lost(denoiser, scene):
    exr, png = scene.with_suffix(".exr"), scene.with_suffix(".png")
    scene.write_text(OURS.replace('<film type="hdrfilm">', '<film type="hdrfilm"><rfilter type="box"/>'))
    printed = done("render", scene, "--denoise", "--seed", 3).stdout
    assert "denoised: error about" in printed and "box filter" not in printed
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


def test_denoise_option_refuses_missing_package_and_polarised_light(denoiser, scene, monkeypatch):
    """Nothing is begun."""
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "mitsuba_oidn", None)
        refused("pip install 'mitsuba-prosim[denoise]'", "render", scene, "--denoise", code=1)
    scene.write_text(scene_text())
    refused("denoising: light is unpolarised here", "render", scene, "--denoise", "-m", "llvm_ad_mono_polarized")


@pytest.mark.slow
def test_prosim_denoised_and_denoise_option_make_one_image(denoiser, scene):
    """Also with a target, and with both; the verdict tells the error."""
    images = list[np.ndarray]()
    for text, option in ((PATH, "--denoise"), (DENOISED, "--denoise"), (DENOISED, "--seed=0")):
        scene.write_text(scene_text(text, LIT_FLOOR))
        assert "denoised: " in done("render", scene, "--noise", 0.002, "--max-samples", 8, option).stdout
        images.append(pixels(scene.with_suffix(".exr")))
    assert np.array_equal(images[0], images[1]) and np.array_equal(images[0], images[2])
    refused("--checkpoint with prosim_denoised: replace it", "render", scene, "--noise", 0.1, "--checkpoint")
    refused("--snapshots: the image is denoised", "render", scene, "--snapshots", 0.1)


@pytest.mark.slow
def test_a_denoised_render_that_has_reached_its_limit_continues_with_another(denoiser, scene):
    scene.write_text(OURS)
    done("render", scene, "--denoise", "--checkpoint", "--noise", 0.5, "--resolution", "128x64")
    printed = done("resume", scene.with_suffix(".state.npz"), "--noise", 0.5, "--time", 60).stdout
    assert "not denoised: the image reached 0.5 without denoising" in printed


@pytest.mark.slow
def test_time_that_is_left_for_the_denoiser_ends_a_render(denoiser, scene):
    scene.write_text(OURS)
    done("render", scene, "--denoise", "--time", 0.5)
    assert metadata(scene)["ended"] == "time"


# ---- Layers


SCENE = scene_text(
    """<integrator type="prosim"><string name="adaptive" value="none"/><integer name="samples" value="2"/>
        <string name="aovs" value="albedo:albedo"/></integrator>""",
    """<shape type="rectangle"><transform name="to_world"><rotate y="1" angle="180"/><translate z="5"/>
        </transform></shape>
    <emitter type="point" id="key"><point name="position" value="1, 1, 2"/>
        <rgb name="intensity" value="4, 3, 2"/></emitter>
    <emitter type="point"><point name="position" value="-1, 1, 2"/><rgb name="intensity" value="1, 2, 4"/></emitter>""",
)


@pytest.fixture
def image(tmp_path, write_scene):
    done("render", write_scene(SCENE, "two.xml"), "--layers", "lights")
    return tmp_path / "two.exr"


def test_lamps_are_dimmed_and_coloured(image, tmp_path):
    before = channels(image)
    assert {"key.R", "key.G", "key.B", "lamp2.B"} <= set(before)
    done("mix", image, "key=0.5", "lamp2=1,0,2", "-o", tmp_path / "mixed.exr")
    after = channels(tmp_path / "mixed.exr")
    assert set(after) == set(before) and (tmp_path / "mixed.png").exists()
    for letter, factor in zip("RGB", (1, 0, 2)):
        expected = 0.5 * before[f"key.{letter}"] + factor * before[f"lamp2.{letter}"]
        assert np.allclose(after[letter], expected, atol=1e-3 * before["R"].max())
    assert metadata(tmp_path / "mixed.exr")["mix"] == "key x 0.5, lamp2 x 1.0 0.0 2.0"
    done("mix", tmp_path / "mixed.exr", "key=2")
    assert metadata(tmp_path / "mixed-mix.exr")["mix"] == "key x 0.5, lamp2 x 1.0 0.0 2.0; key x 2.0"


def test_wrong_factors_and_images(image, tmp_path):
    refused("there is no layer 'lamp 7.1'; there are key, lamp2", "mix", image, "lamp 7.1=1")
    for factor in ("key", *(f"key={value}" for value in ("bright", "nan", "inf", "-1", "1e99", "50%"))):
        refused("LAYER=FACTOR", "mix", image, factor)
    refused("several factors", "mix", image, "key=1", "key=2")
    refused("is a Mitsuba scene; render it by prosim render", "mix", tmp_path / "two.xml", "key=1")
    for size, says in (900, "is damaged, or another program has changed it"), (50, "not a readable EXR"):
        (tmp_path / "cut.exr").write_bytes(image.read_bytes()[:size])
        refused(says, "mix", tmp_path / "cut.exr", "key=1")
    OpenEXR.File({}, {"a.R": np.zeros((2, 2), np.float32)}).write(str(tmp_path / "red.exr"))
    refused("its layers (none)", "mix", tmp_path / "red.exr", "key=1")
    refused("input", "mix", image, "key=1", "-o", image)
    done("render", tmp_path / "two.xml", "-o", tmp_path / "plain")
    refused("--layers", "mix", tmp_path / "plain.exr", "key=1")
