"""From samples to an image: counts, seeds, sensors, filters, extreme values (section 5.3.2)."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from image_statistics import renderings, same_expectation
from scenes import penumbra


def T():
    return mi.ScalarTransform4f()


def counts(spp=0, **settings):
    scene = mi.load_dict(penumbra(size=4, type="prosim", adaptive="none", aovs="samples", **settings))
    return np.array(mi.render(scene, spp=spp))[..., -1]


@pytest.mark.parametrize(
    "settings, expected",
    [
        ({"samples": 5, "max_samples": 8}, 8),
        ({"samples": 10, "max_samples": 6}, 6),
        ({"samples": 5, "max_samples": 99}, 99),
        ({"samples": 3}, 9),
        ({"spp": 5}, 5),
    ],
)
def test_the_most_samples_are_the_most(variant_rgb, settings, expected):
    assert np.all(counts(**settings) == expected)


@pytest.mark.slow
def test_a_pass_cut_short_biases_nothing(variant_rgb):
    whole, cut = (
        renderings(penumbra(type="prosim", adaptive="none"), 24, spp=spp, first_seed=first)
        for spp, first in ((64, 0), (13, 1000))
    )
    assert same_expectation(cut, whole)


def test_noise_of_two_seeds_is_unrelated_wherever_one_is_moved(variant_rgb):
    """Of 200 pairs of seeds no two have images that are alike when moved by up to 20 pixels (significance 1e-3)."""
    scene = penumbra(size=48, type="prosim", adaptive="none", samples=1)
    images = renderings(scene, 12)[..., 1]
    noise = images - images.mean(0)
    spectra = np.fft.fft2(noise / np.sqrt((noise**2).sum((1, 2), keepdims=True)))
    pairs = [(a, b) for a in range(12) for b in range(a)]
    largest = max(np.abs(np.fft.ifft2(spectra[a] * spectra[b].conj()).real).max() for a, b in pairs)
    assert largest < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("rfilter", [{"type": "gaussian", "stddev": 0.1}, {"type": "tent", "radius": 0.4}])
def test_filters_within_a_pixel_weigh_as_mitsuba_has_them(variant_rgb, rfilter):
    scene = penumbra(size=32, rfilter="box")
    scene["sensor"]["film"]["rfilter"] = rfilter
    scene["sensor"]["film"]["width"] = 32
    reference = renderings(scene, 20, spp=64, type="direct")
    assert same_expectation(renderings(scene, 20, spp=25, type="prosim", adaptive="none"), reference)
    box = renderings(
        {**scene, "sensor": {**scene["sensor"], "film": {**scene["sensor"]["film"], "rfilter": {"type": "box"}}}},
        20,
        spp=25,
        type="prosim",
        adaptive="none",
    )
    assert not np.array_equal(box[0], renderings(scene, 1, spp=25, type="prosim", adaptive="none")[0])


@pytest.mark.parametrize("radiance", [1e20, 1e25, 1e30])
def test_the_error_of_extreme_light_is_a_number_and_counts_as_noise(variant_rgb, radiance):
    scene = penumbra(size=16, type="prosim", aovs="samples,error")
    scene["light"]["emitter"]["radiance"] = {"type": "rgb", "value": radiance}
    image = np.array(mi.render(mi.load_dict(scene)))
    assert np.all(np.isfinite(image))
    assert np.mean(image[..., -2] == 25) > 0.8


@pytest.mark.slow
def test_every_kind_of_sensor_sees(variant_rgb):
    """Also those that have no sample_ray, such as irradiancemeter."""
    film = {"type": "hdrfilm", "width": 4, "height": 2, "rfilter": {"type": "box"}}
    camera = {"type": "perspective", "to_world": T().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]), "film": film}
    meter = {
        "type": "rectangle",
        "to_world": T().translate([0, 0, 3]).rotate([0, 1, 0], 180),
        "sensor": {"type": "irradiancemeter", "film": film},
    }
    light = {"type": "rectangle", "to_world": T().scale(9), "emitter": {"type": "area", "radiance": 1.0}}
    for sensor in (
        meter,
        {"type": "batch", "a": camera, "b": camera, "film": film},
        {
            "type": "radiancemeter",
            "origin": [0, 0, 5],
            "direction": [0, 0, -1],
            "film": {**film, "width": 1, "height": 1},
        },
    ):
        scene = mi.load_dict({"type": "scene", "light": light, "sensor": sensor})
        ours, theirs = (
            np.array(mi.load_dict({"type": name}).render(scene, spp=1024)).mean() for name in ("prosim", "path")
        )
        assert ours == pytest.approx(theirs, rel=0.02)


def test_black_light_is_light_in_spectral_variants_too(variant_spectral):
    scene = penumbra(size=4, type="prosim", ambient={"type": "rgb", "value": [0, 0, 0]}, background=0.0)
    assert np.array(mi.render(mi.load_dict(scene), spp=4)).max() > 0


def test_a_frozen_function_is_refused_kindly(variant_rgb):
    scene = mi.load_dict(penumbra(size=4, type="prosim"))

    @dr.freeze
    def frozen(seed):
        return mi.render(scene, seed=seed)

    with pytest.raises(RuntimeError) as error:
        frozen(mi.UInt32(1))
    causes = [error.value]
    while causes[-1].__cause__ is not None:
        causes.append(causes[-1].__cause__)
    assert any("dr.freeze" in str(cause) for cause in causes)


@pytest.mark.parametrize(
    "name", ["samples", "min_passes", "max_samples", "max_level", "diffuse_bounces", "rr_depth", "band"]
)
def test_whole_numbers_are_whole(variant_rgb, name):
    integrator = mi.load_dict({"type": "prosim", name: 10.0})
    assert getattr(integrator, name) == 10 and isinstance(getattr(integrator, name), int)
    with pytest.raises(RuntimeError, match=f'"{name}" is 2.7; allowed: a whole number'):
        mi.load_dict({"type": "prosim", name: 2.7})
