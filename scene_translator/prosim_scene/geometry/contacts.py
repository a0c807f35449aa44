"""Finds curved faces that touch another curved face from inside, and makes meshes that do not cross there.

A mesh approximates a curved face by flat facets. The vertices of the mesh lie on the face, so the facets lie inside the
solid, by the chord error at most: the mesh is inscribed. Where a ball touches a pipe of the same width from inside, the
facets of the ball would cross the facets of the pipe, and patches of the wrong solid would be visible, many pixels
wide. Therefore the mesh of the ball shrinks by the chord error of the pipe, and both meshes are finer, so that the
surface of the ball stays within the tolerance. No mesh protrudes from its solid, so solids that touch from outside,
such as a pipe on a floor, do not cross either.

The mesh of a torus becomes smaller around the centre line of its tube. Tori with nearly the same surface may also cross
at a small angle. They get the same facets, so their meshes cross where the surfaces do.

In a chain of contacts, such as a bubble in a ball in a pipe, the chord errors of the ball and the pipe add up, so the
meshes of a longer chain are finer.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain
from typing import NamedTuple

import numpy as np

from .grouping import group_equal, sweep
from .primitives import Primitive, Torus, primitive_of
from .solids import Solid, world_boxes

INSIDE = 1e-6  # how far a face that touches another face from inside may be outside, relative to the outer face
BATCH = 1 << 16  # the number of pairs of a solid and a tangent plane that are tested at a time
STEPS = 16  # the number of steps that improve a tangent plane
SMALLEST = 1e-3  # the smallest scale of a solid, which a warning names, because its face is far off
SIMILAR = 0.2  # how much nearly equal tori may differ, relative to the radius of the tube
NEAR = 5  # how many chord errors of the outer mesh may lie between a face and the outer face that it touches
PARALLEL = 0.05  # how much the distance of parallel sides of cones may vary, relative to the radius


class Contacts(NamedTuple):
    """Pairs of solids: the curved face of ``inner`` (k,) touches the curved face of ``outer`` (k,) from inside, or is
    nearer to it than a few chord errors. The pairs are sorted so that a solid occurs in ``outer`` before it occurs in
    ``inner``. Solids whose curved faces have the same facets have the number of the first of them.

    If the curved face of the outer solid is scaled by ``reach`` (k,), it just encloses the inner solid. If the inner
    solid shrinks by a part of its size, this factor falls by at least ``loss`` (k,) times this part.
    """

    inner: np.ndarray
    outer: np.ndarray
    reach: np.ndarray
    loss: np.ndarray

    def shares(self, allowed: np.ndarray) -> np.ndarray:
        """Returns, for each of n solids, the share of the tolerance that is the chord error of its mesh.

        ``allowed`` (n,) is the tolerance relative to the size of each solid. The share is 1 over the number of chord
        errors that are added in the longest chain of contacts to which the solid belongs, or less: the error of a solid
        also moves those solids of the chain whose tolerance is smaller.
        """
        below, above, error = np.zeros(len(allowed), int), np.zeros(len(allowed), int), allowed.copy()
        pairs = list(zip(self.inner.tolist(), self.outer.tolist(), self.loss.tolist()))
        for inner, outer, loss in pairs:
            below[outer] = max(below[outer], below[inner] + 1)
            error[outer] = min(error[outer], error[inner] * loss)
        for inner, outer, _ in reversed(pairs):
            above[inner] = max(above[inner], above[outer] + 1)
        return np.asarray(error / (1 + below + above) / allowed)


def first_of_pattern(solids: Sequence[Solid]) -> np.ndarray:
    """Returns, for each solid, the number of the first solid whose curved face has the same facets."""
    first: dict[int, int] = {}
    return np.array([first.setdefault(s.pattern, i) if s.pattern >= 0 else i for i, s in enumerate(solids)])


def find_contacts(solids: Sequence[Solid]) -> Contacts:
    """Returns contacts of curved faces: a ball or a torus in a convex one, a ball or a torus in a torus, or a
    cylinder or a cone in a parallel one. Others are rims, where a gap would look like a wall.
    """
    first = first_of_pattern(solids)
    order = _order(solids)[first]
    found = [[np.empty(0, int), np.empty(0, int), np.empty(0), np.empty(0)]]
    for inner, outer, reach, loss in chain(_enclosed(solids, order), _cones_in_cones(solids), _balls_in_tori(solids)):
        near = 1 - NEAR * np.array([1 - solids[j].inradius for j in outer])
        touches = (reach > near) & (reach <= 1 + INSIDE) & (first[inner] != first[outer])
        found.append([column[touches] for column in (first[inner], first[outer], reach, loss)])
    contacts = Contacts(*(np.concatenate(column) for column in zip(*found)))
    depth, deeper = np.full(len(solids), -1), np.zeros(len(solids), int)  # the longest chain of contacts in a solid
    while (deeper != depth).any() and deeper.max() <= len(solids):
        depth = deeper.copy()
        np.maximum.at(deeper, contacts.outer, depth[contacts.inner] + 1)
    sorting = np.argsort(depth[contacts.outer], kind="stable")
    return Contacts(*(column[sorting] for column in contacts))


def _order(solids: Sequence[Solid]) -> np.ndarray:
    """Returns a rank of each solid: the rank of a solid in which another solid may lie is the higher one."""
    sizes = [np.linalg.svd(s.to_world[:3, : s.primitive.axes], compute_uv=False).prod() for s in solids]
    # Cylinders and cones come after all balls, because they are in no ball. Tori come before them.
    kinds = [(s.primitive.axes == 2) - s.primitive.hull[0] for s in solids]
    return np.argsort(np.lexsort((sizes, kinds)))


def _enclosed(solids: Sequence[Solid], order: np.ndarray) -> Iterator[tuple[np.ndarray, ...]]:
    """Yields pairs of an inner and an outer solid, of which the inner one lies inside the quadric of the outer one. All
    outer solids of an item have the same primitive.

    An item has the numbers of the inner and the outer solids (k,), and the columns ``reach`` and ``loss`` of
    :class:`Contacts`. ``order`` (n,) has the ranks of :func:`_order`.
    """
    curved = np.flatnonzero([s.primitive.curved is not None for s in solids])
    to_world = np.array([s.to_world for s in solids]).reshape(-1, 4, 4)
    to_local, is_ball = np.linalg.inv(to_world), np.array([s.primitive.axes == 3 for s in solids], bool)
    hulls = np.array([s.primitive.hull for s in solids]).reshape(-1, 2)
    is_cylinder = np.array([s.primitive.name == "cylinder" for s in solids], bool)
    convex = curved[hulls[curved, 0] == 0]  # a torus has no tangent planes
    of_primitive = group_equal(solids[i].primitive for i in convex.tolist())
    for pairs in sweep(*world_boxes([solids[i] for i in curved.tolist()])):
        inner, outer = curved[np.concatenate([pairs, pairs[::-1]], axis=1)]
        compared = (order[inner] < order[outer]) & (is_ball[inner] | is_cylinder[inner] & is_cylinder[outer])
        for primitive, numbers in of_primitive.items():
            chosen = np.flatnonzero(compared & np.isin(outer, convex[numbers]))
            i, j = inner[chosen], outer[chosen]
            relative = (to_local[j] @ to_world[i])[:, :3]
            within = is_ball[i] | (np.abs(relative[:, :2, 2]).max(axis=1) < INSIDE)  # parallel cylinders
            i, j, relative = i[within], j[within], relative[within]
            heights, normals = _highest(primitive, relative, hulls[i])
            within = heights <= INSIDE
            if within.any():
                yield i[within], j[within], *_reach(primitive, relative[within], hulls[i[within]], normals[within])


def _cones_in_cones(solids: Sequence[Solid]) -> Iterator[tuple[np.ndarray, ...]]:
    """Yields items as :func:`_enclosed` does: pairs of parallel cones whose sides are nearly parallel, too."""
    cones = np.flatnonzero([s.primitive.name == "cone" for s in solids])
    of_cones = [solids[i] for i in cones.tolist()]
    bottoms, primitive = np.array([s.primitive.box[0][2] for s in of_cones]), primitive_of("cone")
    for i, j, relative in _touching(of_cones):
        tilt, height = np.abs(relative[:, [0, 1, 2, 2], [2, 2, 0, 1]]).max(axis=1), relative[:, 2, 2]
        low = np.maximum(bottoms[j], relative[:, 2, 3] + height * bottoms[i])
        high = np.minimum(1, relative[:, 2, 3] + height)
        low = np.maximum(low, 1e-6 * high)  # not at the apex
        chosen = (tilt < INSIDE) & (height > 0) & (high - low > 0.01 * np.minimum(1, height))
        i, j, relative, height = i[chosen], j[chosen], relative[chosen], height[chosen]
        found = []
        for z in low[chosen], high[chosen]:
            disc = relative * ((z - relative[:, 2, 3]) / height)[:, None, None]  # the section of the inner cone
            disc[:, :, 3] = disc[:, :, 2] + relative[:, :, 3]
            disc[:, :, 2] = 0
            hull = np.tile([1.0, 0.0], (len(disc), 1))
            found.append(_reach(primitive, disc, hull, _highest(primitive, disc, hull)[1]))
        (reach, _), (other, _) = found
        # Of cones that only touch at a rim, the distances of the sides differ.
        parallel = np.abs((1 - reach) * low[chosen] - (1 - other) * high[chosen]) < PARALLEL * high[chosen]
        near = parallel & (np.maximum(reach, other) <= 1 + INSIDE) & (reach + other < 2)
        for end, end_loss in found:
            yield cones[i[near]], cones[j[near]], end[near], end_loss[near]


def _touching(solids: Sequence[Solid]) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yields pairs of solids whose boxes touch, each pair in both orders: the solids' numbers i and j (k,), and the
    maps (k, 3, 4) from the space of i to that of j.
    """
    to_world = np.array([s.to_world for s in solids]).reshape(-1, 4, 4)
    for pairs in sweep(*world_boxes(solids)):
        i, j = np.concatenate([pairs, pairs[::-1]], axis=1)
        yield i, j, np.linalg.solve(to_world[j], to_world[i])[:, :3]


