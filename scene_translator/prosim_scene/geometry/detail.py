"""The tessellation of curved faces: the number of segments, and its limits.

- What of a solid can be left in the result: its active zone (Rossignac and Voelcker 1989), a ball that contains it,
  found from the tree alone.
- Balls of which no more than a cap is left, such as the faces of a lens. Facets that are chosen for the whole ball
  would leave a rim with few corners, which lies wrong by many times the chord error, as the faces meet there at a small
  angle. So such a ball has its facets where the cap is. There is a family of maps that take the sphere to itself and
  crowd its points about one of them: the Lorentz transformations, by which the sky of a traveller crowds ahead (Penrose
  1959). They are projective, so that a convex mesh stays one.
- Balls that touch another solid's curved face from within, such as a ball in a pipe of its own width. Both faces are
  approximated by chords, and near the line or the point where they touch, the inner one's facets would stand out of the
  outer one's: patches of the wrong solid, many pixels wide although far thinner than a pixel. So the inner one is made
  smaller, by no more than the chord error of the outer one.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..camera import Camera
from ..language.document import Document
from ..model import Leaf, Operator
from .grouping import alike, sweep
from .primitives import MAX_SEGMENTS, UNSEEN_SEGMENTS, UNSEEN_TOLERANCE, box_corners
from .solids import IDENTITY, Solid, corners


class Ball(NamedTuple):
    """A ball in the world."""

    center: tuple[float, float, float]
    radius: float


EVERYWHERE = Ball((0.0, 0.0, 0.0), math.inf)


def active_zones(nodes: Sequence[Operator | Leaf], solids: Sequence[Solid], of_leaf: Sequence[int]) -> list[Ball]:
    """For each of the solids a ball, outside of which it does not matter to the result; EVERYWHERE, if none is known.

    ``of_leaf``: the solid of each leaf. What is taken away matters in what it is taken from, and each of two solids
    that are intersected in the other.
    """
    result = [EVERYWHERE] * len(solids)
    if all(node.symbol == "+" for node in nodes if not isinstance(node, Leaf)):
        return result
    balls_of = around(solids)
    leaves = np.zeros(len(nodes), int)
    leaves[[i for i, node in enumerate(nodes) if isinstance(node, Leaf)]] = of_leaf
    balls = [EVERYWHERE] * len(nodes)  # around the value of each node
    operands: list[tuple[int, int]] = [(0, 0)] * len(nodes)
    stack: list[int] = []
    for i in range(len(nodes) - 1, -1, -1):
        node = nodes[i]
        if isinstance(node, Leaf):
            balls[i] = balls_of[leaves[i]]
        else:
            a, b = operands[i] = stack.pop(), stack.pop()
            first, second = balls[a], balls[b]
            balls[i] = first if node.symbol == "-" else (joined if node.symbol == "+" else meeting)(first, second)
        stack.append(i)
    bounds = [EVERYWHERE] * len(nodes)
    for i, node in enumerate(nodes):
        if isinstance(node, Leaf):
            result[leaves[i]] = bounds[i] if result[leaves[i]] is EVERYWHERE else joined(result[leaves[i]], bounds[i])
        else:
            a, b = operands[i]
            bounds[a] = meeting(bounds[i], balls[b]) if node.symbol == "*" else bounds[i]
            bounds[b] = bounds[i] if node.symbol == "+" else meeting(bounds[i], balls[a])
    return result


def clipped(corners: np.ndarray, balls: Sequence[Ball]) -> np.ndarray:
    """The corners (n, 8, 3) of boxes, each moved into the box around a ball as far as it lies without."""
    center = np.array([ball.center for ball in balls])[:, None]
    radius = np.array([ball.radius for ball in balls])[:, None, None]
    return np.asarray(np.clip(corners, center - radius, center + radius))


def around(solids: Sequence[Solid]) -> list[Ball]:
    """Balls around solids at their places."""
    result = [EVERYWHERE] * len(solids)
    for primitive, numbers in alike(s.primitive for s in solids).items():
        places = np.array([solids[i].to_world for i in numbers])
        linear, offset = places[:, :3, :3], places[:, :3, 3]
        if primitive.curved is None:
            corners = primitive.box_corners @ linear.transpose(0, 2, 1)
            center = corners.mean(axis=1)
            radius = np.linalg.norm(corners - center[:, None], axis=2).max(axis=1)
        else:
            _, center, radius = primitive.ball(linear)
        for i, (x, y, z), r in zip(numbers, (center + offset).tolist(), radius.tolist()):
            result[i] = Ball((x, y, z), r)
    return result


def joined(a: Ball, b: Ball) -> Ball:
    """A ball around two."""
    apart = math.dist(a.center, b.center)
    small, large = sorted((a, b), key=lambda ball: ball.radius)
    if not apart + small.radius > large.radius:
        return large
    radius = (apart + a.radius + b.radius) / 2
    return Ball(_between(a, b, (radius - a.radius) / apart), radius)


def meeting(a: Ball, b: Ball) -> Ball:
    """A ball around what two have in common."""
    small = min(a, b, key=lambda ball: ball.radius)
    apart = math.dist(a.center, b.center)
    if max(a.radius, b.radius) == math.inf or apart**2 <= abs(a.radius**2 - b.radius**2):
        return small
    along = (apart + (a.radius - b.radius) * (a.radius + b.radius) / apart) / 2  # to the circle that they meet in
    return Ball(_between(a, b, along / apart), math.sqrt(max((a.radius - along) * (a.radius + along), 0.0)))


def _between(a: Ball, b: Ball, share: float) -> tuple[float, float, float]:
    x, y, z = (p + share * (q - p) for p, q in zip(a.center, b.center))
    return x, y, z


CLOSEST = 64.0  # the largest factor by which points of a cap are nearer to one another than on the whole ball
STEP = math.sqrt(0.5)
CORNERS = box_corners(np.array([[-1.0] * 3, [1.0] * 3]))


def refined_cap(solid: Solid, bound: Ball, camera: Camera, tolerance: float) -> tuple[int, np.ndarray] | None:
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
    error = tolerance * pixel / solid.size * slant
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
    """Sine of half the angle at which two balls meet: the error of their rim is that of their faces over this."""
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


CONTAINED = 1e-6  # of the outer quadric's value at points of the inner face; 0 on the quadric, -1 in its middle
SPACING = 0.004  # how far below 0 that value may be where the faces touch between the points that are looked at


def shrink_inscribed(solids: list[Solid]) -> None:
    """Sets ``shrink`` of the solids that touch another's curved face from within; ``segments`` have been chosen."""
    curved = [s for s in solids if s.primitive.curved is not None]
    pairs = _touching(curved)
    bounds = [
        (inner, outer)
        for i, j in pairs
        for inner, outer in ((curved[i], curved[j]), (curved[j], curved[i]))
        if _touches_within(inner, outer)
    ]
    for _ in range(len(bounds)):  # a chain of inscribed solids takes as many rounds as it is long
        changed = False
        for inner, outer in bounds:
            gap = 1 - outer.inradius * outer.shrink
            factor = max(1 - gap * outer.size / inner.narrowest, 0.5)
            if factor < inner.shrink:
                changed = True
                for s in [inner] if inner.curved_surface < 0 else solids:
                    if s is inner or s.curved_surface == inner.curved_surface:
                        s.shrink = factor
        if not changed:
            break


