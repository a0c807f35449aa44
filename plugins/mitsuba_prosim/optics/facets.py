"""Distributions of microfacet normals (section 3.1.1.1).

A distribution is a pair of functions. ``D(m, roughness)`` is the density of facets per solid angle around the normal
``m`` (local frame, m.z > 0), normalised so that the integral of D(m) m.z over the hemisphere is 1 (the thesis leaves
that pi to equation 3.1). ``polar(u, roughness)`` samples the polar angle of a facet from D(m) m.z, as (sine, cosine),
from ``u`` in [0, 1): it grows with u, so that strata stay strata.
"""

from __future__ import annotations

from collections.abc import Callable
from math import factorial
from typing import NamedTuple

import drjit as dr
import mitsuba as mi

from . import cosine


class Distribution(NamedTuple):
    """A distribution, and the plugin parameters that select it."""

    name: str  #: value of the parameter ``distribution``
    parameter: str  #: name of its roughness
    range: tuple[float, float, str]  #: lowest and highest roughness, and that in words
    D: Callable[[mi.Vector3f, mi.Float], mi.Float]
    polar: Callable[[mi.Float, mi.Float], tuple[mi.Float, mi.Float]]


def sin2(m: mi.Vector3f) -> mi.Float:
    """Squared sine of the polar angle: unlike 1 - m.z², it loses no digits near the pole."""
    return m.x * m.x + m.y * m.y


def beckmann(m: mi.Vector3f, alpha: mi.Float) -> mi.Float:
    """exp(-tan² / alpha²) / (pi alpha² cos⁴), alpha the RMS slope (the thesis's m)."""
    cos2 = dr.maximum(m.z * m.z, 1e-8)
    alpha2 = dr.maximum(alpha * alpha, 1e-8)  # a texture may be 0 somewhere
    return dr.exp(-sin2(m) / (cos2 * alpha2)) / (dr.pi * alpha2 * cos2 * cos2)


def beckmann_polar(u: mi.Float, alpha: mi.Float) -> tuple[mi.Float, mi.Float]:
    """tan² = -alpha² ln(1 - u)."""
    tan2 = -dr.maximum(alpha * alpha, 1e-8) * dr.log(1 - u)
    cos = dr.rsqrt(1 + tan2)
    return dr.sqrt(tan2) * cos, cos


def phong(m: mi.Vector3f, exponent: mi.Float) -> mi.Float:
    """(n + 2) / (2 pi) cos^n: Blinn's form of Phong's lobe, about the bisector."""
    return (exponent + 2) * dr.inv_two_pi * cosine.power(dr.minimum(sin2(m) / (1 + m.z), 1), exponent)


def phong_polar(u: mi.Float, exponent: mi.Float) -> tuple[mi.Float, mi.Float]:
    """cos = (1 - u)^(1 / (n + 2))."""
    return cosine.sample(u, exponent + 1)


#: Coefficients of sin(2a) / 2a in powers of a², times k!; exact to 1e-8 for a <= pi/2.
SINE = [(-4.0) ** k * factorial(k) / factorial(2 * k + 1) for k in range(9)]


def gaussian_tail(s: mi.Float, alpha2: mi.Float) -> mi.Float:
    """Integral of exp(-t) sin(2a) / 2a over t from s to infinity, where t = (a / alpha)²: a polynomial times exp(-s).

    Term by term, the integral of t^k exp(-t) is k! exp(-s) (1 + s + ... + s^k / k!).
    """
    s = dr.minimum(s, 40)  # exp(-40) is negligible relative to 1, s^8 still a float
    total, power, term, partial = 0.0, 1.0, 1.0, 1.0
    for k, c in enumerate(SINE):
        total += c * power * partial
        power *= alpha2
        term *= s / (k + 1)
        partial += term
    return total * dr.exp(-s)


def gaussian_limits(alpha: mi.Float) -> tuple[mi.Float, mi.Float, mi.Float]:
    """``(alpha², tail from 90 degrees on, integral up to there)``, for `gaussian_tail`."""
    alpha2 = dr.square(dr.clip(alpha, 1e-4, 2))  # beyond 2, float's cancellation shows
    low = gaussian_tail(dr.square(0.5 * dr.pi) / alpha2, alpha2)
    return alpha2, low, gaussian_tail(0, alpha2) - low


def gaussian(m: mi.Vector3f, alpha: mi.Float) -> mi.Float:
    """C exp(-(a / alpha)²), a the angle: Torrance and Sparrow's own.

    The normalisation, 1 / C = pi times the integral of exp(-(a / alpha)²) sin(2a) over [0, pi/2], is a Dawson
    function of a complex argument; a series gives it to float's precision for alpha <= 2.
    """
    alpha2, _, total = gaussian_limits(alpha)
    a = dr.atan2(dr.sqrt(dr.maximum(sin2(m), 1e-14)), m.z)
    return dr.exp(-a * a / alpha2) / (dr.pi * alpha2 * total)


def gaussian_polar(u: mi.Float, alpha: mi.Float) -> tuple[mi.Float, mi.Float]:
    """Inverts the series by two of Halley's steps in y = sin²a, where the density is exp(-(a / alpha)²): to 3e-7.

    They start from the nearer of two exponentials, exp(-y / alpha²), good for wide distributions, and
    exp(-s (1 + 2/3 alpha²)) with s = (a / alpha)², good for narrow ones.
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


DISTRIBUTIONS = {
    d.name: d
    for d in (
        Distribution("beckmann", "alpha", (0, 1e3, "a number >= 0"), beckmann, beckmann_polar),
        Distribution("gaussian", "alpha", (0, 2, "a number between 0 and 2"), gaussian, gaussian_polar),
        Distribution("phong", "exponent", (0, 1e6, "a number between 0 and 1e6"), phong, phong_polar),
    )
}
