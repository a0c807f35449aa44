"""The tessellation of curved faces: the number of segments, and its limits.

- The active zone of a solid (Rossignac and Voelcker 1989) bounds its contribution to the result. A ball around it
  follows from the tree alone.
- Cap refinement: of some balls the result contains only a cap, such as the faces of a lens. The faces meet at a small
  angle, so that an error of the chords is many times larger at the rim. Such a ball has its facets near the cap: a
  Lorentz transformation maps the sphere to itself and concentrates its points around one of them (Penrose 1959). It is
  projective, so that a convex mesh stays convex.
- Inscribed balls touch another solid's curved face from inside, such as a ball in a pipe of the same width. Chords
  approximate both faces. Near the contact the inner facets would penetrate the outer ones and show patches of the wrong
  solid, many pixels wide. So the inner ball shrinks by at most the chord error of the outer solid.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..language.document import Document, subtree_ends
from ..model import Leaf, Operator
from ..view import Camera
from .csg import tree_of
from .grouping import group_equal, sweep
from .primitives import MAX_SEGMENTS, OUTSIDE_SEGMENTS, OUTSIDE_TOLERANCE, box_corners
from .solids import IDENTITY, Solid, world_box_corners


class Ball(NamedTuple):
    """A ball in the world."""

    center: tuple[float, float, float]
    radius: float


UNBOUNDED = Ball((0.0, 0.0, 0.0), math.inf)


def active_zones(csg: Sequence[Operator | Leaf], solids: Sequence[Solid], of_leaf: Sequence[int]) -> list[Ball]:
    """The active zone of each solid: a ball outside of which the solid has no effect; UNBOUNDED if none is known.

    ``csg`` is the tree in prefix order, ``of_leaf`` has the solid of each leaf. A subtracted solid has an effect only
    inside the solid that it is subtracted from, an intersected one only inside the other operand.
    """
    tree, ends = tree_of(csg), subtree_ends(csg)
    if not {"-", "*"} & set(tree):
        return [UNBOUNDED] * len(solids)
    of_solid = bounding_balls(solids)
    value = {"+": union_ball, "-": lambda first, second: first, "*": intersection_ball}
    balls = [UNBOUNDED] * len(tree)  # bounding balls of the values of the nodes
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
    """Bounding balls of solids in the world."""
    result = [UNBOUNDED] * len(solids)
    for primitive, numbers in group_equal(s.primitive for s in solids).items():
        places = np.array([solids[i].to_world for i in numbers])
        _, center, radius = primitive.ball(places[:, :3, :3])
        for i, (x, y, z), r in zip(numbers, (center + places[:, :3, 3]).tolist(), radius.tolist()):
            result[i] = Ball((x, y, z), r)
    return result


def union_ball(a: Ball, b: Ball) -> Ball:
    """The bounding ball of two balls."""
    distance = math.dist(a.center, b.center)
    small, large = sorted((a, b), key=lambda ball: ball.radius)
    if not distance + small.radius > large.radius:
        return large
    radius = (distance + a.radius + b.radius) / 2
    return Ball(_between(a, b, (radius - a.radius) / distance), radius)


def intersection_ball(a: Ball, b: Ball) -> Ball:
    """A bounding ball of the intersection of two balls."""
    small = min(a, b, key=lambda ball: ball.radius)
    distance = math.dist(a.center, b.center)
    if max(a.radius, b.radius) == math.inf or distance**2 <= abs(a.radius**2 - b.radius**2):
        return small
    # The distance along their axis from a's centre to the plane of their common circle.
    along = (distance + (a.radius - b.radius) * (a.radius + b.radius) / distance) / 2
    return Ball(_between(a, b, along / distance), math.sqrt(max((a.radius - along) * (a.radius + along), 0.0)))


def _between(a: Ball, b: Ball, share: float) -> tuple[float, float, float]:
    x, y, z = (p + share * (q - p) for p, q in zip(a.center, b.center))
    return x, y, z


MAX_REFINEMENT = 64.0  # the largest factor by which points of a cap are denser than on the whole ball
STEP = math.sqrt(0.5)
CORNERS = box_corners(np.array([[-1.0] * 3, [1.0] * 3]))


def refined_cap(solid: Solid, bound: Ball, camera: Camera, tolerance: float) -> tuple[int, np.ndarray] | None:
    """Segments and ``facet_map`` of a ball whose active zone is ``bound``; None if the zone is larger than a cap.

    The chord error stays below ``tolerance`` pixels, also at the rim. Facets far from the cap are coarse and lie deep
    inside the ball. That depth must not reach the active zone.
    """
    if bound.radius == math.inf:
        return None
    (own,) = bounding_balls([solid])
    zone = intersection_ball(bound, own)
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
    # The angle at the rim is at least that of a plane, or of these two balls.
    rim_sine = min(_rim_sine(own, bound), math.sqrt(1 - cosine**2))
    error = tolerance * pixel / solid.size * rim_sine
    refinement = MAX_REFINEMENT
    while refinement >= 2:
        # The rim of the cap is the image of the equator, where the density is half of that in the middle.
        segments = solid.primitive.segments_for(error * (refinement / 2) ** 2, max_segments)
        depth = refinement**2 * (1 - math.cos(math.pi * solid.primitive.segment_factor / segments))
        cosine = _cosine(distance, reach + depth)
        if cosine is not None and refinement**2 * (1 - cosine) <= 1 + cosine:  # tan(angle / 2) <= 1 / refinement
            return segments, _lorentz(center / distance, refinement)
        refinement *= STEP
    return None


def _cosine(distance: float, reach: float) -> float | None:
    """Cosine of the angle of the cap in which a ball of the radius ``reach`` intersects the unit sphere.

    None if the cap is half of the sphere or more.
    """
    cosine = (distance**2 + 1 - reach**2) / (2 * distance) if distance > 0 else 0.0
    return cosine if 0 < cosine < 1 else None


def _rim_sine(a: Ball, b: Ball) -> float:
    """Sine of half the angle between two balls at their rim; the error there is that of the faces, divided by it."""
    distance = math.dist(a.center, b.center)
    cosine = (a.radius**2 + b.radius**2 - distance**2) / (2 * a.radius * b.radius)
    between = math.acos(min(max(cosine, -1.0), 1.0))  # their normals at the rim
    return min(math.sin(between / 2), math.cos(between / 2))


def _lorentz(axis: np.ndarray, refinement: float) -> np.ndarray:
    """The projective map (4, 4) of the unit sphere to itself that concentrates points around ``axis``.

    Distances near ``axis``, a fixed point, shrink by the factor ``refinement``.
    """
    gamma, speed = (refinement + 1 / refinement) / 2, (refinement - 1 / refinement) / 2
    result = np.eye(4)
    result[:3, :3] += (gamma - 1) * np.outer(axis, axis)
    result[:3, 3] = result[3, :3] = speed * axis
    result[3, 3] = gamma
    return result


INSIDE = 1e-6  # the largest value of the outer quadric at points of the inner face; 0 on the quadric, -1 in its middle
SPACING = 0.004  # how far below 0 that value may be where the faces touch between the tested points


def shrink_inscribed(solids: list[Solid]) -> None:
    """Sets ``shrink`` of the solids that touch another's curved face from inside; needs their ``segments``."""
    curved = [s for s in solids if s.primitive.curved is not None]
    boxes = world_box_corners(curved)
    pairs = [
        (curved[i], curved[j])
        for some in sweep(boxes.min(axis=1), boxes.max(axis=1))
        for one, other in zip(*(numbers.tolist() for numbers in some))
        for i, j in ((one, other), (other, one))
    ]
    inscribed = [(inner, outer) for inner, outer in pairs if _is_inscribed(inner, outer)]
    # Of a chain of inscribed balls the largest one first: each shrinks after the balls around it.
    for inner, outer in sorted(inscribed, key=lambda pair: -abs(np.linalg.det(pair[1].to_world))):
        gap = 1 - outer.inradius * outer.shrink
        factor = max(1 - gap * outer.size / inner.narrowest, 0.5)
        for s in [inner] if inner.curved_surface < 0 else solids:
            if s is inner or s.curved_surface == inner.curved_surface:
                s.shrink = min(s.shrink, factor)


