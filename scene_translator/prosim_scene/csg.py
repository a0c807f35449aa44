"""The CSG tree evaluated with manifold3d.

How it stays fast: the tree is a flat prefix list, evaluated with a stack of our own; chains of one operator become one
n-ary operation; and a solid is kept as a list of *parts* whose bounding boxes are disjoint, so that an operation costs
what it touches and nothing else. A union is reduced pairwise over neighbours in the order of the tree, which makes
manifold3d's rule for coincident faces (the first operand wins) hold for the whole tree.

How optics are kept: every occurrence of a primitive has its own id, which manifold3d carries to the triangles of the
result. Solids of different media (opaque; one medium for every index of refraction of a dielectric) are kept apart, see
:func:`shells`.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np
from manifold3d import Error, Manifold, Mesh64

OPAQUE = None  # the medium of everything that is not a dielectric


@dataclass(frozen=True)
class Part:
    """A piece of a solid and its bounding box (min and max corner)."""

    manifold: Manifold
    low: np.ndarray
    high: np.ndarray


def _parts(manifold):
    """A list of one part, or of none where nothing is left."""
    status = manifold.status()
    if status != Error.NoError:
        raise ArithmeticError(f"manifold3d: {status}")
    if manifold.is_empty():
        return []
    box = np.array(manifold.bounding_box())  # evaluates the operation
    return [Part(manifold, box[:3], box[3:])]


def solid(vertices, triangles, original_id):
    """A closed triangle mesh as a list of one part that bears ``original_id``."""
    return _parts(Manifold(Mesh64(
        np.ascontiguousarray(vertices, dtype=np.float64), np.ascontiguousarray(triangles, dtype=np.uint64),
        run_index=np.array([0, 3 * len(triangles)], dtype=np.uint64),
        run_original_id=np.array([original_id], dtype=np.uint32))))


def reserve_ids(count):
    return Manifold.reserve_ids(count)


def _touching(part, low, high):
    """Indices of the boxes that overlap or touch a part's."""
    return np.flatnonzero(np.all((low <= part.high) & (high >= part.low), axis=1))


def _boxes(parts):
    return np.array([p.low for p in parts]).reshape(-1, 3), np.array([p.high for p in parts]).reshape(-1, 3)


def _components(parts):
    """Groups of parts whose boxes are connected by touching, each group in the given order."""
    low, high = _boxes(parts)
    parent = list(range(len(parts)))

    def find(i):
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        return i

    order = np.argsort(low[:, 0], kind="stable")
    low, high = low[order], high[order]
    last = np.searchsorted(low[:, 0], high[:, 0], side="right")  # sweep along x
    for i in range(len(parts)):
        window = slice(i + 1, last[i])
        hits = np.all((low[window, 1:] <= high[i, 1:]) & (high[window, 1:] >= low[i, 1:]), axis=1)
        for j in np.flatnonzero(hits):
            a, b = find(order[i]), find(order[i + 1 + j])
            parent[max(a, b)] = min(a, b)
    groups = {}
    for i, part in enumerate(parts):
        groups.setdefault(find(i), []).append(part)
    return list(groups.values())


def _merge(parts):
    """Union of parts, as one list of at most one part; neighbours first, so that the order decides coincident faces."""
    while len(parts) > 1:
        parts = [p for i in range(0, len(parts), 2)
                 for p in (_parts(parts[i].manifold + parts[i + 1].manifold) if i + 1 < len(parts) else [parts[i]])]
    return parts


def union(operands):
    parts = [p for operand in operands for p in operand]
    while True:
        groups = _components(parts)
        if len(groups) == len(parts):
            return parts
        parts = [p for group in groups for p in _merge(group)]


def difference(minuend, subtrahend):
    low, high = _boxes(subtrahend)
    result = []
    for part in minuend:
        hits = _touching(part, low, high)
        if not len(hits):
            result.append(part)
        else:  # the boxes of the subtrahend's parts are disjoint: they compose to one without any computation
            result += _parts(part.manifold - Manifold.compose([subtrahend[i].manifold for i in hits]))
    return result


def intersection(first, second):
    low, high = _boxes(second)
    return [p for part in first for i in _touching(part, low, high)
            for p in _parts(part.manifold ^ second[i].manifold)]


# ---- The tree --------------------------------------------------------------------------------------------------------
# A value maps each medium to its parts: {medium: [Part]}.


def _total(value):
    """All media of a value as one solid."""
    return next(iter(value.values())) if len(value) == 1 else union(value.values())


