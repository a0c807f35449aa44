"""``mitsuba_prosim.render``: a scene in one call, its error, and a verdict in words."""

from dataclasses import replace

import mitsuba as mi
import mitsuba_prosim
import numpy as np
import pytest
from scenes import penumbra

XML = """<scene version="3.0.0"><integrator type="path"/><emitter type="constant"/>
    <sensor type="perspective"><film type="hdrfilm"><integer name="width" value="6"/><integer name="height" value="4"/>
    </film></sensor></scene>"""
PATH = {"type": "path"}
KINDS = {
    "prosim": {"type": "prosim", "noise": 0.2},
    "path": PATH,
    "nothing": None,
    "aov": {"type": "aov", "aovs": "denoised:albedo", "nested": PATH},
    "denoised": {"type": "prosim_denoised", "nested": PATH},
}


def scene(integrator=PATH, **how):
    made = penumbra(size=48, **how) | {"integrator": integrator}
    return made if integrator else {name: value for name, value in made.items() if name != "integrator"}


@pytest.mark.parametrize("kind", KINDS)
def test_render_reaches_the_error(variant_rgb, kind):
    if kind == "denoised":
        pytest.importorskip("mitsuba_oidn")
    loaded = mi.load_dict(scene(KINDS[kind]))
    before, told = str(loaded.integrator()), []
    result = mitsuba_prosim.render(loaded, noise=0.02, progress=told.append)
    assert result.noise <= 0.02 and result.error.shape == result.samples.shape == (48, 48)
    assert str(loaded.integrator()) == before and 0 <= min(told) <= told[-1] == 1
    assert f"error {result.noise:.2g} of 0.02 (95 %: below {result.noise_at_most:.3g})" in result.verdict
    assert np.array_equal(np.array(result), np.array(mi.TensorXf(result)))
    assert np.array(result).shape[:2] == np.array(mi.Bitmap(result)).shape[:2] == (48, 48)


def test_what_reports_the_progress_does_not_end_the_render(variant_rgb, monkeypatch):
    """The update of a bar returns whether it was drawn."""
    monkeypatch.setenv("TQDM_MININTERVAL", "0")
    expected = mitsuba_prosim.render(scene(), noise=0.02, progress=False)
    for progress in (True, lambda done: True):
        result = mitsuba_prosim.render(scene(), noise=0.02, progress=progress)
        assert np.array_equal(result.samples, expected.samples) and result.verdict == expected.verdict


def test_render_takes_dictionaries_and_files(variant_rgb, tmp_path, path):
    (xml := tmp_path / "s.xml").write_text(XML)
    one = mitsuba_prosim.render(mi.load_string(XML), spp=4, progress=False)
    assert np.array_equal(np.array(one), np.array(mitsuba_prosim.render(xml, spp=4, progress=False)))
    assert np.all(one.samples == 4) and "error unknown" in one.verdict and np.isnan(one.noise)
    assert mitsuba_prosim.render(scene(), spp=4, progress=False).image.shape == (48, 48, 3)
    language = mitsuba_prosim.render(str(path), noise=0.3, progress=False)
    assert " of 0.3" in language.verdict


def test_notebook_shows_picture_maps_and_verdict(variant_rgb):
    result = mitsuba_prosim.render(scene(), spp=2, progress=False)
    page = result._repr_html_()
    assert page.count("data:image/png;base64,") == 3 and result.verdict in page and result.verdict in repr(result)
    assert "<script>" not in replace(result, verdict="the light of <script>")._repr_html_()  # the id of a lamp


def test_colours_of_a_grey_image_are_not_its_other_channels(variant_rgb):
    made = scene({"type": "prosim", "aovs": "samples,error"})
    made["sensor"]["film"] |= {"pixel_format": "luminance"}
    result = mitsuba_prosim.render(made, spp=4, progress=False)
    assert result.image.shape == (48, 48, 3) and np.all(np.array(result)[..., 1] == 4)
    assert np.array_equal(result.colours, np.array(result)[..., [0, 0, 0]])


@pytest.mark.parametrize("denoised", [False, True])
def test_xyz_film_is_shown_in_rgb(variant_rgb, denoised):
    if denoised:
        pytest.importorskip("mitsuba_oidn")
    shown = []
    for pixel_format in "rgb", "xyz":
        made = scene({"type": "prosim"})
        made["sensor"]["film"] |= {"pixel_format": pixel_format}
        shown.append(mitsuba_prosim.render(made, spp=4, denoise=denoised, progress=False).colours)
    np.testing.assert_allclose(shown[0].mean((0, 1)), shown[1].mean((0, 1)), rtol=0.02 if denoised else 1e-4)


