"""Angular distributions of the intensity of a light source (thesis, section 5.2, figure 5.6): uniform, cone, spot.

Let beta be the angle between the axis of the source and the direction of the light. A cone of half-opening alpha has
the constant intensity 1 for beta <= alpha. A spot has the intensity cos^n(beta), cut off at alpha (90 degrees by
default). The functions take the versines (1 - cos) of alpha and beta, because versines stay precise in narrow beams.
The functions also take the exponent n of a spot; n is None for a cone.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..optics import cosine


def falloff(versine: mi.Float, limit: mi.Float, exponent: mi.Float | None = None) -> mi.Float:
    """Returns the intensity of a beam, divided by the intensity on the axis: a number in [0, 1].

    ``versine`` is 1 - cos of the angle from the axis, and ``limit`` is 1 - cos of the angle at which the beam ends. A
    spot has an ``exponent``; a cone has None.
    """
    inside = dr.minimum(versine, 2) <= limit
    return dr.select(inside, mi.Float(1) if exponent is None else cosine.power(versine, exponent), mi.Float(0))


def total(limit: mi.Float, exponent: mi.Float | None = None) -> mi.Float:
    """Returns the integral of `falloff` over all directions, in steradians."""
    return dr.two_pi * (limit if exponent is None else cosine.cdf(limit, exponent) / (exponent + 1))


def sample_falloff(sample2: mi.Point2f, limit: mi.Float, exponent: mi.Float | None = None) -> mi.Vector3f:
    """Samples a direction about the z axis with the density `falloff` / `total`, by ``sample2`` in [0, 1)²."""
    if exponent is None:
        p = mi.warp.square_to_uniform_disk_concentric(sample2)
        versine = limit * dr.squared_norm(p)
        p *= dr.safe_sqrt(limit * (2 - versine))
        return mi.Vector3f(p.x, p.y, 1 - versine)
    sin, cos = cosine.sample(sample2.x * cosine.cdf(limit, exponent), exponent)
    sin_phi, cos_phi = dr.sincos(dr.two_pi * sample2.y)
    return mi.Vector3f(sin * cos_phi, sin * sin_phi, cos)