def _is_inscribed(inner: Solid, outer: Solid) -> bool:
    """Whether the inner solid is a ball inside the quadric of the outer one's curved face, and touches it.

    A pipe or a cone would touch it along a generator or with its rim, where a gap would look like a wall.
    """
    if inner.primitive.axes < 3 or inner.curved_surface == outer.curved_surface >= 0:
        return False
    relative = np.linalg.solve(outer.to_world, inner.to_world)
    quadric = outer.primitive.quadrics[outer.primitive.curved]
    points = inner.primitive.lines.reshape(-1, 3)
    for some in (points[:: max(len(points) // 8, 1)], points):  # few points decide most pairs
        p = some @ relative[:3, :3].T + relative[:3, 3]
        if outer.primitive.two_sheets and (p[:, 2] < -INSIDE).any():
            return False
        value = np.einsum("ij,ij->i", p @ quadric[:3, :3], p) + 2 * p @ quadric[:3, 3] + quadric[3, 3]
        if (value > INSIDE).any():
            return False
    return bool(value.max() > -SPACING - 4 * (1 - outer.inradius))


TOLERANCE = 0.1  # chord error in pixels
MAX_TRIANGLES = 4_000_000  # of all primitives; their union takes about 3 GB


def choose_segments(
    document: Document, solids: list[Solid], bounds: list[Ball], camera: Camera, tolerance: float
) -> None:
    """Sets ``segments`` of all solids, so that the chord error stays below ``tolerance`` pixels.

    ``bounds`` are their active zones; where one leaves only a cap of a ball, this sets the ball's ``facet_map`` too.
    Solids with a common curved face get the same number. Above MAX_TRIANGLES all solids become coarser, with a
    :class:`SceneWarning`; if the coarsest are too many, this raises :class:`SceneError`.
    """
    wanted = tolerance
    while True:
        for primitive, numbers in group_equal(s.primitive for s in solids).items():
            places = np.array([solids[i].to_world for i in numbers])
            for i, segments in zip(numbers, primitive.segments(places, camera, tolerance)):
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
        total = sum(s.primitive.count(s.segments) for s in solids)
        if total <= MAX_TRIANGLES:
            break
        if total <= sum(s.primitive.count(0) for s in solids):
            raise document.error(
                f"the tree's {len(solids):,} different primitives have at least {total:,} triangles; "
                f"expected {MAX_TRIANGLES:,} at most, to limit memory; use fewer primitives",
                "csg",
            )
        tolerance *= 1.5
    if tolerance > wanted:
        document.warn(
            f"curved faces are approximated to {tolerance:.2g} pixels instead of {wanted:g}: "
            f"the tree's {len(solids):,} primitives would have more than {MAX_TRIANGLES:,} triangles",
            "csg",
        )


def warn_of_rounding(document: Document, camera: Camera, vertices: np.ndarray) -> None:
    """Warns if the rounding of the renderer's single precision is large against a pixel at the nearest vertex."""
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
