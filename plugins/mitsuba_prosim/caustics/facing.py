"""Points of a ball that emits: most on the side that faces the way that its photons go."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

#: How many of the photons of a ball start on the side that faces their way; the others start anywhere on it.
FACING = 0.9


def on_ball(
    ps: mi.PositionSample3f, middle: mi.Point3f, radius: mi.Float, d: mi.Vector3f, sample: mi.Point2f
) -> mi.PositionSample3f:
    """A point on a ball: most on the side that faces the direction ``d``, uniform as seen from there."""
    faces = sample.x < FACING
    u = mi.Point2f(dr.select(faces, sample.x / FACING, (sample.x - FACING) / (1 - FACING)), sample.y)
    front = mi.Frame3f(d).to_world(mi.warp.square_to_cosine_hemisphere(u))
    n = dr.select(faces, front, mi.warp.square_to_uniform_sphere(u))
    result = mi.PositionSample3f(ps)
    result.p, result.n = middle + n * radius, mi.Normal3f(n)
    return result


def per_area_of_ball(n: mi.Normal3f, radius: mi.Float, d: mi.Vector3f) -> mi.Float:
    """Density per area with which :func:`on_ball` takes the point with the normal ``n``."""
    facing = dr.maximum(dr.dot(n, d), 0)
    return (FACING * 4 * facing + (1 - FACING)) / (4 * dr.pi * dr.square(radius))
