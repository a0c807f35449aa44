"""Who owns a face where faces of several primitives coincide: the primitive that stands first in the tree.

manifold3d decides coincidences by the order of its operands, but its clean-up of the degenerate triangles that they
leave can hand some of the area to the other operand, in triangles that lie across the outline of a face. Here the rule
is applied to the finished triangles, straight from its definition on the tree: triangles on a plane that several
primitives share are cut along these primitives' outlines, and each piece is given to whom it belongs.
"""

import numpy as np

from . import tree
from .primitives import PRIMITIVES

NEAR = 1e-7  # in a primitive's own space: nearer to a line, a vertex counts as lying on it
CHUNK = 512  # triangles at a time; they are neighbours, so that most primitives are far from all of them


def overlap(triangles, outline, lines):
    """Which plane triangles (n, 3, 2) and a convex outline (k, 2) have more than an edge in common.

    ``lines`` (k, 3) are its sides as a x + b y + c <= 0.
    """
    side = triangles @ lines[:, :2].T + lines[:, 2]  # (n, 3, k)
    apart = np.any(np.all(side > -NEAR, axis=1), axis=1)
    along = np.roll(triangles, -1, axis=1) - triangles
    normal = np.stack([along[..., 1], -along[..., 0]], axis=2)
    normal *= np.where(along[:, :1, 0] * along[:, 1:2, 1] > along[:, :1, 1] * along[:, 1:2, 0], 1, -1)[..., None]
    normal /= np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-300)
    beyond = np.einsum("tej,kj->tek", normal, outline) - np.einsum("tej,tej->te", normal, triangles)[..., None]
    return ~apart & ~np.any(np.all(beyond > -NEAR, axis=2), axis=1) & np.any((side > NEAR).any(1) & (side < -NEAR).any(1), axis=1)


class Cutter:
    """A triangle mesh whose edges can be split; it stays closed, since a split divides both triangles at an edge."""

    def __init__(self, vertices, faces, leaf, touched):
        self.vertices, self.faces, self.leaf = list(vertices), [tuple(f) for f in faces.tolist()], leaf.tolist()
        near = np.isin(faces, faces[touched]).any(axis=1)
        self.edges = {}  # directed edge -> face
        self.pieces = {}  # face -> the faces that were split off it
        for number in np.flatnonzero(near).tolist():
            self._enter(number)

    def arrays(self):
        return np.array(self.vertices), np.array(self.faces), np.array(self.leaf)

    def _enter(self, number):
        a, b, c = self.faces[number]
        self.edges[a, b] = self.edges[b, c] = self.edges[c, a] = number

    def _split(self, number, u, v, w):
        """Divides a face at its edge (u, v); returns the number of the new half."""
        (c,) = set(self.faces[number]) - {u, v}
        del self.edges[u, v]
        self.faces[number] = (u, w, c)
        self.faces.append((w, v, c))
        self.leaf.append(self.leaf[number])
        self._enter(number)
        half = len(self.faces) - 1
        self._enter(half)
        self.pieces.setdefault(number, []).append(half)
        return half

    def _with_pieces(self, numbers):
        found, stack = set(), list(numbers)
        while stack:
            number = stack.pop()
            found.add(number)
            stack += self.pieces.get(number, ())
        return found

    def cut(self, numbers, lines):
        """Cuts faces, and what was split off them, along lines as far as they lie inside of all of these.

        The lines are given as planes (a, b, c, d).
        """
        todo = self._with_pieces(numbers)
        for plane in lines:
            stack, done = list(todo), set()
            value = {v: float(plane[:3] @ self.vertices[v] + plane[3]) for n in todo for v in self.faces[n]}
            while stack:
                number = stack.pop()
                face = self.faces[number]
                crossing = [(u, v) for u, v in zip(face, face[1:] + face[:1])
                            if min(value[u], value[v]) < -NEAR and max(value[u], value[v]) > NEAR and (v, u) in self.edges]
                if not crossing:
                    done.add(number)
                    continue
                u, v = crossing[0]
                t = value[u] / (value[u] - value[v])
                w = len(self.vertices)
                self.vertices.append((1 - t) * self.vertices[u] + t * self.vertices[v])
                value[w] = 0.0
                other = self.edges[v, u]
                stack += [number, self._split(number, u, v, w)]
                half = self._split(other, v, u, w)
                if other in todo:
                    todo.add(half)
                    done.discard(other)
                    stack += [other, half]
            todo = {n for n in done if min(value[v] for v in self.faces[n]) < -NEAR}


