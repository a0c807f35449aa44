"""The CSG tree evaluated with manifold3d.

How it stays fast: the tree is a flat prefix list, evaluated with a stack of our own; chains of + and - and chains of *
become n-ary operations; operands of a chain whose boxes do not touch are exchanged freely, so that a long chain of
additions and subtractions takes few operations on the whole; and a solid is kept as a list of *parts* whose bounding
boxes are disjoint, so that an operation costs what it touches and nothing else.

Coincident faces: manifold3d gives them to the second operand of a union and to the first of an intersection. Wherever
operands are reordered, those that may share a face keep the order of the tree, so that the primitive that stands first
in the tree wins.

How optics are kept: every occurrence of a primitive has its own id, which manifold3d carries to the triangles of the
result. Solids of different media (opaque; one medium for every index of refraction of a dielectric) are kept apart, see
:func:`shells`.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from manifold3d import Error, Manifold, Mesh64

OPAQUE = None  # the medium of everything that is not a dielectric


@dataclass(frozen=True)
class Part:
    """A piece of a solid, its bounding box (min and max corner), and hashes of the surfaces that its faces lie on."""

    manifold: Manifold
    low: np.ndarray
    high: np.ndarray
    surfaces: frozenset


def _parts(manifold, *surfaces):
    """A list of one part, or of none where nothing is left."""
    status = manifold.status()
    if status != Error.NoError:
        raise ArithmeticError(f"manifold3d: {status}")
    if manifold.is_empty():
        return []
    box = np.array(manifold.bounding_box())  # evaluates the operation
    return [Part(manifold, box[:3], box[3:], frozenset().union(*surfaces))]


def solid(vertices, triangles, original_id, surfaces=()):
    """A closed triangle mesh as a list of one part that bears ``original_id``.

    ``surfaces`` are hashes of the planes and quadrics of its faces: solids that have none in common share no face.
    """
    return _parts(Manifold(Mesh64(
        np.ascontiguousarray(vertices, dtype=np.float64), np.ascontiguousarray(triangles, dtype=np.uint64),
        run_index=np.array([0, 3 * len(triangles)], dtype=np.uint64),
        run_original_id=np.array([original_id], dtype=np.uint32))), surfaces)


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
    order = np.argsort(low[:, 0], kind="stable")
    low, high = low[order], high[order]
    last = np.searchsorted(low[:, 0], high[:, 0], side="right")  # sweep along x
    label = np.arange(len(parts))
    for i in range(len(parts)):
        window = slice(i + 1, last[i])
        hits = np.all((low[window, 1:] <= high[i, 1:]) & (high[window, 1:] >= low[i, 1:]), axis=1)
        touched = label[window][hits]
        if (touched != label[i]).any():
            label[np.isin(label, touched)] = label[i]
    groups = {}
    for i, group in sorted(zip(order.tolist(), label.tolist())):
        groups.setdefault(group, []).append(parts[i])
    return list(groups.values())


def _layers(parts):
    """Few lists of parts, the parts of each disjoint, that may be united in this order; None where there are too many.

    Greedy colouring in the order of the tree; a part goes behind every earlier one with which it may share a face.
    """
    low, high = _boxes(parts)
    color = np.zeros(len(parts), int)
    bearers = {}  # surface -> the parts so far that have a face on it
    limit = 8 + 2 * math.ceil(math.log2(len(parts)))
    for i, part in enumerate(parts):
        touching = np.all((low[:i] <= part.high) & (high[:i] >= part.low), axis=1)
        sharing = [j for surface in part.surfaces for j in bearers.setdefault(surface, []) if touching[j]]
        taken = set(color[:i][touching].tolist())
        color[i] = max((color[j] + 1 for j in sharing), default=0)
        while color[i] in taken:
            color[i] += 1
        if color[i] > limit:
            return None
        for surface in part.surfaces:
            bearers[surface].append(i)
    layers = [[] for _ in range(color.max() + 1)]
    for part, c in zip(parts, color):
        layers[c].append(part)
    return layers


def _merge(parts):
    """Union of parts, as a list of at most one part."""
    layers = _layers(parts) if len(parts) > 3 else None
    if layers:
        parts = [p for layer in layers
                 for p in _parts(Manifold.compose([p.manifold for p in layer]), *(p.surfaces for p in layer))]
    while len(parts) > 1:  # neighbours, the earlier as the second operand: the order decides coincident faces
        parts = [p for i in range(0, len(parts), 2) for p in (
            _parts(parts[i + 1].manifold + parts[i].manifold, parts[i].surfaces, parts[i + 1].surfaces)
            if i + 1 < len(parts) else [parts[i]])]
    return parts


def union(operands):
    """Union of solids."""
    parts = [p for operand in operands for p in operand]
    while True:
        groups = _components(parts)
        if len(groups) == len(parts):
            return parts
        parts = [p for group in groups for p in (_merge(group) if len(group) > 1 else group)]


def difference(minuend, subtrahend):
    """The first solid without the second."""
    low, high = _boxes(subtrahend)
    result = []
    for part in minuend:
        hits = _touching(part, low, high)
        if not len(hits):
            result.append(part)
        else:  # the boxes of the subtrahend's parts are disjoint: they compose to one without any computation
            taken = [subtrahend[i] for i in hits]
            result += _parts(part.manifold - Manifold.compose([p.manifold for p in taken]),
                             part.surfaces, *(p.surfaces for p in taken))
    return result


def intersection(first, second):
    """What two solids have in common."""
    low, high = _boxes(second)
    return [p for part in first for i in _touching(part, low, high)
            for p in _parts(part.manifold ^ second[i].manifold, part.surfaces, second[i].surfaces)]


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


def _difference(minuend, subtrahends):
    if not subtrahends:
        return minuend
    subtrahend = union([_total(value) for value in subtrahends])
    return {medium: difference(parts, subtrahend) for medium, parts in minuend.items()}


class _Sum:
    """A chain of + and -, still growing: signed operands, the first one positive."""

    def __init__(self, first):
        self.operands = deque([("+", first)])
        self.adds_only = True

    def add(self, sign, other):
        """Appends ``other``, by its operands where it is a chain of + alone: A - (B + C) = A - B - C."""
        if isinstance(other, _Sum) and other.adds_only:
            if sign == "+" and len(self.operands) < len(other.operands) and self.adds_only:
                other.operands.extendleft(reversed(self.operands))
                return other
            self.operands.extend((sign, value) for _, value in other.operands)
        else:
            self.operands.append((sign, _value(other)))
        self.adds_only &= sign == "+"
        return self

    def value(self):
        """Works through the chain in rounds, each of which first takes away and then adds.

        An operand joins the earliest round that comes after all earlier operands that it touches and does not commute
        with; so the number of rounds is that of the additions and subtractions that alternate at one place.
        """
        if self.adds_only:
            return _union([value for _, value in self.operands])
        boxes = [_boxes([p for parts in value.values() for p in parts]) for _, value in self.operands]
        low = np.array([b.min(axis=0, initial=np.inf) for b, _ in boxes])
        high = np.array([b.max(axis=0, initial=-np.inf) for _, b in boxes])
        sign = np.array([s == "+" for s, _ in self.operands])
        round_ = np.zeros(len(sign), int)
        for i in range(1, len(sign)):
            touching = np.all((low[:i] <= high[i]) & (high[:i] >= low[i]), axis=1)
            round_[i] = (round_[:i] + (sign[:i] & ~sign[i]))[touching].max(initial=0)
        result = {}
        for r in range(round_.max() + 1):
            chosen = [self.operands[i] for i in np.flatnonzero(round_ == r)]
            result = _difference(result, [value for s, value in chosen if s == "-"])
            result = _union([result, *(value for s, value in chosen if s == "+")])
        return result


class _Product:
    """A chain of *, still growing."""

    def __init__(self, first):
        self.operands = deque([first])

    def add(self, other):
        if isinstance(other, _Product):
            if len(self.operands) < len(other.operands):
                other.operands.extendleft(reversed(self.operands))
                return other
            self.operands.extend(other.operands)
        else:
            self.operands.append(_value(other))
        return self

    def value(self):
        result, *rest = self.operands
        for value in rest:
            total = _total(value)
            result = {medium: intersection(parts, total) for medium, parts in result.items()}
        return result


def _value(item):
    return item.value() if isinstance(item, (_Sum, _Product)) else item


def evaluate(nodes, leaf_value):
    """The value of a tree in prefix order.

    ``nodes`` holds operators as "+", "-", "*" and leaves as anything else; ``leaf_value(leaf)`` makes a leaf's value,
    asked for from the last to the first.
    """
    stack = []
    for node in reversed(nodes):
        if not isinstance(node, str):
            stack.append(leaf_value(node))
            continue
        left, right = stack.pop(), stack.pop()
        if node == "*":
            stack.append((left if isinstance(left, _Product) else _Product(_value(left))).add(right))
        else:
            stack.append((left if isinstance(left, _Sum) else _Sum(_value(left))).add(node, right))
    return _value(stack.pop())


def precedence(media):
    """Media, each before those that give way to it: the opaque one, then dielectrics in the given order."""
    return sorted(dict.fromkeys(media), key=lambda medium: medium is not OPAQUE)  # stable


def shells(value, media):
    """The surfaces to render: a list of (medium, vertices, triangles, original id of each triangle).

    ``media`` are those of the scene in their order of precedence.

    An opaque solid is bounded by its whole surface. A dielectric gives way to opaque solids, and to dielectrics that
    stand before it in the tree: of its surface there remains what bounds the union of all up to it. So every interface
    exists exactly once, and from inside a dielectric every way out leads through its own surface or onto another's.
    """
    meshes, before = [], []
    for medium in media:
        parts = value.get(medium, [])
        if not parts:
            continue
        if not before:
            before = parts
            meshes += [(medium, *_arrays(p.manifold)) for p in parts]
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
                meshes.append((medium, vertices, triangles[mine], real[at[mine]]))
    return meshes


def _arrays(manifold):
    mesh = manifold.to_mesh64()
    runs = np.diff(np.asarray(mesh.run_index, dtype=np.int64)) // 3
    ids = np.repeat(np.asarray(mesh.run_original_id, dtype=np.int64), runs)
    return np.array(mesh.vert_properties)[:, :3], np.array(mesh.tri_verts, dtype=np.int64), ids


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
            run_original_id=np.arange(base, base + len(old), dtype=np.uint32))), part.surfaces)
    return renamed, originals