def near_tori(tori: Sequence[Solid]) -> np.ndarray:
    """Returns, for each torus, the number of the first one with nearly the same surface, whose facets it gets."""
    radius, pairs = np.array([s.primitive.hull[1] for s in tori]), [np.empty((2, 0), int)]
    for i, j, relative in _touching(tori):
        stretch = relative[..., :3].transpose(0, 2, 1) @ relative[..., :3] - np.eye(3)
        different = [stretch.reshape(-1, 9), relative[:, 2, :2], relative[..., 3], (radius[i] - radius[j])[:, None]]
        near = (i < j) & (np.abs(np.concatenate(different, axis=1)).max(axis=1) < SIMILAR * radius[j])
        pairs.append(np.stack([i, j])[:, near])
    result = np.arange(len(tori))
    for i, j in sorted(np.concatenate(pairs, axis=1).T.tolist()):
        if result[i] == i and result[j] == j:
            result[j] = i
    return result


def _balls_in_tori(solids: Sequence[Solid]) -> Iterator[tuple[np.ndarray, ...]]:
    """Yields items as :func:`_enclosed` does: pairs of a ball or a torus, and a torus. The first is in the tube if it
    is in a ball as wide as the tube, whose centre is the nearest point of the tube's centre line. A coaxial torus is in
    the tube if this is true for the balls as wide as its own tube.
    """
    radii = {i: s.primitive.radius for i, s in enumerate(solids) if isinstance(s.primitive, Torus)}
    chosen = np.array([i for i, s in enumerate(solids) if radii and (i in radii or s.primitive.name == "sphere")], int)
    of_chosen, sphere = [solids[i] for i in chosen.tolist()], primitive_of("sphere")
    radius = np.array([radii.get(i, 0.0) for i in chosen.tolist()])
    hulls = np.array([s.primitive.hull for s in of_chosen]).reshape(-1, 2)
    for i, j, relative in _touching(of_chosen):
        i, j, relative = (column[radius[j] > 0] for column in (i, j, relative))
        products = relative.transpose(0, 2, 1) @ relative
        different = [products[:, 0, 0] - products[:, 1, 1], products[:, 0, 1]]
        different += [relative[:, k, axis] for k, axis in ((0, 2), (1, 2), (2, 0), (2, 1), (0, 3), (1, 3))]
        coaxial = (np.abs(different).max(axis=0) < INSIDE) & (radius[i] > 0)
        fits = coaxial | (np.linalg.norm(relative[..., 0], axis=1) <= (1 + INSIDE) * radius[j])
        i, j, relative, coaxial = (column[fits] for column in (i, j, relative, coaxial))
        relative[..., 3] += relative[..., 0] * coaxial[:, None]
        distance = np.linalg.norm(relative[:, :2, 3], axis=1, keepdims=True)
        relative[:, :2, 3] *= 1 - 1 / np.maximum(distance, 1e-300)
        relative /= radius[j, None, None]
        hull = np.where(coaxial[:, None], hulls[i] * [0, 1], hulls[i])
        heights, normals = _highest(sphere, relative, hull)
        within = heights <= INSIDE
        reach, loss = _reach(sphere, relative[within], hull[within], normals[within])
        part = radius / (1 + radius)  # the tube's part of the size of the torus
        loss *= (part[j] / np.where(coaxial, part[i], 1))[within]
        yield chosen[i[within]], chosen[j[within]], 1 - (1 - reach) * part[j[within]], loss


