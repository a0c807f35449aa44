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
- Curved faces that touch from inside, such as a ball in a pipe of the same width: see :mod:`.contacts`.
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..language.document import Document
from ..view import Camera
from .contacts import adapt, find_contacts
from .csg import Tree, fold, tree_of
from .grouping import group_equal
from .primitives import MAX_SEGMENTS, MIN_SEGMENTS, OUTSIDE_TOLERANCE
from .solids import IDENTITY, Solid, plane_heights, unit_mesh

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
    distance, radius = float(np.linalg.norm(axis)), float(zone[3] / np.linalg.norm(solid.to_world[:3, :3], -2))
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
    """Returns the projective map (4, 4) of the unit sphere to itself that divides distances by ``refinement`` near the
    unit vector ``axis``, and multiplies distances by ``refinement`` near the opposite point.
    """
    near, far = np.append(axis, 1), np.append(axis, -1)  # eigenvectors; each has the squared length 2
    return np.eye(4) + (refinement - 1) / 2 * np.outer(near, near) + (1 / refinement - 1) / 2 * np.outer(far, far)


ROUNDED = 1.02  # the error may exceed the tolerance by this factor: bounds of it are not exact
TOLERANCE = 0.1  # the default of the largest chord error, in pixels
MAX_TRIANGLES = 2_000_000  # the limit for all primitives together; their union takes about 2 GB of memory


def with_segments(
    document: Document, solids: Sequence[Solid], of_leaf: np.ndarray, camera: Camera, tolerance: float
) -> list[Solid]:
    """Returns the solids with ``segments``, and some with ``facet_map`` and ``scale``, so that the meshes are less than
    ``tolerance`` pixels away from the curved faces, and meshes of faces that touch from inside do not cross.

    ``of_leaf`` has, for each leaf, the number of its solid. If the solids would have more than MAX_TRIANGLES triangles,
    all solids become coarser. A :class:`SceneWarning` names solids that are coarser than the tolerance. Raises
    :class:`SceneError` if even the coarsest meshes have too many triangles.
    """
    zones = active_zones(tree_of(document.scene.csg), solids, of_leaf)
    allowed, visible = np.ones(len(solids)), np.zeros(len(solids), bool)
    for primitive, numbers in group_equal(s.primitive for s in solids).items():
        if primitive.curved is not None:
            pixel, visible[numbers] = primitive.pixel(np.array([solids[i].to_world for i in numbers]), camera)
            allowed[numbers] = np.where(visible[numbers], 1, OUTSIDE_TOLERANCE) * tolerance * pixel
    chosen, reached = choose_segments(document, solids, zones, camera, tolerance, np.ones(len(solids)))
    contacts = find_contacts(chosen)
    if len(contacts.outer):
        chosen, reached = choose_segments(document, solids, zones, camera, tolerance, contacts.shares(allowed))
    if reached > tolerance:
        document.warn(
            f"curved faces are approximated to {reached:.2g} pixels instead of {tolerance:g}: "
            f"the tree's {len(solids):,} primitives would have more than {MAX_TRIANGLES:,} triangles",
            "csg",
        )
    inradius = np.array([s.inradius for s in chosen])
    for i in set(contacts.outer.tolist()):
        inradius[i] = _inradius(chosen[i], zones[i])
    chosen, distances = adapt(chosen, contacts, inradius)
    doubtful = visible & (distances > reached / tolerance * ROUNDED * allowed)
    doubtful &= [s.segments == MAX_SEGMENTS or not s.facet_map[3, :3].any() for s in chosen]
    errors = {i: _largest_error(chosen[i], zones[i], camera) for i in np.flatnonzero(doubtful).tolist()}
    if coarse := {i: error for i, error in errors.items() if error > ROUNDED * reached}:
        _warn_of_coarse_faces(document, coarse, of_leaf, tolerance)
    return chosen


