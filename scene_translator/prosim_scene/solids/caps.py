"""Balls of which no more than a cap is left, such as the faces of a lens.

A ball's facets are chosen for the whole of it. Of a small lens that is cut from large balls they would leave a rim with
few corners, which lies wrong by many times the chord error, as the faces meet there at a small angle. So such a ball
has its facets where the cap is. There is a family of maps that take the sphere to itself and crowd its points about one
of them: the Lorentz transformations, by which the sky of a traveller crowds ahead (Penrose 1959). They are projective,
so that a convex mesh stays one.
"""

import math

import numpy as np

from .primitives import MAX_SEGMENTS, UNSEEN_SEGMENTS, UNSEEN_TOLERANCE, box_corners
from .remains import Ball, around, meeting
from .sight import Sight
from .solid import Solid

CLOSEST = 64.0  # so many times nearer to one another than on the whole ball, at most
STEP = math.sqrt(0.5)
CORNERS = box_corners(np.array([[-1.0] * 3, [1.0] * 3]))


def crowded(solid: Solid, bound: Ball, camera: Sight, tolerance: float) -> tuple[int, np.ndarray] | None:
    """Segments and ``frame`` of a ball that does not matter outside of ``bound``; None where more than a cap is left.

    The chord error stays below ``tolerance`` pixels at the rim too. The facets far from the cap are so coarse that they
    lie deep within the ball, by a depth which has to be out of reach of what is left.
    """
    if bound.radius == math.inf:
        return None
    (own,) = around([solid])
    left = meeting(bound, own)
    inverse = np.linalg.inv(solid.to_world)
    center = inverse[:3, :3] @ np.array(left.center) + inverse[:3, 3]
    distance, reach = float(np.linalg.norm(center)), left.radius / solid.narrowest
    cosine = _cosine(distance, reach)
    if cosine is None:
        return None
    most = MAX_SEGMENTS
    if not camera.may_see(np.array(left.center) + left.radius * CORNERS):
        most, tolerance = UNSEEN_SEGMENTS, UNSEEN_TOLERANCE * tolerance
    pixel = float(camera.footprint(math.dist(left.center, camera.eye.tolist()) - left.radius))
    # Whatever cuts the cap off, even a plane, meets it at its angle at least, or as these two balls do.
    slant = min(_slant(own, bound), math.sqrt(1 - cosine**2))
    error = tolerance * pixel / solid.widest * slant
    closer = CLOSEST
    while closer >= 2:
        # At the rim of half a ball, which becomes that of the cap, points come half as close as in the middle.
        segments = solid.primitive.segments_for(error * (closer / 2) ** 2, most)
        depth = closer**2 * (1 - math.cos(math.pi * solid.primitive.segment_factor / segments))
        cosine = _cosine(distance, reach + depth)
        if cosine is not None and closer**2 * (1 - cosine) <= 1 + cosine:  # tan(angle / 2) <= 1 / closer
            return segments, _lorentz(center / distance, closer)
        closer *= STEP
    return None


def _cosine(distance: float, reach: float) -> float | None:
    """Of the cap's angle that a ball of the radius ``reach`` has in common with the unit sphere; None if that is not a
    part of less than a half.
    """
    cosine = (distance**2 + 1 - reach**2) / (2 * distance) if distance > 0 else 0.0
    return cosine if 0 < cosine < 1 else None


def _slant(a: Ball, b: Ball) -> float:
    """Sine of half the angle at which two balls meet: their rim is wrong by so many times less than their faces."""
    apart = math.dist(a.center, b.center)
    cosine = (a.radius**2 + b.radius**2 - apart**2) / (2 * a.radius * b.radius)
    between = math.acos(min(max(cosine, -1.0), 1.0))  # their normals at the rim
    return min(math.sin(between / 2), math.cos(between / 2))


def _lorentz(axis: np.ndarray, closer: float) -> np.ndarray:
    """The projective map (4, 4) that takes the unit sphere to itself and brings its points so many times ``closer`` to
    one another about ``axis``, which stays where it is.
    """
    gamma, speed = (closer + 1 / closer) / 2, (closer - 1 / closer) / 2
    result = np.eye(4)
    result[:3, :3] += (gamma - 1) * np.outer(axis, axis)
    result[:3, 3] = result[3, :3] = speed * axis
    result[3, 3] = gamma
    return result
