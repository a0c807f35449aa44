"""Chooses the tessellation of curved faces: the number of segments, and its limits.

- The active zone of a solid (Rossignac and Voelcker 1989) is a region outside of which the solid has no effect on the
  result of the CSG tree. A ball that contains the active zone follows from the tree alone.
- Cap refinement: sometimes only a cap of a ball is a part of the result, for example a face of a lens. The two faces
  of a lens meet at a small angle, so the chord error is many times larger at the rim. The facets of such a ball are
  concentrated near the cap: a Lorentz transformation maps the sphere to itself and concentrates its points around one
  of them (Penrose 1959). This map is projective, so a convex mesh stays convex.
- An inscribed ball touches a curved face of another solid from inside, for example a ball in a pipe of the same width.
  Both faces are approximated by chords. Near the contact, the facets of the ball would penetrate the facets of the
  pipe, and patches of the wrong solid would be visible, many pixels wide. So the ball shrinks by at most the chord
  error of the outer solid.
"""

import math
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..language.document import Document, subtree_ends
from ..model import Leaf, Operator
from ..view import Camera
from .csg import tree_of
from .grouping import group_equal, sweep
from .primitives import MAX_SEGMENTS, MIN_SEGMENTS, OUTSIDE_SEGMENTS, OUTSIDE_TOLERANCE, box_corners
from .solids import IDENTITY, Solid, unit_mesh, world_box_corners


class Ball(NamedTuple):
    """A ball in world coordinates."""

    center: tuple[float, float, float]
    radius: float


UNBOUNDED = Ball((0.0, 0.0, 0.0), math.inf)


def active_zones(csg: Sequence[Operator | Leaf], solids: Sequence[Solid], of_leaf: Sequence[int]) -> list[Ball]:
    """Returns, for each solid, a ball that contains its active zone; UNBOUNDED if no ball is known.

    Outside of its active zone, a solid has no effect on the result. ``csg`` is the CSG tree in prefix order,
    ``of_leaf`` has the number of the solid of each leaf. A subtracted solid has an effect only inside the solid from
    which it is subtracted. An operand of an intersection has an effect only inside the other operand.
    """
    tree, ends = tree_of(csg), subtree_ends(csg)
    of_solid = bounding_balls(solids)
    value = {"+": union_ball, "-": lambda first, second: first, "*": intersection_ball}
    balls = [UNBOUNDED] * len(tree)  # a bounding ball of the solid that each node of the tree describes
    for i, node in reversed(list(enumerate(tree))):
        if isinstance(node, str):
            balls[i] = value[node](balls[i + 1], balls[ends[i + 1]])
        else:
            balls[i] = of_solid[of_leaf[node]]
    bounds = [UNBOUNDED] * len(tree)
    result: dict[int, Ball] = {}
    for i, node in enumerate(tree):
        if isinstance(node, str):
            a, b = i + 1, ends[i + 1]
            bounds[a] = intersection_ball(bounds[i], balls[b]) if node == "*" else bounds[i]
            bounds[b] = bounds[i] if node == "+" else intersection_ball(bounds[i], balls[a])
        else:
            solid = of_leaf[node]
            result[solid] = union_ball(result[solid], bounds[i]) if solid in result else bounds[i]
    return [result[i] for i in range(len(solids))]


def bounding_balls(solids: Sequence[Solid]) -> list[Ball]:
    """Returns the bounding balls of solids, in world coordinates."""
    result = [UNBOUNDED] * len(solids)
    for primitive, numbers in group_equal(s.primitive for s in solids).items():
        matrices = np.array([solids[number].to_world for number in numbers])
        _, center, radius = primitive.ball(matrices[:, :3, :3])
        for number, (x, y, z), r in zip(numbers, (center + matrices[:, :3, 3]).tolist(), radius.tolist()):
            result[number] = Ball((x, y, z), r)
    return result


def union_ball(a: Ball, b: Ball) -> Ball:
    """Returns the bounding ball of two balls."""
    distance = math.dist(a.center, b.center)
    small, large = sorted((a, b), key=lambda ball: ball.radius)
    if distance + small.radius <= large.radius:  # true for infinite radii, too
        return large
    radius = (distance + a.radius + b.radius) / 2
    return Ball(_between(a, b, (radius - a.radius) / distance), radius)


def intersection_ball(a: Ball, b: Ball) -> Ball:
    """Returns a bounding ball of the intersection of two balls."""
    small = min(a, b, key=lambda ball: ball.radius)
    distance = math.dist(a.center, b.center)
    if max(a.radius, b.radius) == math.inf or distance**2 <= abs(a.radius**2 - b.radius**2):
        return small
    # The distance, on the line through the centres, from the centre of a to the plane in which the spheres intersect.
    along = (distance + (a.radius - b.radius) * (a.radius + b.radius) / distance) / 2
    return Ball(_between(a, b, along / distance), math.sqrt(max((a.radius - along) * (a.radius + along), 0.0)))


