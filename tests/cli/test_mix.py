"""``prosim render --layers`` and ``prosim mix``."""

import numpy as np
import OpenEXR
import pytest
from running import done, metadata, refused, scene_text

SCENE = scene_text(
    '<integrator type="prosim"><string name="adaptive" value="none"/><integer name="samples" value="2"/></integrator>',
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
    assert metadata(tmp_path / "mixed.exr")["mix"] == "key x 0.5, lamp2 x 1.0 0.0 2.0"
    done("mix", tmp_path / "mixed.exr", "key=2")
    assert (tmp_path / "mixed-mix.exr").exists()


def test_wrong_factors_and_images(image, tmp_path):
    refused("key, lamp2", "mix", image, "lamp7=1")
    for factor in ("key", *(f"key={value}" for value in ("bright", "nan", "inf", "-1", "1e99", "50%"))):
        refused("LAYER=FACTOR", "mix", image, factor)
    refused("several factors", "mix", image, "key=1", "key=2")
    refused("no EXR", "mix", tmp_path / "two.xml", "key=1")
    (tmp_path / "cut.exr").write_bytes(image.read_bytes()[:500])
    refused("no EXR", "mix", tmp_path / "cut.exr", "key=1")
    refused("input", "mix", image, "key=1", "-o", image)
    done("render", tmp_path / "two.xml", "-o", tmp_path / "plain")
    refused("--layers", "mix", tmp_path / "plain.exr", "key=1")
