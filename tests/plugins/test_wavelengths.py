"""The wavelengths of a pixel's samples, where spectra are rendered."""

import mitsuba as mi
import numpy as np
import pytest
from scenes import film, load_scene
from scipy import stats
from test_waves import LUMINANCE, begun

CROP = {"crop_offset_x": 8, "crop_offset_y": 16, "crop_width": 16, "crop_height": 24}
PATH = {"type": "prosim_adaptive", "nested": {"type": "path"}}


def sky(size=48, window=None, **integrator):
    """The scene of a white sky, of which each sample sees nothing but its wavelengths. What photons can be aimed at is
    behind the camera.
    """
    return load_scene(
        sensor={"type": "perspective", "film": film(size, component_format="float32", **(window or {}))},
        sky={"type": "constant"},
        behind={"type": "sphere", "center": (0, 0, -5), "bsdf": {"type": "dielectric"}},
        integrator={"type": "prosim", "adaptive": "none", **integrator},
    )


def render(*arguments, **integrator):
    return np.array(mi.render(sky(*arguments, **integrator)))


@pytest.mark.parametrize(
    "samples, spp, integrator, most",
    [(5, 5, {}, 0.02), (4, 16, PATH, 0.003), (10, 100, {}, 0.0005)],
    ids=["one pass", "path", "large passes"],
)
def test_samples_divide_the_spectrum_evenly(variant_spectral, samples, spp, integrator, most):
    """So that white is white. Where they divide all that one number draws, which brings four wavelengths, the noise is
    0.3, 0.07 and 0.004.
    """
    image = render(samples=samples, max_samples=spp, **integrator)
    noise = image.std((0, 1))
    assert noise.min() > 0 and noise.max() < most
    assert np.allclose(image.mean((0, 1)), 1, atol=1e-3)


@pytest.mark.slow
def test_photons_of_large_passes_tint_nothing(variant_spectral):
    """All pixels have their wavelengths; where 10 samples are 8 that divide the spectrum and 2, blue is off by 0.1."""
    image = render(size=4, samples=10, max_samples=10, caustics=True, caustic_photons=1 << 10)
    assert image.std((0, 1)).max() < 1e-6
    assert np.allclose(image, 1, atol=5e-3)


def test_wavelengths_of_a_pixel_are_its_own(variant_spectral):
    """With one sample each: no more alike from pixel to pixel, up to two away, than chance has it (Pearson's
    correlation, significance 0.001 for all twelve); and the same in a crop window, to the bit.
    """
    image = render(samples=1)
    assert np.array_equal(render(window=CROP, samples=1), image[16:40, 8:24])
    blue = stats.rankdata(image[..., 2]).reshape(48, 48)
    for down, right in [(y, x) for y in range(3) for x in range(-2, 3) if (y, x) > (0, 0)]:
        a, b = blue[: 48 - down, max(-right, 0) : 48 - max(right, 0)], blue[down:, max(right, 0) : 48 + min(right, 0)]
        assert stats.pearsonr(a.ravel(), b.ravel()).pvalue > 0.001 / 12


def test_luminance_is_that_of_the_image(variant_spectral):
    """What errors are judged by; Mitsuba's own luminance of spectra is 107 times as much."""
    render = begun(sky(samples=5, max_samples=5))
    accumulators = render.state.accumulators
    mean = np.array(accumulators.total) / np.array(accumulators.count)
    image = np.array(render.image())[..., :3] @ LUMINANCE
    assert np.allclose(mean.reshape(48, 48), image, rtol=1e-3)
