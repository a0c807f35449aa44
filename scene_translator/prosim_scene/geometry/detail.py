"""Chooses the tessellation of curved faces: the number of segments that approximate a circle, and where facets are
concentrated.

- The active zone of a solid (Rossignac and Voelcker 1989) is a region outside of which the solid has no effect on the
  result of the CSG tree. A ball that contains the active zone is computed from the tree and from bounding balls,
  without an evaluation of the tree.
- Cap refinement: sometimes only a spherical cap of a ball is a part of the result, for example a face of a lens. The
  two faces of a lens meet at a small angle, so the error of the lens's rim is many times larger than the chord error of
  the faces. If only a cap of a ball is a part of the result, the ball's facets are concentrated near the cap by a
  Lorentz transformation, which maps the sphere to itself and concentrates its points around one point (Penrose 1959). A
  Lorentz transformation is a projective map, so a convex mesh stays convex.
- An inscribed ball touches a curved face of another solid from inside, for example a ball in a pipe of the same width.
  The mesh approximates the faces of both the ball and the pipe by flat facets. Near the contact of the ball with the
  pipe, the facets of the ball would penetrate the facets of the pipe, and patches of the wrong solid would be visible,
  many pixels wide. Therefore an inscribed ball is made smaller by at most the chord error of the outer solid.
"""

import math
from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from ..language.document import Document
from ..view import Camera
from .csg import Tree, fold
from .grouping import group_equal, sweep
from .primitives import MAX_SEGMENTS, MIN_SEGMENTS
from .solids import IDENTITY, Solid, unit_mesh, world_box_corners

#: A bounding ball of an operand, the number of its first leaf, and the number after its last leaf.
_Operand = tuple[np.ndarray, int, int]


def active_zones(tree: Tree, solids: Sequence[Solid], of_leaf: np.ndarray) -> np.ndarray:
    """Returns a ball for each solid (n, 4): outside its ball, a solid with only one leaf has no effect on the CSG
    tree's result.

    Each row of the result is the centre and the radius of a ball. The radius is infinite if the CSG tree does not limit
    the region in which the solid has an effect. ``of_leaf`` has, for each leaf, the number of its solid. A subtracted
    solid has an effect only inside the solid from which it is subtracted. An operand of an intersection has an effect
    only inside the other operand.
    """
    balls = np.empty((len(solids), 4))
    for primitive, numbers in group_equal(s.primitive for s in solids).items():
        _, balls[numbers] = primitive.ball(np.array([solids[i].to_world for i in numbers]))
    zones = np.tile([0.0, 0.0, 0.0, math.inf], (len(solids), 1))

    def combine(symbol: str, first: _Operand, second: _Operand) -> _Operand:
        """Returns a bounding ball of an operator's result, and the range of the leaf numbers of both operands; updates
        ``zones``.

        Each operand is a tuple: a bounding ball, the number of its first leaf, and the number after its last leaf.
        """
        (a, begin, middle), (b, _, end) = first, second
        if symbol == "+":
            large, small = (a, b) if a[3] > b[3] else (b, a)
            radius = max(large[3], math.dist(large[:3], small[:3]) + small[3])
            return np.append(large[:3], radius), begin, end
        zones[of_leaf[middle:end]] = _smaller(zones[of_leaf[middle:end]], a)
        if symbol == "*":
            zones[of_leaf[begin:middle]] = _smaller(zones[of_leaf[begin:middle]], b)
            a = _smaller(a, b)
        return a, begin, end

    fold(tree, lambda number: (balls[of_leaf[number]], number, number + 1), combine)
    return zones


def _smaller(balls: np.ndarray, ball: np.ndarray) -> np.ndarray:
    """Returns a copy of ``balls`` (..., 4) in which ``ball`` replaces each ball with a larger radius."""
    return np.where(balls[..., 3:] <= ball[3], balls, ball)


def refined_cap(solid: Solid, zone: np.ndarray, camera: Camera, tolerance: float) -> tuple[int, np.ndarray]:
    """Returns the number of segments and the ``facet_map`` of a ball; if only a small cap of the ball has an effect on
    the CSG tree's result, the facets are concentrated near this cap.

    ``solid.segments`` is the number of segments without cap refinement. Outside the ball ``zone`` (centre, radius), the
    solid has no effect on the CSG tree's result. If ``zone`` and the surface of the ball have no small cap in common,
    or the ball has only MIN_SEGMENTS segments, returns ``solid.segments`` and the identity. The chord error stays below
    ``tolerance`` pixels, also at the rim of the cap, if the limits of :meth:`.Primitive.segments` allow it.
    """
    axis = np.linalg.solve(solid.to_world, [*zone[:3], 1])[:3]
    distance, radius = float(np.linalg.norm(axis)), float(zone[3]) / solid.narrowest
    # The cosine of the cap's angular radius.
    cosine = ((distance - radius) * (distance + radius) + 1) / (2 * distance) if distance > 0 else 1.0
    # The refinement of a larger cap would be below 2. A ball with the fewest segments is too small for a visible cap.
    if not 0.6 < cosine < 1 or solid.segments == MIN_SEGMENTS:
        return solid.segments, IDENTITY
    # Far from the cap, the facets lie deep inside the ball, by up to refinement^2 times the chord error. With at least
    # this ratio of segments to refinement, these facets do not reach the zone.
    ratio = 4 / math.sqrt(min(distance, 1))
    refinement = min(math.sqrt((1 + cosine) / (1 - cosine)), MAX_SEGMENTS / ratio)  # maps a half of the ball to the cap
    # The error of the rim is the error of the faces divided by a sine: of half the angle between two curved faces, or
    # of the angle between the ball and a plane. The square of the former follows from the triangle of a point of the
    # rim and the two centres. At the rim, distances of points shrink by half the refinement.
    square = (distance + radius - 1) * (distance - radius + 1) / (4 * radius)
    sine = math.sqrt(max(min(square, 1 - square, 1 - cosine**2), 0))
    (segments,) = solid.primitive.segments(solid.to_world[None], camera, tolerance * sine * (refinement / 2) ** 2)
    # Fewer segments than that ratio: a smaller refinement with more segments has the same error.
    excess = max(math.sqrt(ratio * refinement / segments), 1)
    return 4 * math.ceil(segments * excess / 4), _lorentz(axis / distance, refinement / excess)


