"""A damaged image is named at its place in the scene."""

import mitsuba as mi
import numpy as np
import prosim_scene
import pytest
from mitsuba_prosim.scene.scene_file import SceneFile

SCENE = """AMBIENT 9000 9000 9000
BACKGROUND 0 0 0 {}
LIGHTS POINT position 9 9 9
CSG-TREE CUBE 0 {}
SURFACE 0 TRANSFORM 0
END
"""


@pytest.mark.parametrize("background, texture, line", [("NULL", '"cut file.{}"', 4), ('"cut file.{}"', "NULL", 2)])
@pytest.mark.parametrize("suffix, says", [("png", "read 162 out of 795 bytes"), ("jpg", "Invalid JPEG file")])
def test_an_image_that_is_cut_short(variant_rgb, tmp_path, background, texture, line, suffix, says):
    scene, image, out = tmp_path / "scene.scn", tmp_path / f"cut file.{suffix}", tmp_path / "out"
    scene.write_text(SCENE.format(background, texture).replace("{}", suffix), encoding="utf-8")
    noise = np.random.default_rng(1).integers(0, 256, (16, 16, 3), dtype=np.uint8)
    mi.Bitmap(noise).write(str(image))
    whole = image.read_bytes()
    image.write_bytes(whole[: len(whole) // 3])
    out.mkdir()
    with pytest.raises(prosim_scene.SceneError) as error:
        SceneFile(scene, out).load()
    assert (error.value.filename, error.value.line) == (str(scene), line)
    words = str(error.value)
    assert f"the image 'cut file.{suffix}' is incomplete or damaged: " in words and says in words
    assert "save it again" in words and str(out) not in words
    image.write_bytes(whole)
    assert SceneFile(scene, out).load().shapes()