@pytest.mark.slow
def test_progress_decreases_where_rare_bright_samples_raise_the_error(variant_rgb):
    """A glass ball focuses a small lamp, which the first samples miss."""
    ball = {"type": "sphere", "center": [0, 0, 1], "radius": 0.5, "bsdf": {"type": "dielectric"}}
    integrator, told = {"type": "prosim_adaptive", "max_samples": 256, "nested": PATH}, []
    made = scene(integrator) | {"glass": ball}
    result = mitsuba_prosim.render(made, noise=0.01, progress=told.append)
    assert result.samples.max() == 256 and told != sorted(told) and told[-1] == 1


@pytest.mark.parametrize(
    "arguments, says",
    [
        ({"spp": 4, "noise": 0.1}, "leave it out with noise and time"),
        ({"noise": -1}, "noise is -1; allowed: a number > 0"),
        ({"time": float("nan")}, "time is nan"),
        ({"noise": "0.1"}, "noise is '0.1'; allowed: a number > 0"),
        ({"spp": -3}, "spp is -3; allowed: a whole number from 0 to 4294967295"),
        ({"spp": 2.5}, "spp is 2.5"),
        ({"spp": 2, "seed": -1}, "seed is -1"),
        ({"spp": 2, "seed": 1.5}, "seed is 1.5"),
        ({"sensor": 5}, "sensor index is out of bounds"),
        ({"sensor": "camera"}, "sensor index is out of bounds"),
    ],
)
def test_wrong_arguments_are_named(variant_rgb, arguments, says):
    with pytest.raises(ValueError, match=says):
        mitsuba_prosim.render(scene(), progress=False, **arguments)


@pytest.mark.slow
def test_numbers_of_numpy_and_whole_floats_are_numbers(variant_rgb):
    loaded = mi.load_dict(scene({"type": "prosim"}))
    integrator, camera = loaded.integrator(), loaded.sensors()[0]
    image = np.array(mitsuba_prosim.render(loaded, spp=4, seed=3, progress=False))
    how = {"spp": np.uint8(4), "seed": np.uint8(3), "sensor": np.int64(0)}
    for same in (
        mitsuba_prosim.render(loaded, progress=False, **how),
        mitsuba_prosim.render(loaded, spp=4.0, seed=3.0, sensor=camera, noise=None, progress=False),
        integrator.render(loaded, **how),
    ):
        assert np.array_equal(np.array(same), image)
    expected = mitsuba_prosim.explain(loaded, (3, 4), spp=4, seed=3)
    assert mitsuba_prosim.explain(loaded, np.array([3.0, 4.0]), **how).values == expected.values
    assert mitsuba_prosim.render(loaded, noise=np.float32(0.5), progress=False).noise < 0.5


def test_dictionary_that_would_end_mitsuba_is_refused(variant_rgb):
    wall = {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": {"type": "bitmap"}}}
    with pytest.raises(ValueError, match=r'node "wall.bsdf.reflectance": this bitmap has no filename'):
        mitsuba_prosim.render({**scene(), "wall": wall}, progress=False)
    wall["bsdf"]["reflectance"] = None
    with pytest.raises(ValueError, match=r'render: "wall.bsdf.reflectance" is None'):
        mitsuba_prosim.render({**scene(), "wall": wall}, progress=False)


def test_denoised_image_has_a_verdict(variant_rgb, denoiser):
    result = mitsuba_prosim.render(scene({"type": "prosim"}), spp=16, denoise=True, progress=False)
    assert f"denoised: error about {result.noise:.2g}" in result.verdict and result.noise < result.noise_at_most
    assert result.image.shape == (48, 48, 3) and np.all(result.samples == 16)


def test_scene_of_another_variant_or_no_scene_is_refused(variant_rgb):
    scene = mi.load_dict({"type": "scene"})
    mi.set_variant("llvm_ad_mono")
    for function, arguments in ((mitsuba_prosim.render, ()), (mitsuba_prosim.explain, ((0, 0),))):
        with pytest.raises(TypeError, match="was loaded in the variant llvm_ad_rgb, but llvm_ad_mono is active"):
            function(scene, *arguments)
        with pytest.raises(TypeError, match="a scene or the name of its file is needed, not Shape"):
            function(mi.load_dict({"type": "sphere"}), *arguments)
