"""``prosim render --layers`` and ``prosim mix``."""

import numpy as np
import OpenEXR
import pytest
from running import done, facts, names, refused

SCENE = """<scene version="3.0.0">
    <integrator type="prosim"><string name="adaptive" value="none"/><integer name="samples" value="2"/></integrator>
    <sensor type="perspective">
        <transform name="to_world"><lookat origin="0, 0, 5" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="12"/><integer name="height" value="8"/>
            <rfilter type="box"/></film>
    </sensor>
    <shape type="rectangle"><bsdf type="diffuse"/></shape>
    <emitter type="point" id="key"><point name="position" value="1, 1, 3"/>
        <rgb name="intensity" value="4, 3, 2"/></emitter>
    <emitter type="point"><point name="position" value="-1, 1, 3"/><rgb name="intensity" value="1, 2, 4"/></emitter>
</scene>
"""


@pytest.fixture
def image(tmp_path):
    scene = tmp_path / "two.xml"
    scene.write_text(SCENE)
    done("render", scene, "--layers", "lights")
    return tmp_path / "two.exr"


def channels(path):
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: np.array(channel.pixels, dtype=float) for name, channel in file.channels().items()}


def test_lamps_are_dimmed_and_coloured(image, tmp_path):
    before = channels(image)
    assert {"key.R", "key.G", "key.B", "lamp2.B"} <= set(before)
    done("mix", image, "key=0.5", "lamp2=1,0,2", "-o", tmp_path / "mixed.exr")
    after = channels(tmp_path / "mixed.exr")
    assert set(after) == set(before) and (tmp_path / "mixed.png").exists()
    for letter, factor in zip("RGB", (1, 0, 2)):
        expected = 0.5 * before[f"key.{letter}"] + factor * before[f"lamp2.{letter}"]
        assert np.allclose(after[letter], expected, atol=1e-3 * before["R"].max())
    assert facts(tmp_path / "mixed.exr")["mix"] == "key x 0.5, lamp2 x 1.0 0.0 2.0"
    done("mix", tmp_path / "mixed.exr", "key=2")
    assert (tmp_path / "mixed-mix.exr").exists()


def test_wrong_factors_and_images(image, tmp_path):
    refused("key, lamp2", "mix", image, "lamp7=1", folder=tmp_path)
    refused("LAYER=FACTOR", "mix", image, "key", folder=tmp_path)
    for factor in ("bright", "nan", "inf", "-1", "1e99", "50%"):
        refused("LAYER=FACTOR", "mix", image, f"key={factor}", folder=tmp_path)
    refused("several factors", "mix", image, "key=1", "key=2", folder=tmp_path)
    refused("no EXR", "mix", tmp_path / "two.xml", "key=1", folder=tmp_path)
    (tmp_path / "cut.exr").write_bytes(image.read_bytes()[:500])
    refused("no EXR", "mix", tmp_path / "cut.exr", "key=1", folder=tmp_path)
    refused("input", "mix", image, "key=1", "-o", image, folder=tmp_path)
    done("render", tmp_path / "two.xml", "-o", tmp_path / "plain")
    refused("--layers", "mix", tmp_path / "plain.exr", "key=1", folder=tmp_path)
    refused("--denoise", "render", tmp_path / "two.xml", "--layers", "lights", "--denoise", folder=tmp_path)
    assert "plain.exr" in names(tmp_path)
