"""Powers of a cosine, as in Phong's lobes and in spot lights, with full precision near the axis for any exponent.

Near the axis of a lobe, 1 - cos is smaller than the rounding error of cos in single precision. The functions `power`
and `cdf` take the versine of an angle, 1 - cos, instead of the cosine.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


def log1p(x: mi.Float) -> mi.Float:
    """Returns ln(1 + x), with full precision also for x near 0, and finite for x at -1. The rounding error of 1 + x is
    corrected to first order, so that the derivative is precise too.
    """
    u = dr.maximum(1 + x, 1e-8)
    return dr.log(u) + (x - (u - 1)) / u


def versine(a: mi.Vector3f, b: mi.Vector3f) -> mi.Float:
    """Returns 1 - cos of the angle between two unit vectors."""
    return 0.5 * dr.squared_norm(a - b)


def power(versine: mi.Float, exponent: mi.Float) -> mi.Float:
    """Returns cos^n of an angle; n >= 0 is the ``exponent``. ``versine`` is 1 - cos of the angle, in [0, 2]. The power
    is 0 where the cosine is negative.
    """
    return dr.select(versine <= 1, dr.exp(exponent * log1p(-versine)), 0)


def cdf(versine: mi.Float, exponent: mi.Float) -> mi.Float:
    """Returns the cumulative distribution function of an angle in [0, 90] degrees: 1 - cos^(n + 1) of the angle.

    The density of the angle is (n + 1) cos^n sin. ``versine`` is 1 - cos of the angle, in [0, 1]; ``exponent`` is n >=
    0.
    """
    h = dr.maximum(0.5 * (exponent + 1) * log1p(-versine), -40)  # below -40 the result is 1; below -89 sinh overflows
    return -2 * dr.sinh(h) * dr.exp(h)  # 1 - exp(2 h), precise also for h near 0


def sample(u: mi.Float, exponent: mi.Float) -> tuple[mi.Float, mi.Float]:
    """Returns ``(sin, cos)`` of an angle that is sampled with a density proportional to cos^n sin, by ``u`` in [0, 1).

    The `cdf` at the sampled angle is ``u``, so the angle increases with ``u``.
    """
    h = -log1p(-u) / (exponent + 1)
    cos = dr.exp(-h)
    return dr.sqrt(dr.maximum(2 * cos * dr.sinh(h), 0)), cos  # 1 - cos², without its cancellation
