"""Angular distributions of the intensity of a light source (thesis, section 5.2, figure 5.6): uniform, cone, spot.

A cone light has the constant relative intensity 1 up to the cut-off angle from the axis; a spot light has cos^n of the
angle up to the cut-off angle, 90 degrees by default. The functions take the versine, 1 - cos, of each angle, because
versines stay precise in narrow beams; and the exponent n of a spot light, which is None for a cone light.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..optics import cosine


def falloff(versine: mi.Float, limit: mi.Float, exponent: mi.Float | None = None) -> mi.Float:
    """Returns the intensity of a beam, divided by the intensity on the axis: a number in [0, 1]. ``versine`` and
    ``limit`` are those of the direction and of the angle at which the beam ends.
    """
    inside = dr.minimum(versine, 2) <= limit  # rounding may give a versine above 2
    return dr.select(inside, mi.Float(1) if exponent is None else cosine.power(versine, exponent), mi.Float(0))


def total(limit: mi.Float, exponent: mi.Float | None = None) -> mi.Float:
    """Returns the integral of `falloff` over all directions, in steradians."""
    return dr.two_pi * (limit if exponent is None else cosine.cdf(limit, exponent) / (exponent + 1))


def sample_falloff(sample2: mi.Point2f, limit: mi.Float, exponent: mi.Float | None = None) -> mi.Vector3f:
    """Samples a direction of a beam along the z axis by ``sample2`` in [0, 1)²; the density is `falloff` / `total`."""
    if exponent is None:
        p = mi.warp.square_to_uniform_disk_concentric(sample2)
        versine = limit * dr.squared_norm(p)
        # sin² = versine (2 - versine), where versine is limit times the squared radius of p.
        p *= dr.safe_sqrt(limit * (2 - versine))
        return mi.Vector3f(p.x, p.y, 1 - versine)
    sin, cos = cosine.sample(sample2.x * cosine.cdf(limit, exponent), exponent)
    sin_phi, cos_phi = dr.sincos(dr.two_pi * sample2.y)
    return mi.Vector3f(sin * cos_phi, sin * sin_phi, cos)