def _highest(primitive: Primitive, relative: np.ndarray, hulls: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the largest heights of k inner solids over tangent planes of the outer curved face, and these planes'
    normals. A solid inside a convex face is on the inner side of all of them.
    """
    quadric = np.diag(primitive.quadrics[primitive.curved])
    normals = primitive.surface_lines[:, 1] * quadric[:3]
    found = [(np.empty(0), np.empty(0, int))]
    count = len(relative) * len(normals) // BATCH + 1
    for part, hull in zip(np.array_split(relative, count), np.array_split(hulls[..., None], count)):
        products = part.transpose(0, 2, 1) @ normals.T
        heights = products[:, 3] + hull[:, 1] * np.linalg.norm(products[:, :3], axis=1) + quadric[3]
        heights += hull[:, 0] * np.linalg.norm(products[:, :2], axis=1)
        found.append((heights.max(axis=1), heights.argmax(axis=1)))
    heights, best = (np.concatenate(column) for column in zip(*found))
    return heights, normals[best]


def _reach(
    primitive: Primitive, relative: np.ndarray, hulls: np.ndarray, normals: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the columns ``reach`` and ``loss`` of :class:`Contacts` for the pairs of :func:`_enclosed`.

    The height of the inner solid over a tangent plane is a convex function of the normal, so it never falls if the
    point with the largest height defines the next normal.
    """
    linear, offset, axes, normals = relative[..., :3], relative[..., 3], primitive.axes, normals.copy()
    for _ in range(STEPS):
        across = np.einsum("kij,ki->kj", linear, normals)
        ring = across * [1, 1, 0] / np.maximum(np.linalg.norm(across[:, :2], axis=1, keepdims=True), 1e-300)
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
        across = hulls[:, :1] * ring + hulls[:, 1:] * across
        points = offset + np.einsum("kij,kj->ki", linear, across)  # the highest points of the inner solids
        radius = np.linalg.norm(points[:, :axes], axis=1)
        normals[:, :axes] = points[:, :axes] / np.maximum(radius, 1e-300)[:, None]
    middle = np.linalg.norm(offset[:, :axes], axis=1)
    if primitive.name != "cone":
        return radius, radius - middle
    width = np.maximum(points[:, 2], 1e-300)  # the radius of the cone at the height of the contact
    reach, height = radius / width, offset[:, 2]
    top = height + hulls.sum(axis=1) * np.linalg.norm(linear[:, 2], axis=1)
    return reach, (reach * height - middle) / top


def adapt(solids: Sequence[Solid], contacts: Contacts, inradius: np.ndarray) -> tuple[list[Solid], np.ndarray]:
    """Returns the solids with ``scale`` changed so that the meshes of outer solids enclose those of inner solids; and,
    for each solid, the largest distance of its mesh from the curved face, relative to the radius of this face (n,).

    ``inradius`` (n,) is that of the meshes where their solids have an effect on the CSG tree's result.
    """
    first, scale = first_of_pattern(solids), np.ones(len(solids))
    for i, j, reach, loss in reversed(list(zip(*contacts))):
        shrunk = 1 - max(reach - scale[j] * inradius[j], 0) / loss
        scale[i] = max(min(scale[i], shrunk), SMALLEST)
    return [replace(s, scale=scale[j]) for s, j in zip(solids, first)], (1 - scale * inradius)[first]