def _lorentz(axis: np.ndarray, refinement: float) -> np.ndarray:
    """Returns the projective map (4, 4) of the unit sphere to itself that concentrates points around ``axis``.

    The map is a Lorentz transformation, which makes the facets of a ball smaller near a visible cap. The unit vector
    ``axis`` is a fixed point of the map. Near the point ``axis``, the map divides distances by ``refinement``; near the
    opposite point -``axis``, the map multiplies distances by ``refinement``.
    """
    near, far = np.append(axis, 1), np.append(axis, -1)  # eigenvectors; each has the squared length 2
    return np.eye(4) + (refinement - 1) / 2 * np.outer(near, near) + (1 / refinement - 1) / 2 * np.outer(far, far)


INSIDE = 1e-6  # how far a ball that touches a face from inside may be outside, relative to the size of the face
SPACING = 0.002  # how far this ball may be inside; the contact may lie between the tested points of the face
FEW = 64  # a 64th of the tangent planes of a face is tested first, which excludes most balls
#: Maximum number of enclosing solids that are stored for a solid: one is enough to leave it out, and more take memory.
MAX_ENCLOSING = 64
BATCH = 1 << 16  # the number of pairs of a ball and a tangent plane that are tested at a time


def shrink_inscribed(solids: list[Solid]) -> None:
    """Sets the factor ``shrink`` of each ball that touches a curved face of another solid from inside, and the set
    ``enclosing`` of each ball that lies inside other balls.

    The factor is 1 - e/r, but at least 0.5, where e is the chord error of the outer solid and r the shortest semi-axis
    of the ball. If a ball touches several solids, the smallest factor counts. All balls on one surface get the same
    factor. The attribute ``segments`` of all solids must be set before.
    """
    curved = [s for s in solids if s.primitive.curved is not None]
    surfaces = np.array([s.curved_surface if s.curved_surface >= 0 else -1 - i for i, s in enumerate(curved)], int)
    inscribed: dict[int, list[int]] = {}  # the balls inside each outer solid
    for ball, outer, enclosed, touches in _inner_balls(curved, surfaces):
        if enclosed and len(curved[ball].enclosing) < MAX_ENCLOSING:
            curved[ball].enclosing.add(curved[outer])
        if touches:
            inscribed.setdefault(outer, []).append(ball)
    # The largest outer solid comes first, so a ball shrinks after the balls that enclose it.
    for outer in sorted(inscribed, key=lambda i: -abs(np.linalg.det(curved[i].to_world))):
        (size,), _ = curved[outer].primitive.ball(curved[outer].to_world[None])
        error = (1 - curved[outer].inradius * curved[outer].shrink) * size
        for ball in inscribed[outer]:
            factor = max(1 - error / curved[ball].narrowest, 0.5)
            if factor < curved[ball].shrink:
                for i in np.flatnonzero(surfaces == surfaces[ball]).tolist():
                    curved[i].shrink = factor


def find_enclosing(solids: Sequence[Solid]) -> None:
    """Adds other solids to the set ``enclosing`` of each solid: those that contain the bounding box of the primitive.

    Two solids that share a surface are excluded, because faces of the two solids may coincide. Solids of mesh files are
    excluded, because the solid of a mesh file need not be convex.
    At most :data:`MAX_ENCLOSING` enclosing solids of a solid are stored.
    """
    solids = [s for s in solids if len(s.primitive.quadrics)]
    boxes = world_box_corners(solids)
    to_local = np.linalg.inv(np.array([s.to_world for s in solids]).reshape(-1, 4, 4))
    low, high = boxes.min(axis=1), boxes.max(axis=1)
    for pairs in sweep(low, high):
        inner, outer = np.concatenate([pairs, pairs[::-1]], axis=1)
        within = ((low[outer] <= low[inner]) & (high[inner] <= high[outer])).all(axis=1)
        for primitive, numbers in group_equal(s.primitive for s in solids).items():
            a, b = (pair[within & np.isin(outer, numbers)] for pair in (inner, outer))
            corners = boxes[a] @ to_local[b, :3, :3].transpose(0, 2, 1) + to_local[b, None, :3, 3]
            inside = ((corners >= primitive.box[0]) & (corners <= primitive.box[1])).all(axis=(1, 2))
            if primitive.curved is not None:
                quadric = np.diag(primitive.quadrics[primitive.curved])
                inside &= (corners**2 @ quadric[:3] + quadric[3] <= 0).all(axis=1)
            for i, j in zip(a[inside].tolist(), b[inside].tolist()):
                if len(solids[i].enclosing) < MAX_ENCLOSING and {*solids[i].surfaces} & {*solids[j].surfaces} <= {-1}:
                    solids[i].enclosing.add(solids[j])


