"""Powers of a cosine, as in Phong's lobes and in spot lights, with full precision near the axis for any exponent.

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