def _between(a: Ball, b: Ball, fraction: float) -> tuple[float, float, float]:
    """Returns the point at a ``fraction`` of the way from the centre of a to the centre of b."""
    x, y, z = (p + fraction * (q - p) for p, q in zip(a.center, b.center))
    return x, y, z


MAX_REFINEMENT = 64.0  # the largest factor by which cap refinement reduces the distances of points near the cap
NEXT_REFINEMENT = math.sqrt(0.5)  # the ratio of two refinements that are tried one after the other
CORNERS = box_corners(np.array([[-1.0] * 3, [1.0] * 3]))


def refined_cap(solid: Solid, bound: Ball, camera: Camera, tolerance: float) -> tuple[int, np.ndarray] | None:
    """Returns the segments and the ``facet_map`` of a ball of which only a cap is in the active zone ``bound``.

    Returns None if the active zone is larger than a cap. The chord error stays below ``tolerance`` pixels, also at the
    rim of the cap. The facets far from the cap are coarse, and lie deep inside the ball; this depth must not reach the
    active zone.
    """
    if bound.radius == math.inf:
        return None
    (whole_ball,) = bounding_balls([solid])
    zone = intersection_ball(bound, whole_ball)
    inverse = np.linalg.inv(solid.to_world)
    center = inverse[:3, :3] @ np.array(zone.center) + inverse[:3, 3]
    distance, reach = float(np.linalg.norm(center)), zone.radius / solid.narrowest
    cosine = _cosine(distance, reach)
    if cosine is None:
        return None
    max_segments = MAX_SEGMENTS
    if not camera.may_see(np.array(zone.center) + zone.radius * CORNERS):
        max_segments, tolerance = OUTSIDE_SEGMENTS, OUTSIDE_TOLERANCE * tolerance
    pixel = float(camera.footprint(math.dist(zone.center, camera.eye.tolist()) - zone.radius))
    # A lower bound of the angle at the rim: between the ball and a plane, or between the ball and the active zone.
    rim_sine = min(_rim_sine(whole_ball, bound), math.sqrt(1 - cosine**2))
    error = tolerance * pixel / solid.size * rim_sine
    refinement = MAX_REFINEMENT
    while refinement >= 2:
        # The cap's rim is the image of the equator; there, points are half as dense as at the cap's centre.
        segments = solid.primitive.segments_for(error * (refinement / 2) ** 2, max_segments)
        depth = refinement**2 * (1 - math.cos(math.pi * solid.primitive.segment_factor / segments))
        cosine = _cosine(distance, reach + depth)
        if cosine is not None and refinement**2 * (1 - cosine) <= 1 + cosine:  # tan(angle / 2) <= 1 / refinement
            return segments, _lorentz(center / distance, refinement)
        refinement *= NEXT_REFINEMENT
    return None


def _cosine(distance: float, reach: float) -> float | None:
    """Returns the cosine of the angular radius of the cap in which a ball intersects the unit sphere.

    ``distance`` is the distance of the ball's centre from the origin, ``reach`` is its radius. Returns None if the cap
    is half of the sphere or more.
    """
    cosine = (distance**2 + 1 - reach**2) / (2 * distance) if distance > 0 else 0.0
    return cosine if 0 < cosine < 1 else None


def _rim_sine(a: Ball, b: Ball) -> float:
    """Returns the sine of half the angle between two balls at their rim, the circle in which they intersect.

    The error of the rim is the error of the faces divided by this sine.
    """
    distance = math.dist(a.center, b.center)
    cosine = (a.radius**2 + b.radius**2 - distance**2) / (2 * a.radius * b.radius)
    between = math.acos(min(max(cosine, -1.0), 1.0))  # the angle between the normals of the two balls at the rim
    return min(math.sin(between / 2), math.cos(between / 2))


def _lorentz(axis: np.ndarray, refinement: float) -> np.ndarray:
    """Returns the projective map (4, 4) of the unit sphere to itself that concentrates points around ``axis``.

    ``axis`` is a fixed point of the map. Distances near ``axis`` shrink by the factor ``refinement``.
    """
    gamma, speed = (refinement + 1 / refinement) / 2, (refinement - 1 / refinement) / 2
    result = np.eye(4)
    result[:3, :3] += (gamma - 1) * np.outer(axis, axis)
    result[:3, 3] = result[3, :3] = speed * axis
    result[3, 3] = gamma
    return result


INSIDE = 1e-6  # the outer quadric's largest allowed value at points of the inner face; it is negative inside
SPACING = 0.004  # how far below 0 the largest value may be if the contact lies between tested points


