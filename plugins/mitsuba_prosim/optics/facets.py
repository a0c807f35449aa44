"""Microfacets: the facets of a rough surface (thesis, section 3.1.1, equation 3.1; Torrance and Sparrow 1967).

The module defines distributions of facet normals, masking and shadowing, the BRDF of Torrance and Sparrow without
Fresnel's reflectance, and the sampling of facets. The facets form V-shaped cavities; the two facets of a cavity are
mirror images of each other about the normal of the macroscopic surface.
"""

from __future__ import annotations

from collections.abc import Callable
from math import factorial
from typing import NamedTuple

import drjit as dr
import mitsuba as mi

from . import cosine

# ---------------------------------------------------------------- distributions of normals (section 3.1.1.1)


class Distribution(NamedTuple):
    """A distribution of facet normals, and the plugin parameters that select it.

    ``D(m, roughness)`` is the density, per solid angle, of facets with the normal ``m`` (local frame, m.z > 0): the
    integral of D(m) m.z over the hemisphere is 1. (The thesis puts the factor 1 / pi of D into equation 3.1.)
    ``polar(u, roughness)`` samples the polar angle of m with the density D(m) m.z, by ``u`` in [0, 1), and returns its
    sine and cosine. The polar angle increases with ``u``, so stratified numbers ``u`` give stratified angles.
    """

    name: str  #: value of the parameter ``distribution``
    parameter: str  #: name of the parameter with the roughness
    range: tuple[float, float, str]  #: lowest and highest roughness, and this range in words
    D: Callable[[mi.Vector3f, mi.Float], mi.Float]
    polar: Callable[[mi.Float, mi.Float], tuple[mi.Float, mi.Float]]


def sin2(m: mi.Vector3f) -> mi.Float:
    """Returns the squared sine of the polar angle of the unit vector ``m``, precise near the pole, unlike 1 - m.z²."""
    return m.x * m.x + m.y * m.y


def beckmann(m: mi.Vector3f, alpha: mi.Float) -> mi.Float:
    """Returns Beckmann's density of facet normals, exp(-tan² / alpha²) / (pi alpha² cos⁴) of the polar angle of ``m``.
    ``alpha`` is the RMS slope of the facets, which the thesis calls m. An ``alpha`` below 1e-4 counts as 1e-4.
    """
    cos2 = dr.maximum(m.z * m.z, 1e-8)
    alpha2 = dr.maximum(alpha * alpha, 1e-8)  # a texture may be 0 somewhere
    return dr.exp(-sin2(m) / (cos2 * alpha2)) / (dr.pi * alpha2 * cos2 * cos2)


def beckmann_polar(u: mi.Float, alpha: mi.Float) -> tuple[mi.Float, mi.Float]:
    """Samples :func:`beckmann`'s polar angle, by tan² = -alpha² ln(1 - u); returns ``(sin, cos)``."""
    tan2 = -dr.maximum(alpha * alpha, 1e-8) * dr.log(1 - u)
    cos = dr.rsqrt(1 + tan2)
    return dr.sqrt(tan2) * cos, cos


def phong(m: mi.Vector3f, exponent: mi.Float) -> mi.Float:
    """Returns the density of facet normals (n + 2) / (2 pi) cos^n, Blinn's form of Phong's; n is the ``exponent``."""
    # sin² / (1 + cos) is 1 - cos without cancellation.
    return (exponent + 2) * dr.inv_two_pi * cosine.power(dr.minimum(sin2(m) / (1 + m.z), 1), exponent)


def phong_polar(u: mi.Float, exponent: mi.Float) -> tuple[mi.Float, mi.Float]:
    """Samples :func:`phong`'s polar angle, by cos = (1 - u)^(1 / (n + 2)); returns ``(sin, cos)``."""
    return cosine.sample(u, exponent + 1)


#: Coefficients of the series of sin(2a) / 2a in powers of a², each multiplied by k!; exact to 1e-8 for a <= pi/2.
SINE = [(-4.0) ** k * factorial(k) / factorial(2 * k + 1) for k in range(9)]


