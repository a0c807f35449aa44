"""Distributions of microfacet normals (section 3.1.1.1).

A distribution is a pair of functions. ``D(m, roughness)`` is the density of facets per solid angle around the normal
``m`` (local frame, m.z > 0), normalised so that the integral of D(m) m.z over the hemisphere is 1 (the thesis leaves
that pi to equation 3.1). ``polar(u, roughness)`` draws the polar angle of a facet from D(m) m.z, as (sine, cosine),
from ``u`` in [0, 1): it grows with u, so that strata stay strata.
"""

from typing import Callable, NamedTuple

import drjit as dr


class Distribution(NamedTuple):
    name: str
    parameter: str  #: what its roughness is called
    range: tuple    #: lowest and highest roughness, and that in words
    D: Callable
    polar: Callable


def sin2(m):
    """Squared sine of the polar angle: unlike 1 - m.z², it loses no digits near the pole."""
    return m.x * m.x + m.y * m.y


def beckmann(m, alpha):
    """exp(-tan² / alpha²) / (pi alpha² cos⁴), alpha the RMS slope (the thesis's m)."""
    cos2 = dr.maximum(m.z * m.z, 1e-8)
    alpha2 = alpha * alpha
    return dr.exp(-sin2(m) / (cos2 * alpha2)) / (dr.pi * alpha2 * cos2 * cos2)


def beckmann_polar(u, alpha):
    tan2 = -alpha * alpha * dr.log(1 - u)
    cos = dr.rsqrt(1 + tan2)
    return dr.sqrt(tan2) * cos, cos


def phong(m, exponent):
    """(n + 2) / (2 pi) cos^n: Blinn's form of Phong's lobe, about the bisector."""
    return (exponent + 2) * dr.inv_two_pi * dr.power(dr.maximum(m.z, 1e-8), exponent)


def phong_polar(u, exponent):
    cos = dr.power(1 - u, 1 / (exponent + 2))
    return dr.safe_sqrt(1 - cos * cos), cos


DISTRIBUTIONS = {d.name: d for d in (
    Distribution("beckmann", "alpha", (0, 1e3, "a number >= 0"), beckmann, beckmann_polar),
    Distribution("phong", "exponent", (0, 1e6, "a number between 0 and 1e6"), phong, phong_polar),
)}
