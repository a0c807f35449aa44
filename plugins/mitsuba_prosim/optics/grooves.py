"""Reflection of light between the two facets of a V-shaped groove (Xie and Hanrahan 2018; Lee et al. 2018).

The two facets of a groove have the normals m and m', mirror images of each other about the normal N of the surface.
Their edge is horizontal, so reflections change only the part of a direction across the edge. In this plane, angles are
measured from N towards m. If the groove is mirrored at a facet instead of the ray, the ray goes straight on, through a
fan of equal triangles around the edge, and meets a facet wherever it crosses a side of a triangle. So light from the
angle i that meets the facet with the normal m first, and leaves at the angle o after k reflections, needs facets at the
angle psi to N, where 2 k psi = pi - i - e, with e = o if k is odd, and e = -o if k is even.

Its beam has the width sin(psi + min(i, e)) - sin(max(0, max(i, e) - psi)), where the facets have the length 1. Both
formulas are symmetric in i and e, so the reflection is reciprocal; for k = 1 they are the G of Torrance and Sparrow.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi

from .facets import SHORTEST, Distribution, facet_between, torrance_sparrow

#: Share of the facets that are so steep that light reflected between them is neglected: there is no limit to the number
#: of reflections. The light of the next share as large rises with the angle from 0, because a jump at an angle that
#: depends on the roughness would be missing in the derivatives by the roughness.
STEEP = 5e-4

#: Maximum number of terms in :func:`reflect_again` that have derivatives: all of them for alpha up to 3 or an
#: exponent of at least 3.
MAX_DIFFERENTIATED = 32


def across_edge(x: mi.Float, y: mi.Float) -> mi.Vector3f:
    """Returns the unit vector along the horizontal vector (``x``, ``y``) of any length."""
    square = x * x + y * y
    inverse = dr.rsqrt(dr.maximum(square, SHORTEST))
    return mi.Vector3f(dr.select(square > SHORTEST, x * inverse, 1), y * inverse, 0)


def least_angle(distribution: Distribution, roughness: mi.Float, share: float = STEEP) -> mi.Float:
    """Returns the angle psi, in radians, that all facets except the fraction ``share`` exceed."""
    sin, cos = distribution.polar(mi.Float(1 - share), roughness)
    return dr.atan2(cos, sin)


def leave(wi: mi.Vector3f, m: mi.Normal3f, u: mi.Float, distribution: Distribution, roughness: mi.Float) -> mi.Vector3f:
    """Returns the unit vector in which light from ``wi`` leaves a groove, if it meets a facet with the normal ``m``
    first.

    ``m`` is a normal of :func:`.sample_visible`. ``u`` in [0, 1) chooses a point of the part of the facet that is
    visible from ``wi``. The vector points down if the facet is too steep (``STEEP``).
    """
    across = across_edge(m.x, m.y)
    x, cos_psi = dr.dot(wi, across), dr.dot(m, across)
    length = dr.sqrt(x * x + wi.z * wi.z)  # of wi in the plane across the edge
    i, psi = dr.atan2(x, wi.z), dr.atan2(m.z, cos_psi)
    # The distance of the straight ray from the edge, times this length.
    distance = dr.lerp(dr.maximum(x * cos_psi - wi.z * m.z, 0), x * cos_psi + wi.z * m.z, u)
    k = dr.floor(0.5 * (dr.pi - i - dr.safe_asin(distance / length)) / psi + 0.5)
    sin, cos = dr.sincos(2 * k * psi + i)
    odd = k - 2 * dr.floor(0.5 * k) > 0.5
    wo = across * (dr.select(odd, sin, -sin) * length + x) - wi
    wo.z = -cos * length
    kept = (k < 1.5) | (psi > least_angle(distribution, roughness))
    return dr.select(kept, dr.normalize(wo), mi.Vector3f(0, 0, -1))


def reflect_again(
    directions: tuple[mi.Vector3f, mi.Vector3f],
    distribution: Distribution,
    roughness: mi.Float,
    reflectance: Callable[[mi.Float], Any],
    active: mi.Bool,
    probability: Callable[[Any], Any] = lambda f: 1,
) -> tuple[Any, mi.Float]:
    """Returns ``(value, pdf)`` of the light that is reflected more than once between ``directions`` (wi, wo): the BRDF
    times the cosine of wo, and the density of :func:`leave`.

    ``reflectance`` is a function of the cosine between the ray and a facet. ``pdf`` has the factor ``probability``, a
    function of the reflectance at the first facet. Up to three reflections have their exact reflectances. With more,
    those between the first and the last have the reflectance of a single reflection between wi and wo; this changes
    less than 5e-4 of the light for alpha up to 1.5. For wo = (-wi.x, -wi.y, wi.z), to which grooves of all azimuths
    send light, the density is infinite; the returned density is large.
    """
    wi, wo = directions
    # One value for each direction, so that the derivatives by a constant roughness are summed once, not for each term.
    roughness = roughness + dr.zeros(mi.Float, dr.width(wi, wo))
    x, y = wi.x + wo.x, wi.y + wo.y
    across = across_edge(x, y)
    x_i, x_o = dr.dot(wi, across), dr.dot(wo, across)
    i, o = dr.atan2(x_i, wi.z), dr.atan2(x_o, wo.z)
    scale = dr.rcp(2 * wi.z * dr.maximum(dr.sqrt(x * x + y * y), 1e-6))
    middle = reflectance(facet_between(wi, wo, mi.Float(1)).i_m)
    # Either facet may be the first, and k is even or odd. For each of the four, all k up to a largest one contribute.
    least, full = (least_angle(distribution, roughness, share) for share in (STEEP, 2 * STEEP))
    kinds, total = [], mi.Float(0)
    for sign_i, sign_o, lowest in ((1, -1, 2), (-1, 1, 2), (1, 1, 3), (-1, -1, 3)):
        a, e = sign_i * i, sign_o * o
        narrowest = dr.maximum(dr.maximum(0.5 * dr.abs(a - e), -dr.minimum(a, e)), least)
        kinds.append((total, mi.Float(sign_i), mi.Float(sign_o)))
        total = total + dr.maximum(dr.floor(0.5 * ((dr.pi - a - e) / (2 * narrowest) - lowest)) + 1, 0)
    total = dr.select(active, total, 0)

    def add(number: mi.Float, value: Any, pdf: mi.Float) -> tuple[Any, ...]:
        pairs, sign_i, sign_o = number, *kinds[0][1:]
        for before, *signs in kinds[1:]:
            here = number >= before
            pairs = dr.select(here, number - before, pairs)
            sign_i, sign_o = dr.select(here, signs[0], sign_i), dr.select(here, signs[1], sign_o)
        k = 2 * pairs + dr.select(sign_i == sign_o, mi.Float(3), 2)
        psi = 0.5 * (dr.pi - sign_i * i - sign_o * o) / k
        sin, cos = dr.sincos(psi)
        across_i, across_o, up_i, up_o = sign_i * x_i * cos, sign_o * x_o * cos, wi.z * sin, wo.z * sin
        first, last = across_i + up_i, across_o + up_o  # cosines between the ray and the facets
        beam = dr.minimum(first, last) - dr.maximum(dr.maximum(across_i - up_i, across_o - up_o), 0)
        density = distribution.D(mi.Vector3f(cos, 0, sin), roughness) * cos * dr.maximum(beam, 0) * scale / k
        f = reflectance(first)
        remaining = f * reflectance(last) * power(middle, k - 2) * dr.clip((psi - least) / (full - least), 0, 1)
        return number + 1, value + remaining * density, pdf + probability(f) * density

    state = mi.Float(0), dr.zeros(type(middle)), mi.Float(0)
    if dr.grad_enabled(roughness, middle, wi, wo):
        # Not a loop of Dr.Jit 1.5, which ends the process if such a loop is in a call of one of several BSDFs.
        for _ in range(MAX_DIFFERENTIATED):
            state = dr.select(state[0] < total, add(*state), state)
    else:
        state = dr.while_loop(state, lambda number, *_: number < total, add)
    _, value, pdf = state
    return value, pdf


def power(base: Any, exponent: mi.Float) -> Any:
    """Returns ``base`` to the power of a whole ``exponent`` >= 0; above 127 it counts as 127."""
    result, bits = type(base)(1), mi.UInt32(dr.minimum(exponent, 127))
    for bit in range(7):
        result *= dr.select((bits >> bit) & 1 != 0, base, 1)
        base = dr.square(base)
    return result


def reflect(
    directions: tuple[mi.Vector3f, mi.Vector3f],
    distribution: Distribution,
    roughness: mi.Float,
    reflectance: Callable[[mi.Float], Any],
    active: mi.Bool,
) -> tuple[Any, mi.Float]:
    """Returns ``(value, pdf)`` of all reflections; the arguments are those of :func:`reflect_again`."""
    i_m, lit, _ = torrance_sparrow(*directions, distribution, roughness)
    value, pdf = reflect_again(directions, distribution, roughness, reflectance, active)
    return reflectance(i_m) * lit + value, lit + pdf