def choose_segments(
    document: Document, solids: Sequence[Solid], zones: np.ndarray, camera: Camera, tolerance: float, shares: np.ndarray
) -> tuple[list[Solid], float]:
    """Returns the solids with ``segments`` such that the chord error stays below ``tolerance`` pixels times ``shares``
    (n,), and the tolerance that allows at most MAX_TRIANGLES triangles.

    ``zones`` (n, 4) are the balls that :func:`active_zones` returns. If only a cap of a ball has an effect on the CSG
    tree's result, the ball also gets a ``facet_map``. Solids with the same ``pattern`` get the same number
    of segments. Raises :class:`SceneError` if even the coarsest meshes have too many triangles.
    """
    pattern = np.array([s.pattern for s in solids])
    while True:
        counts = np.empty(len(solids), int)
        for primitive, numbers in group_equal(s.primitive for s in solids).items():
            matrices = np.array([solids[i].to_world for i in numbers])
            counts[numbers] = primitive.segments(matrices, camera, tolerance * shares[numbers])
        largest = np.zeros(pattern.max() + 2, int)  # of each pattern, and of no pattern, which has the number -1
        np.maximum.at(largest, pattern, counts)
        counts = np.where(pattern >= 0, largest[pattern], counts)
        chosen = [replace(s, segments=count) for s, count in zip(solids, counts.tolist())]
        for i in np.flatnonzero((pattern < 0) & (zones[:, 3] < math.inf)):
            if chosen[i].primitive.name == "sphere":
                segments, facet_map = refined_cap(chosen[i], zones[i], camera, tolerance * shares[i])
                chosen[i] = replace(chosen[i], segments=segments, facet_map=facet_map)
        uses = Counter((s.primitive, s.segments) for s in chosen)
        total = sum(count * len(unit_mesh(*key).triangles) for key, count in uses.items())
        if total <= MAX_TRIANGLES:
            return chosen, tolerance
        if max(s.segments for s in chosen) <= MIN_SEGMENTS:
            raise document.error(
                f"the tree's {len(solids):,} different primitives have at least {total:,} triangles; "
                f"expected {MAX_TRIANGLES:,} at most, to limit memory; use fewer primitives",
                "csg",
            )
        tolerance *= 1.5


def _inradius(solid: Solid, zone: np.ndarray) -> float:
    """Returns the inradius of the curved face's mesh, for radius 1, in the ball ``zone``: if facets are concentrated
    near a cap, the mesh is much nearer to the face there than elsewhere.
    """
    if not solid.facet_map[3, :3].any():
        return solid.inradius
    mesh, own = solid.mesh(), solid.primitive.mesh(solid.segments, solid.facet_map)
    corners = mesh.vertices[mesh.triangles]
    middle = corners.mean(axis=1)
    reach = zone[3] + np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    near = np.abs(plane_heights(own))[np.linalg.norm(middle - zone[:3], axis=1) < reach].min(initial=1)
    return max(float(near), solid.inradius)  # large facets far from the cap may only seem to reach the zone


def _largest_error(solid: Solid, zone: np.ndarray, camera: Camera) -> float:
    """Returns an upper bound of the chord error in pixels, in the window and in the ball ``zone``."""
    mesh, primitive = solid.mesh(), solid.primitive
    triangles = mesh.vertices[mesh.triangles[mesh.faces[mesh.facets] == primitive.curved]]
    triangles = triangles[camera.may_see(triangles)]
    midpoints = (triangles + np.roll(triangles, 1, axis=1)) / 2
    points = np.concatenate([triangles, midpoints, triangles.mean(axis=1, keepdims=True)], axis=1)
    to_local = np.linalg.inv(solid.to_world)
    local = points @ to_local[:3, :3].T + to_local[:3, 3]
    value, gradient = primitive.implicit(local)
    errors = np.abs(value) / np.maximum(np.linalg.norm(gradient @ to_local[:3, :3], axis=2), 1e-300)
    errors[np.linalg.norm(points - zone[:3], axis=2) > zone[3]] = 0
    longest = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2).max(axis=1)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    # The eye is at least as far from a triangle as from its plane.
    heights = np.abs(np.einsum("ti,ti->t", normals, triangles[:, 0] - camera.eye))
    nearest = np.maximum(np.linalg.norm(points - camera.eye, axis=2).min(axis=1) - longest, heights)
    (pixel,), _ = primitive.pixel(solid.to_world[None], camera)
    (size,), _ = primitive.ball(solid.to_world[None])
    return float((errors.max(axis=1) / np.maximum(camera.footprint(nearest), pixel * size)).max(initial=0))


def _warn_of_coarse_faces(document: Document, errors: dict[int, float], of_leaf: np.ndarray, tolerance: float) -> None:
    worst = sorted(errors, key=lambda i: -errors[i])
    leaves = [int(np.flatnonzero(of_leaf == i)[0]) for i in worst]
    document.warn(
        f"curved faces are up to {errors[worst[0]]:.2g} pixels off instead of {tolerance:g}: "
        f"{document.names_of(leaves)}; "
        f"{MAX_SEGMENTS} segments in a circle are too few so near to the eye, or where a much larger face touches "
        "this one; use a smaller primitive, or keep only the visible part of a SPHERE (* with a CUBE)",
        "csg",
        document.scene.leaves[leaves[0]][0],
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