def shrink_inscribed(solids: list[Solid]) -> None:
    """Sets ``shrink`` of the solids that touch a curved face of another solid from inside.

    The number ``segments`` of all solids must be known.
    """
    curved = [s for s in solids if s.primitive.curved is not None]
    boxes = world_box_corners(curved)
    pairs = [
        (curved[i], curved[j])
        for touching_pairs in sweep(boxes.min(axis=1), boxes.max(axis=1))
        for one, other in zip(*(numbers.tolist() for numbers in touching_pairs))
        for i, j in ((one, other), (other, one))
    ]
    inscribed = [(inner, outer) for inner, outer in pairs if _is_inscribed(inner, outer)]
    # The largest outer solid comes first, so a ball shrinks after the balls that enclose it.
    for inner, outer in sorted(inscribed, key=lambda pair: -abs(np.linalg.det(pair[1].to_world))):
        gap = 1 - outer.inradius * outer.shrink
        factor = max(1 - gap * outer.size / inner.narrowest, 0.5)
        for s in [inner] if inner.curved_surface < 0 else solids:
            if s is inner or s.curved_surface == inner.curved_surface:
                s.shrink = min(s.shrink, factor)


def _is_inscribed(inner: Solid, outer: Solid) -> bool:
    """Whether the inner solid is a ball that lies inside the quadric of the outer solid's curved face, and touches it.

    An inner pipe or cone is excluded: it would touch along a line or with its rim, where a gap would look like a wall.
    """
    if inner.primitive.axes < 3 or inner.curved_surface == outer.curved_surface >= 0:
        return False
    relative = np.linalg.solve(outer.to_world, inner.to_world)
    quadric = outer.primitive.quadrics[outer.primitive.curved]
    points = inner.primitive.surface_lines.reshape(-1, 3)
    for tested in (points[:: max(len(points) // 8, 1)], points):  # for most pairs, the first few points suffice
        p = tested @ relative[:3, :3].T + relative[:3, 3]
        if outer.primitive.two_sheets and (p[:, 2] < -INSIDE).any():
            return False
        value = np.einsum("ij,ij->i", p @ quadric[:3, :3], p) + 2 * p @ quadric[:3, 3] + quadric[3, 3]
        if (value > INSIDE).any():
            return False
    return bool(value.max() > -SPACING - 4 * (1 - outer.inradius))


TOLERANCE = 0.1  # the default of the largest chord error, in pixels
MAX_TRIANGLES = 4_000_000  # the limit for all primitives together; their union takes about 3 GB of memory


def choose_segments(
    document: Document, solids: list[Solid], bounds: list[Ball], camera: Camera, tolerance: float
) -> None:
    """Sets ``segments`` of all solids so that the chord error stays below ``tolerance`` pixels.

    ``bounds`` are balls that contain the active zones of the solids. If only a cap of a ball is in its active zone,
    this function also sets the ball's ``facet_map``. Solids that share a curved face get the same number of segments.
    If the solids would have more than MAX_TRIANGLES triangles, all solids become coarser, and a :class:`SceneWarning`
    is emitted. Raises :class:`SceneError` if even the coarsest meshes have too many triangles.
    """
    requested_tolerance = tolerance
    while True:
        for primitive, numbers in group_equal(s.primitive for s in solids).items():
            matrices = np.array([solids[i].to_world for i in numbers])
            for i, segments in zip(numbers, primitive.segments(matrices, camera, tolerance)):
                solids[i].segments = segments
        segments_of_surface: dict[int, int] = {}
        for s, bound in zip(solids, bounds):
            if (surface := s.curved_surface) >= 0:
                segments_of_surface[surface] = max(segments_of_surface.get(surface, 0), s.segments)
            elif s.primitive.axes == 3:
                cap = refined_cap(s, bound, camera, tolerance)
                s.segments, s.facet_map = cap or (s.segments, IDENTITY)
        for s in solids:
            s.segments = segments_of_surface.get(s.curved_surface, s.segments)
        uses = Counter((s.primitive, s.segments) for s in solids)
        total = sum(count * len(unit_mesh(*key).triangles) for key, count in uses.items())
        if total <= MAX_TRIANGLES:
            break
        if max(s.segments for s in solids) <= MIN_SEGMENTS:
            raise document.error(
                f"the tree's {len(solids):,} different primitives have at least {total:,} triangles; "
                f"expected {MAX_TRIANGLES:,} at most, to limit memory; use fewer primitives",
                "csg",
            )
        tolerance *= 1.5
    if tolerance > requested_tolerance:
        document.warn(
            f"curved faces are approximated to {tolerance:.2g} pixels instead of {requested_tolerance:g}: "
            f"the tree's {len(solids):,} primitives would have more than {MAX_TRIANGLES:,} triangles",
            "csg",
        )


def warn_of_rounding(document: Document, camera: Camera, vertices: np.ndarray) -> None:
    """Warns if single precision, which the renderer has, rounds the eye's coordinates by more than a tenth of a pixel.

    The size of a pixel is measured at the vertex that is nearest to the eye.
    """
    distances = np.linalg.norm(vertices - camera.eye, axis=1)
    pixel = float(camera.footprint(distances.min(initial=math.inf)))
    rounding = float(np.spacing(np.float32(np.abs(camera.eye).max())))
    if rounding > 0.1 * pixel:
        document.warn(
            f"the scene is far from the origin: single precision rounds its coordinates to {rounding:.1g}, "
            f"and a pixel is {pixel:.1g} wide; move the scene to the origin",
            "view",
            "eye",
        )
