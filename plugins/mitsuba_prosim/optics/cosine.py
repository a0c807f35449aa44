"""Powers of a cosine, as in Phong's lobes and in spot lights, with full precision near the axis for any exponent; and
beams of light sources.

Near the axis of a lobe, 1 - cos is smaller than the rounding error of cos in single precision. The functions `power`
and `cdf` take the versine of an angle, 1 - cos, instead of the cosine.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


def log1p(x: mi.Float) -> mi.Float:
    """Returns ln(1 + x), finite at -1; the rounding error of 1 + x is corrected, also in the derivative."""
    u = dr.maximum(1 + x, 1e-8)
    return dr.log(u) + (x - (u - 1)) / u


def versine(a: mi.Vector3f, b: mi.Vector3f) -> mi.Float:
    """Returns 1 - cos of the angle between two unit vectors."""
    return 0.5 * dr.squared_norm(a - b)


def power(versine: mi.Float, exponent: mi.Float) -> mi.Float:
    """Returns cos^n, n = ``exponent`` >= 0, of an angle with 1 - cos = ``versine``; 0 if the cosine is negative."""
    return dr.select(versine <= 1, dr.exp(exponent * log1p(-versine)), 0)


def cdf(versine: mi.Float, exponent: mi.Float) -> mi.Float:
    """Returns 1 - cos^(n + 1), the distribution of an angle of density (n + 1) cos^n sin; ``versine`` is 1 - cos."""
    h = dr.maximum(0.5 * (exponent + 1) * log1p(-versine), -40)  # below -40 the result is 1; below -89 sinh overflows
    return -2 * dr.sinh(h) * dr.exp(h)  # 1 - exp(2 h), precise also for h near 0


def sample(u: mi.Float, exponent: mi.Float) -> tuple[mi.Float, mi.Float]:
    """Returns ``(sin, cos)`` of an angle of density ~ cos^n sin, the inverse of :func:`cdf` at ``u``."""
    h = -log1p(-u) / (exponent + 1)
    cos = dr.exp(-h)
    return dr.sqrt(dr.maximum(2 * cos * dr.sinh(h), 0)), cos  # 1 - cos², without its cancellation


# ---------------------------------------------------------------- light sources (thesis, section 5.2, figure 5.6)
# A cone light has the constant relative intensity 1 up to the cut-off angle from the axis; a spot light has cos^n of
# the angle up to the cut-off angle, 90 degrees by default. The exponent n is None for a cone light.


def falloff(versine: mi.Float, limit: mi.Float, exponent: mi.Float | None = None) -> mi.Float:
    """Returns the intensity of a beam, divided by the intensity on the axis: a number in [0, 1]. ``versine`` and
    ``limit`` are those of the direction and of the angle at which the beam ends.
    """
    inside = dr.minimum(versine, 2) <= limit  # rounding may give a versine above 2
    return dr.select(inside, mi.Float(1) if exponent is None else power(versine, exponent), mi.Float(0))


def total(limit: mi.Float, exponent: mi.Float | None = None) -> mi.Float:
    """Returns the integral of `falloff` over all directions, in steradians."""
    return dr.two_pi * (limit if exponent is None else cdf(limit, exponent) / (exponent + 1))


def sample_falloff(sample2: mi.Point2f, limit: mi.Float, exponent: mi.Float | None = None) -> mi.Vector3f:
    """Samples a direction of a beam along the z axis by ``sample2`` in [0, 1)²; the density is `falloff` / `total`."""
    if exponent is None:
        p = mi.warp.square_to_uniform_disk_concentric(sample2)
        versine = limit * dr.squared_norm(p)
        # sin² = versine (2 - versine), where versine is limit times the squared radius of p.
        p *= dr.safe_sqrt(limit * (2 - versine))
        return mi.Vector3f(p.x, p.y, 1 - versine)
    sin, cos = sample(sample2.x * cdf(limit, exponent), exponent)
    sin_phi, cos_phi = dr.sincos(dr.two_pi * sample2.y)
    return mi.Vector3f(sin * cos_phi, sin * sin_phi, cos)