def _touching(solids: list[Solid]) -> list[tuple[int, int]]:
    """Pairs of solids with overlapping boxes and different curved faces."""
    boxes = corners(solids)
    surface = np.array([s.curved_surface for s in solids])
    found = []
    for first, second in sweep(boxes.min(axis=1), boxes.max(axis=1)):
        chosen = (surface[first] < 0) | (surface[first] != surface[second])
        found += list(zip(first[chosen].tolist(), second[chosen].tolist()))
    return found


def _touches_within(inner: Solid, outer: Solid) -> bool:
    """Whether the inner solid is a ball that lies within the quadric of the outer one's curved face, and touches it.

    A pipe or a cone would touch it along a generator or with its rim, where a gap could be taken for a wall.
    """
    if inner.primitive.axes < 3:
        return False
    relative = np.linalg.solve(outer.to_world, inner.to_world)
    quadric = outer.primitive.quadrics[outer.primitive.curved]
    points = inner.primitive.lines.reshape(-1, 3)
    for some in (points[:: max(len(points) // 8, 1)], points):  # few points tell most pairs apart
        p = some @ relative[:3, :3].T + relative[:3, 3]
        if outer.primitive.two_sheets and (p[:, 2] < -CONTAINED).any():
            return False
        value = np.einsum("ij,ij->i", p @ quadric[:3, :3], p) + 2 * p @ quadric[:3, 3] + quadric[3, 3]
        if (value > CONTAINED).any():
            return False
    return bool(value.max() > -SPACING - 4 * (1 - outer.inradius))


TOLERANCE = 0.1  # chord error in pixels
MOST_TRIANGLES = 4_000_000  # of all primitives, about 3 GB while they are united


def choose_segments(
    document: Document, solids: list[Solid], bounds: list[Ball], camera: Camera, tolerance: float
) -> None:
    """Sets ``segments`` of all solids, so that the chord error stays below ``tolerance`` pixels.

    They do not matter outside of ``bounds``; where such a one leaves a cap of a ball, its ``frame`` is set too. Solids
    with a common curved face get the same number. Where that would be more than MOST_TRIANGLES, all are coarser,
    with a :class:`SceneWarning`; where even the coarsest are, that is a :class:`SceneError`.
    """
    wanted = tolerance
    while True:
        for primitive, numbers in alike(s.primitive for s in solids).items():
            places = np.array([solids[i].to_world for i in numbers])
            for i, segments in zip(numbers, primitive.segments(places, camera, tolerance)):
                solids[i].segments = segments
        most: dict[int, int] = {}
        for s, bound in zip(solids, bounds):
            if (surface := s.curved_surface) >= 0:
                most[surface] = max(most.get(surface, 0), s.segments)
            elif s.primitive.axes == 3:
                cap = refined_cap(s, bound, camera, tolerance)
                s.segments, s.frame = cap or (s.segments, IDENTITY)
        for s in solids:
            s.segments = most.get(s.curved_surface, s.segments)
        total = sum(s.primitive.count(s.segments) for s in solids)
        if total <= MOST_TRIANGLES:
            break
        if total <= sum(s.primitive.count(0) for s in solids):
            raise document.error(
                f"the tree's {len(solids):,} different primitives have at least {total:,} triangles; "
                f"expected {MOST_TRIANGLES:,} at most, which is what memory is provided for",
                "csg",
            )
        tolerance *= 1.5
    if tolerance > wanted:
        document.warn(
            f"curved faces are approximated to {tolerance:.2g} pixels instead of {wanted:g}: "
            f"the tree's {len(solids):,} primitives would have more than {MOST_TRIANGLES:,} triangles",
            "csg",
        )


def warn_if_far(document: Document, camera: Camera, boxes: np.ndarray) -> None:
    """A :class:`SceneWarning` where single precision, in which the renderer computes, is coarse against a pixel.

    ``boxes`` (n, 8, 3) are corners of boxes around the solids.
    """
    low, high = boxes.min(axis=1), boxes.max(axis=1)
    nearest = np.linalg.norm(np.clip(camera.eye, low, high) - camera.eye, axis=1).min()
    pixel = float(camera.footprint(nearest))
    grain = float(np.spacing(np.float32(np.abs(camera.eye).max())))
    if grain > 0.1 * pixel:
        document.warn(
            f"the scene lies so far from the origin that its coordinates are rounded to {grain:.1g} (single precision) "
            f"where a pixel is {pixel:.1g} wide: moved to the origin, it is seen more exactly",
            "view",
            "eye",
        )