def gaussian_tail(s: mi.Float, alpha2: mi.Float) -> mi.Float:
    """Returns the integral of exp(-t) sin(2a) / (2a) over t from s to infinity, where t = (a / alpha)².

    The power series of sin(2a) / (2a) in t, up to t^8, gives the integral: that of t^k exp(-t) from s is k! exp(-s)
    times the sum of s^j / j! over j from 0 to k. An ``s`` above 40, where the integral is negligible, counts as 40.
    """
    s = dr.minimum(s, 40)  # exp(-40) is negligible relative to 1, and s^8 does not overflow
    # SINE[k] includes k!; power is alpha^(2k); term is s^k / k!; partial is the sum of the terms from 0 to k.
    total, power, term, partial = 0.0, 1.0, 1.0, 1.0
    for k, c in enumerate(SINE):
        total += c * power * partial
        power *= alpha2
        term *= s / (k + 1)
        partial += term
    return total * dr.exp(-s)


def gaussian_limits(alpha: mi.Float) -> tuple[mi.Float, mi.Float, mi.Float]:
    """Returns ``(alpha², tail, integral)`` for the Gaussian density: the integrals of :func:`gaussian_tail` over angles
    a above 90 degrees, and from 0 to 90 degrees. An ``alpha`` outside [1e-4, 2] counts as the nearer end of this range.
    """
    alpha2 = dr.square(dr.clip(alpha, 1e-4, 2))  # above 2, cancellation becomes visible in single precision
    tail = gaussian_tail(dr.square(0.5 * dr.pi) / alpha2, alpha2)
    return alpha2, tail, gaussian_tail(0, alpha2) - tail


def gaussian(m: mi.Vector3f, alpha: mi.Float) -> mi.Float:
    """Returns Torrance and Sparrow's density of facet normals, C exp(-(a / alpha)²), where a is the polar angle of
    ``m``.

    1 / C is pi times the integral of exp(-(a / alpha)²) sin(2a) over a in [0, pi/2], a Dawson function of a complex
    argument. A series computes it to single precision for alpha <= 2. An ``alpha`` outside [1e-4, 2] counts as the
    nearer end of this range.
    """
    alpha2, _, total = gaussian_limits(alpha)
    a = dr.atan2(dr.sqrt(dr.maximum(sin2(m), 1e-14)), m.z)
    return dr.exp(-a * a / alpha2) / (dr.pi * alpha2 * total)


def gaussian_polar(u: mi.Float, alpha: mi.Float) -> tuple[mi.Float, mi.Float]:
    """Samples the polar angle of a facet normal for :func:`gaussian`; returns ``(sin, cos)``.

    Two steps of Halley's method invert the distribution function of y = sin²a, where a is the polar angle; the density
    of y is proportional to exp(-(a / alpha)²). The first step starts from the smaller of two approximate solutions:
    that of the density exp(-y / alpha²) is good for wide distributions, and that of the density exp(-s (1 + 2/3
    alpha²)) of s = (a / alpha)² is good for narrow ones. The error of the sampled distribution is below 5e-7 for alpha
    <= 1, and below 5e-6 for alpha <= 2.
    """
    alpha2, low, total = gaussian_limits(alpha)
    rate = 1 + (2 / 3) * alpha2
    s = -dr.log(1 - u * (1 - dr.exp(-rate * dr.square(0.5 * dr.pi) / alpha2))) / rate
    y = dr.minimum(
        -alpha2 * dr.log(1 - u * (1 - dr.exp(-1 / alpha2))),
        dr.square(dr.sin(dr.minimum(dr.sqrt(alpha2 * s), 0.5 * dr.pi))),
    )
    target = low + (1 - u) * total
    for _ in range(2):
        y = dr.clip(y, 1e-12, 1 - 1e-6)
        a = dr.asin(dr.sqrt(y))
        s = a * a / alpha2
        step = (target - gaussian_tail(s, alpha2)) * alpha2 * dr.exp(dr.minimum(s, 40))
        y -= step / (1 + 0.5 * step * a / (alpha2 * dr.sqrt(y * (1 - y))))
    y = dr.clip(y, 0, 1)
    return dr.sqrt(y), dr.sqrt(1 - y)


