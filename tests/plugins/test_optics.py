"""The equations of chapters 2 and 3 against quadrature, and the curves of the figures."""

import re
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from drawing import curves
from mitsuba_prosim.optics import facets, fresnel
from mitsuba_prosim.optics.facets import DISTRIBUTIONS

WIDTHS = (0.02, 0.3, 1.0)


def roughness(distribution, alpha):
    """The parameter that makes a lobe about as wide as a Beckmann one of ``alpha`` (Walter et al. 2007)."""
    return 2 / alpha**2 - 2 if distribution.name == "phong" else alpha


def polar_grid(alpha, n=20000):
    """Angles with their weights sin dtheta, dense where a distribution of width ``alpha`` is."""
    x = (np.arange(n) + 0.5) / n
    theta = np.pi / 2 * x**3  # dense about the pole
    return theta, np.sin(theta) * np.pi / 2 * 3 * x**2 / n


def facet(theta):
    theta = mi.Float(theta)
    return mi.Vector3f(dr.sin(theta), 0, dr.cos(theta))


@pytest.mark.parametrize("name, alpha", [(n, a) for n in DISTRIBUTIONS for a in WIDTHS] + [("gaussian", 2.0)])
def test_polar_angle_inverts_the_distribution(variant_rgb, name, alpha):
    """The share of the facets up to the angle drawn from u is u."""
    d = DISTRIBUTIONS[name]
    width = roughness(d, alpha)
    theta, weight = polar_grid(alpha, 100000)
    density = np.array(d.D(facet(theta), mi.Float(width)), dtype=float) * np.cos(theta) * weight
    share = np.concatenate([[0], np.cumsum(density)]) * 2 * np.pi
    x = np.arange(len(theta) + 1) / len(theta)
    u = np.linspace(0.001, 0.999, 400)
    sin, cos = (np.array(v, dtype=float) for v in d.polar(mi.Float(u), mi.Float(width)))
    np.testing.assert_allclose(sin**2 + cos**2, 1, atol=1e-5)
    found = np.interp(np.cbrt(np.arctan2(sin, cos) / (np.pi / 2)), x, share)
    np.testing.assert_allclose(found, u, atol=1e-4)


def test_azimuth_inverts_its_density(variant_rgb):
    """The share of max(0, min(2, 1 + t cos phi)) up to the azimuth drawn from u is u; and the map is monotonous."""
    u = (np.arange(1000) + 0.5) / 1000
    phi = np.linspace(-np.pi, np.pi, 20001)
    mid = 0.5 * (phi[1:] + phi[:-1])
    errors = []
    for t in (0, 1e-3, 0.3, 0.9, 0.99, 1, 1.01, 1.5, 5, 100, 1e5):
        density = np.clip(1 + t * np.cos(mid), 0, 2)
        share = np.concatenate([[0], np.cumsum(density)]) / density.sum()
        drawn = np.array(facets.azimuth(mi.Float(u), mi.Float(t)), dtype=float)
        assert (np.diff(drawn) >= -1e-6).all()
        errors.append(np.abs(np.interp(drawn, phi, share) - u))
    assert np.max(errors) < 2e-4
    assert np.mean(errors) < 1e-5


def test_fresnel_matches_the_amplitudes(variant_rgb):
    """Reflectances from complex amplitudes in double precision, to 1e-6; also of indices near 1, and grazing."""
    cos = np.r_[np.cos(np.radians(np.linspace(0, 89.9, 500))), np.geomspace(1e-9, 0.02, 500)]
    cos = cos.astype(np.float32).astype(float)  # what is rounded counts at the critical angle

    def exact(index):
        t = np.sqrt(1 - (1 - cos**2) / index**2 + 0j)
        s, p = (cos - index * t) / (cos + index * t), (index * cos - t) / (index * cos + t)
        return 0.5 * (abs(s) ** 2 + abs(p) ** 2)

    for eta in np.float32([1.1, 1.5, 2.419, 1 + 1e-2, 1 + 1e-3, 1 - 1e-3, 1 + 1e-5]).astype(float):
        for side, index, tolerance in ((1, eta, 1e-6), (-1, 1 / eta, 1e-5)):
            found = np.array(fresnel.interface(mi.Float(side * cos), mi.Float(eta)).f, dtype=float)
            apart = np.abs(1 - (1 - cos**2) / index**2) > 1e-3  # from the critical angle, where floats are coarse
            np.testing.assert_allclose(found[apart], exact(index)[apart], rtol=2e-4, atol=1e-12)
            if eta > 1.05:
                np.testing.assert_allclose(found, exact(index), atol=tolerance)
    eta, k = (0.2, 0.92, 1.1), (3.9, 2.45, 2.14)
    metal = np.array(fresnel.conductor(mi.Float(cos), mi.Color3f(eta), mi.Color3f(k)))
    for channel in range(3):
        np.testing.assert_allclose(metal[channel], exact(eta[channel] + 1j * k[channel]), atol=1e-6)


def test_the_approximation_of_the_thesis_holds_for_a_large_index(variant_rgb):
    cos = mi.Float(np.cos(np.radians(np.linspace(0, 89, 90))))

    def difference(eta, k):
        args = cos, mi.Color3f(eta), mi.Color3f(k)
        return dr.max(dr.abs(fresnel.conductor(*args) - fresnel.conductor_thesis(*args)), axis=None)

    assert difference(1.5, 7.5) < 5e-3  # aluminium: good
    assert difference(0.2, 3.9) < 1e-2
    assert difference(0.5, 0.5) > 5e-2  # n² + k² is not large: bad


@pytest.mark.slow
def test_the_documented_losses_are_measured(variant_rgb):
    """docs/optics.md has a table of the light lost in cavities, in per cent, and a sentence for a glass."""
    text = (Path(__file__).parents[2] / "docs" / "optics.md").read_text()
    rows = [line.strip("| \n").split(" | ") for line in text.splitlines() if line.startswith("| ")]
    metals = [r for r in rows if len(r) == 7 and r[0] not in ("m", "---")]
    assert len(metals) == 4
    for width, *losses in metals:
        mirror = mi.load_dict({"type": "prosim_conductor", "alpha": float(width)})
        for angle, loss in zip((0, 30, 45, 60, 75, 85), losses, strict=True):
            assert 100 * (1 - curves.albedo(mirror, angle, float(width))[0][0]) == pytest.approx(float(loss), abs=0.15)
    (sentence,) = re.findall(r"A rough glass of index 1\.5 with m = 0\.6 loses .*?inside", text, re.DOTALL)
    glass = mi.load_dict({"type": "prosim_dielectric", "int_ior": 1.5, "ext_ior": 1.0, "alpha": 0.6})
    for angle, loss in zip((0, 60, 180, 120), re.findall(r"([\d.]+) %", sentence), strict=True):
        back, on = curves.albedo(glass, angle, 0.6, 1.5)
        assert 100 * (1 - (back + on)[0]) == pytest.approx(float(loss), abs=0.15)
