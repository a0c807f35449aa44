"""The facet that reflects or refracts one direction into another, found without cancellation.

At grazing incidence, and if the index is near 1, the half vector is a small difference of two unit vectors. That
difference is itself exact to rounding; what would be lost in scalar products with it is known from its length.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

#: A direction whose cosine is below this has no reflection: the square of that cosine, and the densities that are
#: divided by it, would leave the range of single precision.
GRAZING = 1e-18

#: Squared length below which a half vector is nothing but rounding.
SHORTEST = 1e-36


def reflecting(wi: mi.Vector3f, wo: mi.Vector3f) -> tuple[mi.Vector3f, mi.Float]:
    """``(m, i_m)``: the facet that reflects ``wi`` to ``wo``, and the cosine between it and either of them.

    The cosine is half the length of wi + wo, which no rounding makes negative.
    """
    h = wi + wo
    square = dr.maximum(dr.squared_norm(h), SHORTEST)
    inverse = dr.rsqrt(square)
    return h * inverse, 0.5 * square * inverse


def between(wi: mi.Vector3f, wo: mi.Vector3f, eta: mi.Float) -> tuple[mi.Vector3f, mi.Float, mi.Float]:
    """``(m, i_m, o_m)``: the facet, turned upwards, that reflects or refracts ``wi`` to ``wo``, and its cosines.

    Directions on the same side of the surface are by reflection. ``eta``: index inside over that outside.
    """
    outside = wi.z > 0
    reflected = outside == (wo.z > 0)
    inner, outer = dr.select(outside, wo, wi), dr.select(outside, wi, wo)
    h = dr.fma(inner, dr.select(reflected, 1, eta), outer)
    square = dr.maximum(dr.squared_norm(h), SHORTEST)
    inverse = dr.rsqrt(square)
    m = dr.mulsign(h * inverse, h.z)
    half = dr.mulsign(0.5 * square * inverse, wi.z)
    return m, dr.select(reflected, half, dr.dot(wi, m)), dr.select(reflected, half, dr.dot(wo, m))
