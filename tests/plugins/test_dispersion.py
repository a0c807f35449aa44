"""Glass whose index depends on the wavelength: the index, where each wavelength goes, and that nothing is lost.

The wavelengths of a pixel's samples, where spectra are rendered.
"""

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import scipy
from drawing.curves import interaction
from image_statistics import renderings
from mitsuba_prosim.optics.dispersion import MATERIALS, RGB, C, D, Dispersion, F, cauchy
from scenes import T, camera, film, load_scene
from test_waves import LUMINANCE, begun

#: Index at the line d, and Abbe number, as the catalogues state them: Schott's; refractiveindex.info for the others.
CATALOGUE = {
    "bk7": (1.51680, 64.17),
    "f2": (1.62004, 36.37),
    "sf10": (1.72825, 28.41),
    "sf11": (1.78472, 25.76),
    "lasf9": (1.85025, 32.17),
    "silica": (1.45846, 67.82),
    "diamond": (2.41748, 55.30),
    "zirconia": (2.15877, 33.54),
    "water": (1.33340, 55.76),
}
SF10 = {"type": "prosim_dielectric", "int_material": "sf10", "ext_ior": 1.0}


def sellmeier(name, nm):
    """The index, in double precision."""
    square = (nm / 1000) ** 2
    return np.sqrt(1 + sum(b * square / (square - c) for b, c in MATERIALS[name]))


# ------------------------------------------------------------------ the index


def test_material_may_be_a_formula(variant_rgb):
    text = ", ".join(str(value) for term in MATERIALS["sf10"] for value in term)
    named, numbered = (mi.traverse(mi.load_dict(SF10 | {"int_material": one})) for one in ("SF10", text))
    for i in 1, 2, 3:
        for name in f"int_B{i}", f"int_C{i}":
            assert np.array_equal(named[name], numbered[name])


def test_formulas_give_what_catalogues_state(variant_rgb):
    assert set(MATERIALS) == set(CATALOGUE)
    for name, (n_d, abbe) in CATALOGUE.items():
        n = [Dispersion.sellmeier(MATERIALS[name]).index(w)[0] for w in (D, F, C)]
        assert n == pytest.approx([sellmeier(name, w) for w in (D, F, C)], abs=1e-6)
        exact = [sellmeier(name, w) for w in (D, F, C)]
        assert exact[0] == pytest.approx(n_d, abs=1.1e-5)
        assert (exact[0] - 1) / (exact[1] - exact[2]) == pytest.approx(abbe, abs=0.006)


def test_cauchys_formula_of_an_abbe_number():
    a, b = cauchy(1.62, 36.4)
    n = [a + b / (w / 1000) ** 2 for w in (D, F, C)]
    assert n[0] == pytest.approx(1.62) and (n[0] - 1) / (n[1] - n[2]) == pytest.approx(36.4)


def test_r_g_and_b_are_the_centroids_of_srgb(variant_rgb):
    nm = np.arange(360.0, 831.0)
    xyz = np.array(mi.cie1931_xyz(mi.Float(nm)))
    functions = np.array(mi.xyz_to_srgb(mi.Color3f(xyz)))
    assert functions @ nm / functions.sum(axis=1) == pytest.approx(RGB, abs=1)


# ------------------------------------------------------------------ where it goes


def deviation(i, prism, n):
    """Angle between a ray that falls on a prism at the angle ``i`` and the one that leaves it, by Snell's law."""
    inside = prism - np.arcsin(np.sin(i) / n)
    return i + np.arcsin(n * np.sin(inside)) - prism


def through_a_prism(bsdf, i, prism, wavelengths, u, v):
    """``(deviation, channel)`` of rays that two faces of ``bsdf`` refract, with numbers ``u`` and ``v``; channel -1
    where nothing is left.
    """
    ctx = mi.BSDFContext()
    ctx.component = 1
    si = interaction(mi.Vector3f(math.sin(i), 0, math.cos(i)) + dr.zeros(mi.Vector3f, dr.width(u)))
    if wavelengths is not None:
        si.wavelengths = wavelengths
    bs, first = bsdf.sample(ctx, si, u, mi.Point2f(0.5))
    angle = dr.atan2(-bs.wo.x, -bs.wo.z)  # from the first face's axis
    rest = prism - angle  # from the second's
    si.wi = mi.Vector3f(dr.sin(rest), 0, -dr.cos(rest))
    bs, second = bsdf.sample(ctx, si, v, mi.Point2f(0.5))
    left = np.array(first * second)
    channel = np.where(left.max(0) > 0, left.argmax(0), -1)
    return i - prism + np.array(dr.asin(-bs.wo.x)), channel


@pytest.mark.parametrize("colours", ["rgb", "spectral"])
def test_each_wavelength_follows_snells_law(colours, request):
    """Through both faces of a prism, to 1e-4 radians."""
    mi.set_variant(f"llvm_ad_{colours}")
    i, prism, count = math.radians(55), math.radians(60), 3000
    rng = np.random.default_rng(0)
    u, v = (mi.Float(rng.random(count)) for _ in range(2))
    nm = rng.uniform(380, 780, (4, count)) if colours == "spectral" else np.tile(np.array(RGB)[:, None], count)
    given = mi.UnpolarizedSpectrum(nm) if colours == "spectral" else None
    angle, channel = through_a_prism(mi.load_dict(SF10), i, prism, given, u, v)
    seen = channel >= 0
    assert np.mean(seen) == pytest.approx(1 / len(nm), abs=0.05)  # the same wavelength twice
    expected = deviation(i, prism, sellmeier("sf10", nm[channel[seen], np.flatnonzero(seen)]))
    assert np.ptp(expected) > 0.05
    assert np.abs(angle[seen] - expected).max() < 1e-4


