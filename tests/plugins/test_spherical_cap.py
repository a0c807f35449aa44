import itertools

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import scipy
from mitsuba_prosim.light.spherical_cap import pdf_projected_cap, sample_projected_cap
from scenes import grid

SIGNIFICANCE = 0.01


def cap(c, s, lanes=1):
    """The cosine to the centre and the squared sine of the radius, which kernels do not know when they are compiled."""
    c, s = mi.Float(c), mi.Float(s)
    if lanes > 1:
        c, s = c + dr.zeros(mi.Float, lanes), s + dr.zeros(mi.Float, lanes)
    dr.make_opaque(c, s)
    return c, dr.square(s)


def draw(cos_n, sin2_theta_max, sample):
    return sample_projected_cap(cos_n, dr.safe_sqrt(1 - dr.square(cos_n)), sin2_theta_max, sample)


SINES = (1e-5, 1e-3, 0.05, 0.5, 0.9, 0.9999)  # of the angle that the radius subtends


def heights(s):
    """Cosines of the direction to the centre: set, setting, half set, rising and risen spheres."""
    return np.unique(np.clip(np.r_[-1, s * np.array([-1, -0.9, -0.5, -0.1, 0, 0.1, 0.5, 0.9, 1]), 0.5, 1], -1, 1))


def quadrature(c, s):
    """Projected solid angle by quadrature over the angle from the sphere's axis, with an exact inner integral.

    On the circle at angle t from the axis, the height is a + b cos(phi), of which the positive part is integrated.
    """

    def ring(t):
        a, b = np.cos(t) * c, np.sin(t) * np.sqrt(1 - c * c)
        if a >= b:
            return 2 * np.pi * a * np.sin(t)
        if a <= -b:
            return 0.0
        cut = np.arccos(-a / b)
        return 2 * (a * cut + b * np.sin(cut)) * np.sin(t)

    top = np.arcsin(s)
    kink = abs(np.arcsin(c))  # where a circle begins to be cut
    points = [0, kink, top] if 0 < kink < top else [0, top]
    quad = scipy.integrate.quad
    return sum(quad(ring, low, high, epsabs=0, epsrel=1e-10)[0] for low, high in itertools.pairwise(points))


@pytest.mark.slow
@pytest.mark.parametrize("s", SINES)
def test_the_projected_area_is_that_of_quadrature(variant_rgb, s):
    """The mean of cos(theta) / pdf is the projected solid angle; it varies little, not at all for a whole sphere."""
    for c in heights(s):
        d, pdf = draw(*cap(c, s, 640_000), grid(800))
        dr.eval(d, pdf)
        z, pdf, expected = np.array(d.z, np.float64), np.array(pdf, np.float64), quadrature(c, s)
        assert dr.all(dr.isfinite(d.x + d.y + d.z)), (c, s)
        weight = np.where(pdf > 0, z / np.maximum(pdf, 1e-300), 0)
        # A sphere of which the last tenth has not set is held to the relative error, the rest to one of the whole.
        # Close to the lamp the weights grow towards the tips, where the grid is coarse.
        relative = 1e-3 if s < 0.99 else 3e-3
        assert weight.mean() == pytest.approx(expected, rel=relative, abs=1e-9 * s**3), (c, s)
        if expected > 1e-9 * s**3:
            greatest = 1e-10 if c >= s else 0.05 if s < 0.6 else 0.3
            assert np.var(weight) <= greatest * expected**2, (c, s)


def test_the_density_is_that_of_the_samples(variant_rgb):
    """But for rounding at the seam of ellipse and crescent."""
    for s in SINES:
        for c in heights(s):
            d, pdf = draw(*cap(c, s, 10_000), grid(100))
            expected = pdf_projected_cap(*cap(c, s, 10_000), d.y, d.z)
            dr.eval(d, pdf, expected)
            wrong = ~np.isclose(pdf, expected, rtol=1e-3, atol=0)
            assert np.mean(wrong) < 0.002, (c, s)


@pytest.mark.slow
@pytest.mark.parametrize("s", (0.3, 0.9999))
@pytest.mark.parametrize("height", (-0.8, -0.3, 0.0, 0.02, 0.3, 0.8, 1.0))
def test_directions_have_their_density(variant_rgb, s, height):
    """Chi² over the sphere of directions."""
    c = height * s

    def sample(u):
        d, pdf = draw(*cap(c, s, dr.width(u)), u)
        return d, dr.select(pdf > 0, 1.0, 0.0)

    def pdf(d):
        seen = (d.z > 0) & (d.x * np.sqrt(1 - c * c) + d.z * c > np.sqrt(1 - s * s))
        return dr.select(seen, pdf_projected_cap(*cap(c, s, dr.width(d)), d.y, d.z), 0)

    test = mi.chi2.ChiSquareTest(mi.chi2.SphericalDomain(), sample, pdf, 2, sample_count=200_000, res=51, ires=64)
    assert test.run(SIGNIFICANCE, test_count=14, quiet=True), test.messages


@pytest.mark.slow
def test_tiny_caps_fill_their_ellipse(variant_rgb):
    """A source of 0.06 degrees: radial and angular shares in the cap's own frame, chi² with 20 x 20 cells."""
    s, c, n = 1e-3, 0.7, 400_000
    rng = mi.PCG32(n)
    d, _ = draw(*cap(c, s, n), mi.Point2f(rng.next_float32(), rng.next_float32()))
    _, y, z = np.array(d, dtype=np.float64)
    up = (z - np.sqrt(1 - s * s) * c) / (s * np.sqrt(1 - c * c))  # to first order in s
    radius2, angle = up**2 + (y / s) ** 2, np.arctan2(y / s, up)
    counts, _, _ = np.histogram2d(np.clip(radius2, 0, 1), angle, bins=20, range=((0, 1), (-np.pi, np.pi)))
    assert scipy.stats.chisquare(counts.ravel(), np.full(400, n / 400))[1] > SIGNIFICANCE


def test_receiver_inside_the_sphere_is_flagged(variant):
    for sin2 in (1.0, 1.5):
        d, pdf = draw(mi.Float(0.5), mi.Float(sin2), mi.Point2f(0.3, 0.6))
        assert np.all(np.array(pdf) == 0) and np.all(np.isfinite(np.array(d)))
