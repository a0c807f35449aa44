"""Reflection of light between the two facets of a V-shaped groove (Xie and Hanrahan 2018; Lee et al. 2018).

The two facets of a groove have the normals m and m', mirror images of each other about the normal N of the surface.
Their edge is horizontal, so reflections change only the part of a direction across the edge. In this plane, angles are
measured from N towards m. If the groove is mirrored at a facet instead of the ray, the ray goes straight on, through a
fan of equal triangles around the edge, and meets a facet wherever it crosses a side of a triangle. So the number of
reflections, the direction in which the light leaves and the width of the beam have closed forms. Light from the angle
i that meets the facet with the normal m first, and leaves at the angle o after k reflections, needs facets at the angle
psi to N,

    2 k psi = pi - i - e,    where e = o if k is odd, and e = -o if k is even.

Its beam has the width sin(psi + min(i, e)) - sin(max(0, max(i, e) - psi)), where the facets have the length 1. Both
formulas are symmetric in i and e, so the reflection is reciprocal; for k = 1 they are the G of Torrance and Sparrow.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi

from .facets import SHORTEST, Distribution, torrance_sparrow

#: Share of the facets that are so steep that light reflected between them is neglected: there is no limit to the number
#: of reflections.
STEEP = 5e-4


class Plane(NamedTuple):
    """The plane across the edge of a groove."""

    across: mi.Vector3f  #: Horizontal unit vector across the edge.
    cos: mi.Float  #: Length in this plane of unit vectors to the viewer and to the light.
    i: mi.Float  #: Angle of the viewer.


def plane_across(wi: mi.Vector3f, x: mi.Float, y: mi.Float) -> Plane:
    """Returns the vertical :class:`Plane` through the horizontal vector (``x``, ``y``) of any length."""
    square = x * x + y * y
    inverse = dr.rsqrt(dr.maximum(square, SHORTEST))
    across = mi.Vector3f(dr.select(square > SHORTEST, x * inverse, 1), y * inverse, 0)
    horizontal = dr.dot(wi, across)
    return Plane(across, dr.sqrt(dr.square(horizontal) + dr.square(wi.z)), dr.atan2(horizontal, wi.z))


def least_angle(distribution: Distribution, roughness: mi.Float) -> mi.Float:
    """Returns the angle psi of which all facets but ``STEEP`` have more, in radians."""
    sin, cos = distribution.polar(mi.Float(1 - STEEP), roughness)
    return dr.atan2(cos, sin)


def leave(wi: mi.Vector3f, m: mi.Normal3f, u: mi.Float, distribution: Distribution, roughness: mi.Float) -> mi.Vector3f:
    """Returns the unit vector in which light from ``wi`` leaves a groove, if it meets a facet with the normal ``m``
    first.

    ``m`` is a normal of :func:`.sample_visible`. ``u`` in [0, 1) chooses a point of the part of the facet that is
    visible from ``wi``. The vector points down if the facet is too steep (``STEEP``).
    """
    plane = plane_across(wi, m.x, m.y)
    i, psi = plane.i, dr.atan2(m.z, dr.sqrt(m.x * m.x + m.y * m.y))
    distance = dr.lerp(dr.sin(dr.maximum(i - psi, 0)), dr.sin(i + psi), u)  # of the straight ray from the edge
    k = dr.floor(0.5 * (dr.pi - i - dr.safe_asin(distance)) / psi + 0.5)
    sin, cos = dr.sincos(2 * k * psi + i)
    odd = k - 2 * dr.floor(0.5 * k) > 0.5
    along = mi.Vector3f(wi.x, wi.y, 0) - plane.across * dr.dot(wi, plane.across)
    wo = plane.across * (dr.select(odd, sin, -sin) * plane.cos) - along
    wo.z = -cos * plane.cos
    kept = (k < 1.5) | (psi > least_angle(distribution, roughness))
    return dr.select(kept, dr.normalize(wo), mi.Vector3f(0, 0, -1))


class Path(NamedTuple):
    """A path of light through a groove, with two or more reflections."""

    #: The BRDF times the cosine of wo if the facets reflect all light, which is also the density of :func:`leave`.
    density: mi.Float
    reflections: mi.Float  #: Number of reflections.
    first: mi.Float  #: Cosine between the ray and the facet at the first reflection as seen from wi.
    middle: mi.Float  #: The same in the middle of the path.
    last: mi.Float  #: The same at the last reflection.

    def remaining(self, reflectance: Callable[[mi.Float], Any]) -> Any:
        """Returns the product of the reflectances, where ``reflectance`` is a function of the cosine.

        The reflections between the first and the last count as if all were in the middle, which is exact for up to
        three reflections.
        """
        between = dr.power(dr.maximum(reflectance(self.middle), 1e-10), self.reflections - 2)
        return reflectance(self.first) * between * reflectance(self.last)


def add_paths(
    sums: tuple[Any, ...],
    directions: tuple[mi.Vector3f, mi.Vector3f],
    distribution: Distribution,
    roughness: mi.Float,
    contributions: Callable[[Path], tuple[Any, ...]],
) -> tuple[Any, ...]:
    """Returns ``sums`` plus the ``contributions`` of all paths between the ``directions`` (wi, wo), unit vectors above
    the surface.

    Paths with one reflection are those of :func:`.torrance_sparrow`. For wo = (-wi.x, -wi.y, wi.z), to which grooves of
    all azimuths send light, the density is infinite; here it is large.
    """
    wi, wo = directions
    x, y = wi.x + wo.x, wi.y + wo.y
    plane = plane_across(wi, x, y)
    i, o = plane.i, dr.atan2(dr.dot(wo, plane.across), wo.z)
    scale = plane.cos / (2 * wi.z * dr.maximum(dr.sqrt(x * x + y * y), 1e-6))
    least = least_angle(distribution, roughness)
    # Either facet may be the first, and k is even or odd. For each of the four, all k up to a largest one contribute.
    kinds = []
    total = mi.Float(0)
    for a, e, lowest in ((i, -o, 2), (-i, o, 2), (i, o, 3), (-i, -o, 3)):
        narrowest = dr.maximum(dr.maximum(0.5 * dr.abs(a - e), -dr.minimum(a, e)), least)
        largest = (dr.pi - a - e) / (2 * narrowest)
        kinds.append((total, a, e, lowest))
        total = total + dr.maximum(dr.floor(0.5 * (largest - lowest)) + 1, 0)

    def add(number: mi.Float, *sums: Any) -> tuple[Any, ...]:
        a, e, k = mi.Float(0), mi.Float(0), mi.Float(2)
        for before, *angles, lowest in kinds:
            here = number >= before
            a, e = dr.select(here, angles[0], a), dr.select(here, angles[1], e)
            k = dr.select(here, lowest + 2 * (number - before), k)
        psi = 0.5 * (dr.pi - a - e) / k
        sin, cos = dr.sincos(psi)
        beam = dr.sin(psi + dr.minimum(a, e)) - dr.sin(dr.maximum(dr.maximum(a, e) - psi, 0))
        density = distribution.D(mi.Vector3f(cos, 0, sin), roughness) * cos * dr.maximum(beam, 0) * scale / k
        cosines = [plane.cos * dr.sin(angle) for angle in (a + psi, a + k * psi, e + psi)]
        return number + 1, *(s + c for s, c in zip(sums, contributions(Path(density, k, *cosines))))

    # A loop that only sums up from zero has derivatives without a limit to its iterations.
    start = mi.Float(0), *(dr.zeros(type(s)) for s in sums)
    _, *further = dr.while_loop(start, lambda number, *_: number < total, add, max_iterations=-1)
    return tuple(s + more for s, more in zip(sums, further))


def reflect(
    directions: tuple[mi.Vector3f, mi.Vector3f],
    distribution: Distribution,
    roughness: mi.Float,
    reflectance: Callable[[mi.Float], Any],
    factor: Any = 1,
) -> tuple[Any, mi.Float]:
    """Returns ``(value, pdf)`` of all reflections between ``directions`` (wi, wo): the BRDF times the cosine of wo, and
    the density of :func:`leave`.

    ``reflectance`` is a function of the cosine between the ray and a facet; ``factor`` is a factor on all light.
    """
    i_m, lit, _ = torrance_sparrow(*directions, distribution, roughness)
    return add_paths(
        (factor * reflectance(i_m) * lit, lit),
        directions,
        distribution,
        roughness,
        lambda path: (factor * path.remaining(reflectance) * path.density, path.density),
    )
