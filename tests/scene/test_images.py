"""Image files hold what the film holds; a damaged one is named at its place in the scene."""

import io

import mitsuba as mi
import numpy as np
import OpenEXR
import prosim_scene
import pytest
from mitsuba_prosim.scene import images, session
from mitsuba_prosim.scene.scene_file import SceneFile
from scenes import film, load_scene, read_exr


def rendered(**settings):
    """A rendered film of 20 x 10 pixels."""
    scene = load_scene(
        light={"type": "constant"},
        ball={"type": "sphere", "center": [0, 0, 4]},
        integrator={"type": "aov", "aovs": "nn:sh_normal,depth:depth", "path": {"type": "path"}},
        sensor={"type": "perspective", "film": film(20, 10, **settings)},
    )
    mi.render(scene)
    return scene.sensors()[0].film().bitmap()


FLOAT = {"component_format": "float32"}
FILMS = [FLOAT, {"component_format": "float16"}, {"pixel_format": "rgba"}, FLOAT | {"pixel_format": "luminance"}]


@pytest.mark.parametrize("settings", FILMS)
def test_exr_holds_the_film_bit_by_bit(variant_rgb, tmp_path, settings):
    """Every channel under its name, in its precision; both OpenEXR's library and Mitsuba read the same."""
    bitmap = rendered(**settings)
    content = images.exr(bitmap, {"prosim.scene": "a"})
    pixels = np.array(bitmap)
    read = OpenEXR.File(io.BytesIO(content), separate_channels=True)
    names = [field.name for field in bitmap.struct_()]
    assert "nn.X" in names and set(read.channels()) == set(names)
    for k, name in enumerate(names):
        plane = read.channels()[name].pixels
        assert plane.dtype == pixels.dtype
        assert plane.tobytes() == np.ascontiguousarray(pixels[..., k]).tobytes()
    (tmp_path / "a.exr").write_bytes(content)
    again = read_exr(tmp_path / "a.exr")
    assert {field.name for field in again.struct_()} == set(names)
    assert again.metadata()["prosim.scene"] == "a"


def test_exr_in_one_thread_with_a_name_that_is_no_text(variant_rgb):
    """Mitsuba 3.9 alone would wait for ever."""
    name = b"caf\xe9.scn".decode("utf-8", "surrogateescape")
    with session.threads(1):
        content = images.exr(rendered(), {"prosim.scene": name})
    assert OpenEXR.File(io.BytesIO(content)).header()["prosim.scene"] == r"caf\udce9.scn"


def test_the_tone_curve_keeps_the_range_the_order_and_the_colours():
    rgb = np.random.default_rng(1).uniform(0, 1, (20, 20, 3)).astype(np.float32)
    assert np.allclose(images.compress(rgb), rgb, atol=1e-6)
    rgb = np.linspace(0, 8, 300, dtype=np.float32).reshape(20, 15, 1) * np.array([1, 0.5, 0.25], dtype=np.float32)
    shown = images.compress(rgb)
    luminance = shown @ [0.2126, 0.7152, 0.0722]
    assert np.all(np.diff(luminance.ravel()) > 0)
    assert np.percentile(luminance, 99) == pytest.approx(1, abs=0.01)
    assert np.allclose(shown[..., 1], shown[..., 0] / 2, atol=1e-6)


@pytest.mark.parametrize("number", range(1, 6))
def test_spectral_bins_have_no_png(variant_spectral, number):
    names = [f"b{k}" for k in range(number)]
    bitmap = mi.Bitmap(np.zeros((4, 6, number), dtype=np.float32), mi.Bitmap.PixelFormat.MultiChannel, names)
    assert set(images.encode(bitmap, {})) == {".exr"}


@pytest.mark.parametrize("colours", ["RGB", "RGBA", "XYZ", "Y"])
def test_further_channels_do_not_change_the_png(variant_rgb, colours):
    values = np.random.default_rng(1).uniform(0, 1, (4, 6, 8)).astype(np.float32)
    names, pngs = [*colours], []
    for more in [], ["samples", "error", "n.X"]:
        pixels = values[..., : len(names + more)].copy()
        bitmap = mi.Bitmap(pixels, mi.Bitmap.PixelFormat.MultiChannel, names + more)
        pngs.append(images.encode(bitmap, {}).get(".png"))
    assert pngs[0] and pngs[0] == pngs[1]


SCENE = """AMBIENT 9000 9000 9000
BACKGROUND 0 0 0 {}
LIGHTS POINT position 9 9 9
CSG-TREE CUBE 0 {}
SURFACE 0 TRANSFORM 0
END
"""


@pytest.mark.parametrize("background, texture, line", [("NULL", '"cut file.{}"', 4), ('"cut file.{}"', "NULL", 2)])
@pytest.mark.parametrize("suffix, says", [("png", "read 162 out of 795 bytes"), ("jpg", "Invalid JPEG file")])
def test_truncated_image_is_refused_at_its_line(variant_rgb, tmp_path, background, texture, line, suffix, says):
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
    assert f"the image 'cut file.{suffix}' is incomplete, damaged or in an unknown format: " in words and says in words
    assert "save it again as PNG" in words and str(out) not in words
    image.write_text("no picture")
    with pytest.raises(prosim_scene.SceneError, match="unknown format"):
        SceneFile(scene, out).load()
    image.write_bytes(whole)
    assert SceneFile(scene, out).load().shapes()