def test_without_dispersion_it_is_plain_glass(variant_rgb):
    """A constant index by Cauchy's formula has the same values and densities."""
    rng, found = np.random.default_rng(1), []
    wi, wo = (mi.Vector3f(x / np.linalg.norm(x, axis=0)) for x in rng.normal(size=(2, 3, 500)))
    for more in {}, {"int_abbe": 50.0}:
        bsdf = mi.load_dict({"type": "prosim_dielectric", "int_ior": 1.5, "ext_ior": 1.0, "alpha": 0.4, **more})
        if more:
            params = mi.traverse(bsdf)
            params["int_A"], params["int_B"] = 1.5, 0
            params.update()
        found.append(np.vstack([np.array(v) for v in bsdf.eval_pdf(mi.BSDFContext(), interaction(wi), wo)]))
    np.testing.assert_allclose(*found, rtol=1e-5, atol=1e-8)


# ------------------------------------------------------------------ nothing is lost


def furnace(**glass):
    """A slab before a white sky, seen askew: white again, where nothing is absorbed."""
    bsdf = {"type": "prosim_dielectric", "int_material": "diamond", **glass}
    return {
        "type": "scene",
        "sensor": camera([2, 0.7, 3], [0, 0, 0], film(8, component_format="float32"), fov=10),
        "slab": {"type": "cube", "to_world": T().scale([1, 1, 0.3]), "bsdf": bsdf},
        "sky": {"type": "constant", "radiance": 1.0},
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    "colours, integrator",
    [
        ("spectral", {"type": "path", "max_depth": 40, "rr_depth": 100}),
        ("rgb", {"type": "prosim", "adaptive": "none", "diffuse_bounces": -1, "max_level": 40, "rr_depth": 100}),
        ("spectral", {"type": "prosim", "adaptive": "none", "max_level": 8}),
    ],
    ids=["path", "paths", "tree"],
)
def test_white_light_stays_white(colours, integrator):
    """The mean of each channel, beside the bare sky, by Welch's test at 1 % for all of them; a tree of 8 levels leaves
    out 1e-4 of the light.
    """
    mi.set_variant(f"llvm_ad_{colours}")
    images = renderings(furnace(), 12, spp=144, **integrator).mean((1, 2))
    sky = {name: part for name, part in furnace().items() if name != "slab"}
    bare = renderings(sky, 12, spp=144, first_seed=50, **integrator).mean((1, 2))
    difference = np.abs(images.mean(0) - bare.mean(0))
    deviation = np.sqrt((images.var(0, ddof=1) + bare.var(0, ddof=1)) / 12)
    assert np.all(difference < 2e-4 + scipy.stats.t.isf(0.01 / 18, 11) * deviation)
    assert deviation.max() < 0.02


def wide_slab():
    """An image of the sky through sf10 that fills the view."""
    scene = furnace(int_material="sf10")
    scene["slab"]["to_world"] = T().scale([3, 3, 0.3])
    return renderings(scene, 1, spp=16, type="prosim", adaptive="none", max_level=2)[0]


def test_a_ray_keeps_its_colour_through_two_faces(variant_rgb):
    """Each sample brings one of r, g and b, in turn over the pattern, so that their sum has next to no noise; drawn
    again at the second face, two samples in three would bring nothing.
    """
    image = wide_slab()
    assert image.mean(2).std() < 0.01 < image[..., 0].std()


def test_samples_together_see_the_whole_spectrum(variant_spectral):
    """Behind glass each has a wavelength of its own. Drawn without regard to one another, 16 of them are off by more
    than a half in red and blue, and 64 by a third; most beyond the gamut.
    """
    image = wide_slab()
    assert image.std(axis=(0, 1)).max() < 0.2 and image.min() > 0.5


# ------------------------------------------------------------------ wavelengths of samples


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
    blue = scipy.stats.rankdata(image[..., 2]).reshape(48, 48)
    for down, right in [(y, x) for y in range(3) for x in range(-2, 3) if (y, x) > (0, 0)]:
        a, b = blue[: 48 - down, max(-right, 0) : 48 - max(right, 0)], blue[down:, max(right, 0) : 48 + min(right, 0)]
        assert scipy.stats.pearsonr(a.ravel(), b.ravel()).pvalue > 0.001 / 12


def test_luminance_is_that_of_the_image(variant_spectral):
    """What errors are judged by; Mitsuba's own luminance of spectra is 107 times as much."""
    render = begun(sky(samples=5, max_samples=5))
    accumulators = render.state.accumulators
    mean = np.array(accumulators.total) / np.array(accumulators.count)
    image = np.array(render.image())[..., :3] @ LUMINANCE
    assert np.allclose(mean.reshape(48, 48), image, rtol=1e-3)
