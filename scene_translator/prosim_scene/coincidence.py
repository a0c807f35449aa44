"""Who owns a face where faces of several primitives coincide: the primitive that stands first in the tree.

manifold3d decides coincidences by the order of its operands, but its clean-up of the degenerate triangles that they
leave can hand some of the area to the other operand, in triangles that lie across the outline of a face. Here the rule
is applied to the finished triangles, straight from its definition on the tree: triangles on a plane that several
primitives share are cut along these primitives' outlines, and each piece is given to whom it belongs.
"""

import numpy as np

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


def settle(nodes, leaf, points, normals, distances, inside, low, high):
    """The leaf that owns each of the given points on the surface of the result.

    ``nodes`` is the tree in prefix order, operators as strings and leaves as anything else; ``leaf`` holds the present
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
    stack, number, half = [], len(near), len(both) // 2
    for node in reversed(nodes):
        if isinstance(node, str):
            stack.append(_combine(node, stack.pop(), stack.pop()))
            continue
        number -= 1
        if near[number]:
            below, above = np.split(inside(number, both), [half])
            stack.append((below, above, np.where(below != above, number, -1)))
        else:
            stack.append(None)
    state = stack.pop()
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