def _inner_balls(solids: Sequence[Solid], surfaces: np.ndarray) -> Iterator[tuple[int, int, bool, bool]]:
    """Yields the number of a ball, the number of an outer solid, whether the outer solid is a ball that encloses the
    ball, and whether the ball touches the outer solid's curved face, for each ball inside the quadric of such a face.

    A ball also touches the face if its distance from the face is at most about twice the chord error of the face.

    ``surfaces`` (n,) has, for each solid, the number of the surface on which its curved face lies; two balls on the
    same surface are no pair. Cylinders and cones inside other solids are excluded: they would touch the outer solid
    along a line or with their rim, where a gap would look like a wall.
    """
    boxes, to_world = world_box_corners(solids), np.array([s.to_world for s in solids]).reshape(-1, 4, 4)
    to_local, depth = np.linalg.inv(to_world), np.array([SPACING + 2 * (1 - s.inradius) for s in solids])
    is_ball = np.array([s.primitive.axes == 3 for s in solids])
    for pairs in sweep(boxes.min(axis=1), boxes.max(axis=1)):
        inner, outer = np.concatenate([pairs, pairs[::-1]], axis=1)
        compared = np.stack([inner, outer])[:, is_ball[inner] & (surfaces[inner] != surfaces[outer])]
        for primitive, numbers in group_equal(s.primitive for s in solids).items():
            # A ball lies inside a convex face if it lies on the inner side of each tangent plane of the face.
            quadric = np.diag(primitive.quadrics[primitive.curved])
            normals = primitive.surface_lines[:, 1] * quadric[:3]
            inside = compared[:, np.isin(compared[1], numbers)]
            for tested in (normals[::FEW], normals):
                distances = []
                for part in np.array_split(inside, inside.shape[1] * len(tested) // BATCH + 1, axis=1):
                    planes = (to_local[part[1]] @ to_world[part[0]])[:, :3].transpose(0, 2, 1) @ tested.T
                    radii = np.sqrt(np.einsum("kim,kim->km", planes[:, :3], planes[:, :3]))
                    distances.append(np.max(planes[:, 3] + radii, axis=1) + quadric[3])
                distance = np.concatenate(distances)
                inside, distance = inside[:, distance <= INSIDE], distance[distance <= INSIDE]
            relative = (to_local[inside[1]] @ to_world[inside[0]])[:, :3]
            reach = np.linalg.norm(relative[..., :3], 2, (1, 2)) + np.linalg.norm(relative[..., 3], axis=1)
            yield from zip(*inside.tolist(), is_ball[inside[1]] & (reach <= 1), distance > -depth[inside[1]])


TOLERANCE = 0.1  # the default of the largest chord error, in pixels
MAX_TRIANGLES = 4_000_000  # the limit for all primitives together; their union takes about 3 GB of memory


def choose_segments(
    document: Document, solids: list[Solid], zones: np.ndarray, camera: Camera, tolerance: float
) -> None:
    """Sets ``segments`` of all solids so that the chord error stays below ``tolerance`` pixels.

    ``zones`` (n, 4) are the balls that :func:`active_zones` returns. If only a cap of a ball has an effect on the CSG
    tree's result, this function also sets the ball's ``facet_map``. Solids that share a curved face get the same number
    of segments. If the solids would have more than MAX_TRIANGLES triangles, all solids become coarser, and a
    :class:`SceneWarning` is emitted. Raises :class:`SceneError` if even the coarsest meshes have too many triangles.
    """
    requested_tolerance = tolerance
    while True:
        for primitive, numbers in group_equal(s.primitive for s in solids).items():
            matrices = np.array([solids[i].to_world for i in numbers])
            for i, segments in zip(numbers, primitive.segments(matrices, camera, tolerance).tolist()):
                solids[i].segments = segments
        segments_of_surface: dict[int, int] = {}
        for s, zone in zip(solids, zones):
            if (surface := s.curved_surface) >= 0:
                segments_of_surface[surface] = max(segments_of_surface.get(surface, 0), s.segments)
            elif s.primitive.axes == 3 and zone[3] < math.inf:
                s.segments, s.facet_map = refined_cap(s, zone, camera, tolerance)
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
    """Warns if the renderer's single precision rounds the eye's coordinates by more than a tenth of a pixel.

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