def cut_shared_faces(table, vertices, faces, leaf):
    """Cuts the triangles on planes that several leaves share along the outlines of the leaves' faces."""
    candidates = _on_shared_surfaces(table, leaf)
    if not len(candidates):
        return vertices, faces, leaf
    face = table.evaluate(vertices[faces[candidates]], leaf[candidates])[3]
    jobs = []  # triangles and the lines along which to cut them
    for (number, code), group in _groups(np.stack([leaf[candidates], face], axis=1)):
        surface = table.surfaces[number][code]
        flat = table.flat_face(number, code)
        if surface not in table.shared or flat is None:
            continue
        normal = flat[0]
        others = table.others_on(number, code)
        for b in [*others, *([number] if len(others) else [])]:
            other = table.flat_face(b, table.surfaces[b].index(surface))
            if other is None or other[0] @ normal <= 0:
                continue
            _, across, outline = other
            following = np.roll(outline, -1, axis=0)
            sides = np.stack([following[:, 1] - outline[:, 1], outline[:, 0] - following[:, 0]], axis=1)
            sides /= np.linalg.norm(sides, axis=1, keepdims=True)
            lines = np.concatenate([sides, -np.sum(sides * outline, axis=1, keepdims=True)], axis=1)
            corners = vertices[faces[candidates[group]]]
            local = (corners @ table.inverse[b, :, :3].T + table.inverse[b, :, 3])[..., across]
            hit = candidates[group[overlap(local, outline, lines)]]
            if len(hit):
                planes = lines[:, :2] @ table.inverse[b][across]
                planes[:, 3] += lines[:, 2]
                jobs.append((hit, planes))
    if not jobs:
        return vertices, faces, leaf
    cutter = Cutter(vertices, faces, leaf, np.unique(np.concatenate([hit for hit, _ in jobs])))
    for hit, planes in jobs:
        cutter.cut(hit.tolist(), planes)
    return cutter.arrays()


def owners(table, nodes, vertices, faces, leaf):
    """The leaves of triangles, corrected where faces of several primitives coincide."""
    candidates = _on_shared_surfaces(table, leaf)
    if not len(candidates):
        return leaf
    corners, owner = vertices[faces[candidates]], leaf[candidates]
    normal, _, _, face, local = table.evaluate(corners, owner)
    middle = corners.mean(axis=1)
    # Only where a primitive other than the present owner has a face on the same surface and its box reaches there.
    margin = table.margin
    ambiguous = np.zeros(len(candidates), bool)
    for (number, code), in_group in _groups(np.stack([owner, face], axis=1)):
        if table.surfaces[number][code] in table.shared:
            for b in table.others_on(number, code):
                ambiguous[in_group] |= np.all((middle[in_group] >= table.low[b] - margin[b])
                                              & (middle[in_group] <= table.high[b] + margin[b]), axis=1)
    if not ambiguous.any():
        return leaf
    chosen, owner, face = candidates[ambiguous], owner[ambiguous], face[ambiguous]
    # The middle of a triangle, on the surface itself and not on its chord.
    p = local[ambiguous].mean(axis=1)
    for number in np.unique(table.shape[owner]):
        same = table.shape[owner] == number
        p[same] = PRIMITIVES[table.SHAPES[number]].on_surface(p[same], face[same])
    points = np.einsum("tij,tj->ti", table.matrix[owner][:, :, :3], p) + table.matrix[owner][:, :, 3]
    normals = normal[ambiguous].mean(axis=1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    leaf = leaf.copy()
    leaf[chosen] = settle(nodes, owner, points, normals, margin[owner], table.inside, table.low, table.high)
    return leaf


def _on_shared_surfaces(table, leaf):
    """Triangles whose leaf has a face on a surface that another one has too."""
    bearing = np.array([any(h in table.shared for h in hashes) for hashes in table.surfaces])
    return np.flatnonzero(bearing[leaf])


def _groups(pairs):
    """Each different row of an integer array, and the rows where it stands."""
    values, index = np.unique(pairs, axis=0, return_inverse=True)
    order = np.argsort(index.ravel(), kind="stable")
    ends = np.cumsum(np.bincount(index.ravel()))
    return zip(values, np.split(order, ends[:-1]))


def settle(nodes, leaf, points, normals, distances, inside, low, high):
    """The leaf that owns each of the given points on the surface of the result.

    ``nodes`` is the tree in prefix order; ``leaf`` holds the present
    owners (numbers of leaves, in the tree's order), ``normals`` point out of the result, ``distances`` say how far off
    the surface its two sides are looked at. ``inside(number, points)`` tells what a leaf contains; ``low`` and ``high``
    are the boxes of all leaves.
    """
    result = leaf.copy()
    order = np.lexsort(np.floor((points - points.min(axis=0)) / (np.ptp(points, axis=0).max() / 16 + 1e-300)).T)
    for start in range(0, len(order), CHUNK):
        chosen = order[start:start + CHUNK]
        step = normals[chosen] * distances[chosen, None]
        both = np.concatenate([points[chosen] - step, points[chosen] + step])
        near = np.all((low <= both.max(axis=0)) & (high >= both.min(axis=0)), axis=1)
        owner = _owner(nodes, both, near, inside)
        result[chosen] = np.where(owner >= 0, owner, leaf[chosen])
    return result


def _owner(nodes, both, near, inside):
    """Evaluates the tree on both sides of each point.

    The state of a node is (contains the side below, contains the side above, owner of the face between them or -1), or
    None for a node that is far from all points.
    """
    half = len(both) // 2

    def leaf(number, _):
        if not near[number]:
            return None
        below, above = np.split(inside(number, both), [half])
        return below, above, np.where(below != above, number, -1)

    state = tree.fold(nodes, leaf, _combine)
    return state[2] if state else np.full(half, -1)


def _combine(operator, left, right):
    if left is None or right is None:
        return left or right if operator == "+" else left if operator == "-" else None
    if operator == "+":
        below, above = left[0] | right[0], left[1] | right[1]
    elif operator == "-":
        below, above = left[0] & ~right[0], left[1] & ~right[1]
    else:
        below, above = left[0] & right[0], left[1] & right[1]
    # The first operand's face where it bounds the result; else it is the second's.
    first = (left[0] == below) & (left[1] == above)
    return below, above, np.where(below == above, -1, np.where(first, left[2], right[2]))