BECKMANN = Distribution("beckmann", "alpha", (0, 1e3, "a number between 0 and 1000"), beckmann, beckmann_polar)
GAUSSIAN = Distribution("gaussian", "alpha", (0, 2, "a number between 0 and 2"), gaussian, gaussian_polar)
PHONG = Distribution("phong", "exponent", (0, 1e6, "a number between 0 and 1e6"), phong, phong_polar)
DISTRIBUTIONS = {d.name: d for d in (BECKMANN, GAUSSIAN, PHONG)}


# ---------------------------------------------------------------- the facet that reflects or refracts
# At grazing incidence, or if the index is near 1, the half vector is a small difference of two unit vectors. This
# difference is exact to rounding. Scalar products with the half vector would lose digits, so they are computed from its
# length.

#: Minimum cosine of a direction that has a reflection. The square of a smaller cosine, and the densities that are
#: divided by it, would exceed the range of single precision.
GRAZING = 1e-18

#: Squared length below which a half vector is only rounding error.
SHORTEST = 1e-36


class Facet(NamedTuple):
    """A microfacet: the normal ``m``, and the cosines ``i_m`` and ``o_m`` between ``m`` and the directions wi, wo."""

    m: mi.Vector3f
    i_m: mi.Float
    o_m: mi.Float


def facet_between(wi: mi.Vector3f, wo: mi.Vector3f, eta: mi.Float) -> Facet:
    """Returns the microfacet, with m.z >= 0, that reflects or refracts light between the unit vectors ``wi`` and
    ``wo``.

    It reflects if both are on the same side of the surface; then the cosines are equal, and negative if both are
    inside. ``eta`` is the index of refraction inside (z < 0) divided by the index outside. If ``eta`` is 1 and ``wo``
    is -``wi``, no facet is defined, and the normal and the cosines are 0.
    """
    outside = wi.z > 0
    reflected = outside == (wo.z > 0)
    inner, outer = dr.select(outside, wo, wi), dr.select(outside, wi, wo)
    h = dr.fma(inner, dr.select(reflected, 1, eta), outer)
    square = dr.maximum(dr.squared_norm(h), SHORTEST)
    inverse = dr.rsqrt(square)
    m = dr.mulsign(h * inverse, h.z)
    # The half vector of a reflection has the length 2 cos, where cos is the cosine between wi and m.
    half = dr.mulsign(0.5 * square * inverse, wi.z)
    return Facet(m, dr.select(reflected, half, dr.dot(wi, m)), dr.select(reflected, half, dr.dot(wo, m)))


# ---------------------------------------------------------------- masking and shadowing (section 3.1.1.2)
# The listing of the thesis divides by N·H. The right denominator is V·H, as in the original paper.


def g1(cos_w: mi.Float, cos_m: mi.Float, w_m: mi.Float) -> mi.Float:
    """Returns the fraction of a facet that is visible from a direction w with w·m > 0: min(1, 2 (N·m) (N·w) / (w·m)),
    where m is the facet's normal, N that of the surface, ``cos_w`` is N·w, ``cos_m`` is N·m, and ``w_m`` is w·m.
    """
    return dr.minimum(1, 2 * cos_m * cos_w / w_m)


def g(cos_i: mi.Float, cos_o: mi.Float, cos_m: mi.Float, i_m: mi.Float) -> mi.Float:
    """Returns the fraction of a reflecting facet that is both lit and visible. ``cos_i``, ``cos_o`` and ``cos_m`` are
    the cosines of wi, wo and the facet's normal; ``i_m`` is the cosine between wi (or wo) and the facet's normal.
    """
    return g1(dr.minimum(cos_i, cos_o), cos_m, i_m)