def _union(values):
    media = {}
    for value in values:
        for medium, parts in value.items():
            media.setdefault(medium, []).append(parts)
    return {medium: union(parts) for medium, parts in media.items()}


def _difference(values):
    minuend, *rest = values
    subtrahend = union([_total(value) for value in rest])
    return {medium: difference(parts, subtrahend) for medium, parts in minuend.items()}


def _intersection(values):
    result, *rest = values
    for value in rest:
        total = _total(value)
        result = {medium: intersection(parts, total) for medium, parts in result.items()}
    return result


EVALUATE = {"+": _union, "-": _difference, "*": _intersection}


class _Pending:
    """An n-ary operation that still grows."""

    def __init__(self, symbol, operands):
        self.symbol, self.operands = symbol, deque(operands)


def _value(item):
    return EVALUATE[item.symbol](item.operands) if isinstance(item, _Pending) else item


def evaluate(nodes, leaf_value):
    """The value of a tree in prefix order.

    ``nodes`` holds operators as "+", "-", "*" and leaves as anything else; ``leaf_value(leaf)`` makes a leaf's value.
    """
    stack = []
    for node in reversed(nodes):
        if not (isinstance(node, str) and node in EVALUATE):
            stack.append(leaf_value(node))
            continue
        left, right = stack.pop(), stack.pop()
        chain_left = isinstance(left, _Pending) and left.symbol == node
        if node == "-":  # (A - B) - C = A - (B + C)
            more = right.operands if isinstance(right, _Pending) and right.symbol == "+" else [_value(right)]
            if chain_left:
                left.operands.extend(more)
                stack.append(left)
            else:
                stack.append(_Pending("-", [_value(left), *more]))
            continue
        chain_right = isinstance(right, _Pending) and right.symbol == node
        if chain_left and chain_right and len(left.operands) < len(right.operands):
            right.operands.extendleft(reversed(left.operands))
            stack.append(right)
        elif chain_left:
            left.operands.extend(right.operands if chain_right else [_value(right)])
            stack.append(left)
        elif chain_right:
            right.operands.appendleft(_value(left))
            stack.append(right)
        else:
            stack.append(_Pending(node, [_value(left), _value(right)]))
    return _value(stack.pop())


def shells(value):
    """The surfaces to render: a list of (vertices, triangles, original id of each triangle).

    An opaque solid is bounded by its whole surface. A dielectric gives way to opaque solids, and to dielectrics that
    stand before it in the tree: of its surface there remains what bounds the union of all up to it. So every interface
    exists exactly once, and from inside a dielectric every way out leads through its own surface or onto another's.
    """
    media = sorted(value, key=lambda medium: medium is not OPAQUE)  # stable: opaque first, then in the tree's order
    meshes, before = [], []
    for number, medium in enumerate(media):
        parts = value[medium]
        if not before:
            before = parts
            meshes += [_arrays(p.manifold) for p in parts]
            continue
        own, originals = _renamed(parts)
        before = union([before, own])
        for part in before:
            vertices, triangles, ids = _arrays(part.manifold)
            names = np.array(sorted(originals), dtype=np.int64)
            at = np.searchsorted(names, ids)
            mine = (at < len(names)) & (names[np.minimum(at, len(names) - 1)] == ids) if len(names) else ids < 0
            if mine.any():
                real = np.array([originals[i] for i in names])
                meshes.append((vertices, triangles[mine], real[at[mine]]))
    return meshes


def _arrays(manifold):
    mesh = manifold.to_mesh64()
    runs = np.diff(np.asarray(mesh.run_index, dtype=np.int64)) // 3
    ids = np.repeat(np.asarray(mesh.run_original_id, dtype=np.int64), runs)
    return np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts, dtype=np.int64), ids


def _renamed(parts):
    """The parts with fresh ids, and a dictionary from these to the old ones: tells one medium's triangles from another's
    even where one primitive has cut both."""
    renamed, originals = [], {}
    for part in parts:
        vertices, triangles, ids = _arrays(part.manifold)
        old, index = np.unique(ids, return_inverse=True)
        base = reserve_ids(len(old))
        originals.update(zip(range(base, base + len(old)), old.tolist()))
        order = np.argsort(index, kind="stable")
        run_index = np.concatenate([[0], np.cumsum(np.bincount(index))]).astype(np.uint64) * np.uint64(3)
        renamed += _parts(Manifold(Mesh64(
            np.ascontiguousarray(vertices), np.ascontiguousarray(triangles[order], dtype=np.uint64), run_index=run_index,
            run_original_id=np.arange(base, base + len(old), dtype=np.uint32))))
    return renamed, originals
