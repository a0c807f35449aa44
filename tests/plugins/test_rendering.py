"""From samples to an image: counts, seeds, sensors, filters, extreme values (section 5.3.2)."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from image_statistics import renderings, same_expectation
from scenes import T, area, camera, film, load_scene, penumbra, rectangle


def counts(spp=0, **settings):
    scene = mi.load_dict(penumbra(size=4, type="prosim", adaptive="none", aovs="samples", **settings))
    return np.array(mi.render(scene, spp=spp))[..., -1]


@pytest.mark.parametrize(
    "settings, expected",
    [({"samples": 10, "max_samples": 6}, 6), ({"max_samples": 99}, 99), ({"samples": 3}, 9), ({"spp": 5}, 5)],
)
def test_every_pixel_takes_as_many_samples_as_the_settings_say(variant_rgb, settings, expected):
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
def test_filters_within_a_pixel_are_those_of_mitsuba(variant_rgb, rfilter):
    scene, ours = penumbra(), {"type": "prosim", "adaptive": "none"}
    box = renderings(scene, 1, spp=25, **ours)
    scene["sensor"]["film"]["rfilter"] = rfilter
    reference, images = renderings(scene, 20, spp=64, type="direct"), renderings(scene, 20, spp=25, **ours)
    assert same_expectation(images, reference) and not np.array_equal(box[0], images[0])


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
    pixels = film(4, 2)
    eye = camera([0, 0, 5], [0, 0, 0], pixels)
    meter = {"type": "irradiancemeter", "film": pixels}
    for sensor in (
        rectangle(T().translate([0, 0, 3]).rotate([0, 1, 0], 180), sensor=meter),
        {"type": "batch", "a": eye, "b": eye, "film": pixels},
        {"type": "radiancemeter", "origin": [0, 0, 5], "direction": [0, 0, -1], "film": film(1)},
    ):
        scene = load_scene(light=rectangle(T().scale(9), **area()), sensor=sensor)
        ours, theirs = (
            np.array(mi.load_dict({"type": name}).render(scene, spp=1024)).mean() for name in ("prosim", "path")
        )
        assert ours == pytest.approx(theirs, rel=0.02)


def test_black_light_is_light_in_spectral_variants_too(variant_spectral):
    scene = penumbra(size=4, type="prosim", ambient={"type": "rgb", "value": [0, 0, 0]}, background=0.0)
    assert np.array(mi.render(mi.load_dict(scene), spp=4)).max() > 0


def test_a_frozen_function_is_refused(variant_rgb):
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