def torrance_sparrow(
    wi: mi.Vector3f, wo: mi.Vector3f, distribution: Distribution, roughness: mi.Float
) -> tuple[mi.Float, mi.Float, mi.Float]:
    """Evaluates the microfacet BRDF of Torrance and Sparrow, and returns ``(i_m, value, pdf)``.

    ``wi`` and ``wo`` are unit directions above the surface; the cosine of ``wi`` is greater than `GRAZING`. ``i_m`` is
    the cosine between ``wi`` and the facet's normal. ``value`` is the BRDF without Fresnel's reflectance, times the
    cosine of ``wo``: D G / (4 cos_i). ``pdf`` is the density per solid angle of ``wo`` if a facet of
    :func:`sample_visible` reflects ``wi``.
    """
    m, i_m, _ = facet_between(wi, wo, mi.Float(1))
    density = distribution.D(m, roughness) / (4 * wi.z)
    return i_m, density * g(wi.z, wo.z, m.z, i_m), density * g1(wi.z, m.z, i_m)


# ---------------------------------------------------------------- sampling (Heitz and d'Eon 2014, section 3)


def azimuth(u: mi.Float, t: mi.Float) -> mi.Float:
    """Samples the azimuth phi of a visible facet, with the density max(0, min(2, 1 + t cos phi)) / (2 pi) in [-pi, pi].

    ``u`` is in [0, 1); ``t`` >= 0 is the product of the tangents of the polar angles of the viewer, whose azimuth is 0,
    and of the facet's normal. Where the opposite facet of the V-shaped cavity faces away from the viewer (t cos phi >
    1), the density is constant. Where it is visible too, the inversion of the distribution function leads to Kepler's
    equation, phi + t sin phi = y, which two steps of Halley's method solve, starting between the roots for a constant
    and for a linear density. The error of the sampled distribution is below 1e-4 at t = 1, and about 1e-7 if t is not
    close to 1. Unlike a random choice between the two facets, this is continuous in ``u`` and needs no further random
    number.
    """
    t = dr.minimum(t, 1e6)
    s = 2 * u - 1
    v = dr.pi * dr.abs(s)
    bound = dr.maximum(t, 1)
    edge = dr.acos(1 / bound)  # both facets are visible from here to pi - edge
    y = v - edge + dr.sqrt(bound * bound - 1)
    width = dr.pi - 2 * edge
    p = dr.clip((v - 2 * edge) / width, 0, 1)
    phi = edge + width * dr.lerp(p, 1 - dr.sqrt(1 - p), dr.minimum(t, 1))
    for _ in range(2):
        sin, cos = dr.sincos(phi)
        f, slope, curve = phi + t * sin - y, 1 + t * cos, t * sin  # f, its derivative, and minus its second derivative
        step = f * slope / dr.maximum(slope * slope + 0.5 * f * curve, 1e-12)
        phi = dr.clip(phi - step, edge, edge + width)
    return dr.mulsign(dr.select(v < 2 * edge, 0.5 * v, phi), s)


def sample_visible(wi: mi.Vector3f, u: mi.Point2f, distribution: Distribution, roughness: mi.Float) -> mi.Normal3f:
    """Samples a facet that is visible from ``wi``, wi.z > 0, by ``u`` in the unit square, and returns its normal.

    The normals m of the facets that are visible from w = ``wi`` have the density D(m) G1(w, m) max(0, <w, m>) / cos w.
    The normals of the two facets of a cavity have the same polar angle, so the polar angle of a visible normal has the
    density D(m) cos m for any w. Only the azimuth depends on w (:func:`azimuth`).
    """
    sin_m, cos_m = distribution.polar(u.x, roughness)
    sin2_w = wi.x * wi.x + wi.y * wi.y
    inverse = dr.rsqrt(dr.maximum(sin2_w, 1e-30))
    phi = azimuth(u.y, sin2_w * inverse * sin_m / dr.maximum(wi.z * cos_m, 1e-30))
    sin, cos = dr.sincos(phi)
    # The azimuth is measured from the azimuth of wi, or from the x axis if wi is the pole.
    x, y = dr.select(sin2_w > 1e-30, wi.x * inverse, 1), dr.select(sin2_w > 1e-30, wi.y * inverse, 0)
    return mi.Normal3f(sin_m * (cos * x - sin * y), sin_m * (cos * y + sin * x), cos_m)
