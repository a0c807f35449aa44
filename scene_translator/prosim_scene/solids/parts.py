"""Solids as lists of parts, and their union, difference and intersection by manifold3d.

A solid is kept as a list of *parts* whose bounding boxes are disjoint, so that an operation costs what it touches and
nothing else.

Coincident faces: manifold3d gives them to the second operand of a union and to the first of an intersection. Wherever
operands are reordered, those that may share a face keep the order of the tree, so that the primitive that stands first
in the tree wins.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from manifold3d import Error, Manifold, Mesh64

@dataclass(frozen=True)
class Part:
    """A piece of a solid, its bounding box (min and max corner), and hashes of the surfaces that its faces lie on."""

    manifold: Manifold
    low: np.ndarray
    high: np.ndarray
    surfaces: frozenset


def as_parts(manifold: Manifold, *surfaces: frozenset) -> list[Part]:
    """A list of one part, or of none where nothing is left."""
    status = manifold.status()
    if status != Error.NoError:
        raise ArithmeticError(f"manifold3d: {status}")
    if manifold.is_empty():
        return []
    box = np.array(manifold.bounding_box())  # evaluates the operation
    return [Part(manifold, box[:3], box[3:], frozenset().union(*surfaces))]


def solid(vertices: np.ndarray, triangles: np.ndarray, original_id: int, surfaces: frozenset = frozenset()) -> list[Part]:
    """A closed triangle mesh as a list of one part that bears ``original_id``.

    ``surfaces`` are hashes of the planes and quadrics of its faces: solids that have none in common share no face.
    """
    return as_parts(Manifold(Mesh64(
        np.ascontiguousarray(vertices, dtype=np.float64), np.ascontiguousarray(triangles, dtype=np.uint64),
        run_index=np.array([0, 3 * len(triangles)], dtype=np.uint64),
        run_original_id=np.array([original_id], dtype=np.uint32))), surfaces)


def reserve_ids(count: int) -> int:
    """The first of so many original ids that nobody else has."""
    return Manifold.reserve_ids(count)


def _touching(part, low, high):
    """Indices of the boxes that overlap or touch a part's."""
    return np.flatnonzero(np.all((low <= part.high) & (high >= part.low), axis=1))


def boxes(parts: list[Part]) -> tuple[np.ndarray, np.ndarray]:
    """Min and max corners (n, 3) of the parts' boxes."""
    return np.array([p.low for p in parts]).reshape(-1, 3), np.array([p.high for p in parts]).reshape(-1, 3)


def _components(parts):
    """Groups of parts whose boxes are connected by touching, each group in the given order."""
    low, high = boxes(parts)
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
    low, high = boxes(parts)
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
                 for p in as_parts(Manifold.compose([p.manifold for p in layer]), *(p.surfaces for p in layer))]
    while len(parts) > 1:  # neighbours, the earlier as the second operand: the order decides coincident faces
        parts = [p for i in range(0, len(parts), 2) for p in (
            as_parts(parts[i + 1].manifold + parts[i].manifold, parts[i].surfaces, parts[i + 1].surfaces)
            if i + 1 < len(parts) else [parts[i]])]
    return parts


def union(operands: Iterable[list[Part]]) -> list[Part]:
    """Union of solids."""
    parts = [p for operand in operands for p in operand]
    while True:
        groups = _components(parts)
        if len(groups) == len(parts):
            return parts
        parts = [p for group in groups for p in (_merge(group) if len(group) > 1 else group)]


def difference(minuend: list[Part], subtrahend: list[Part]) -> list[Part]:
    """The first solid without the second."""
    low, high = boxes(subtrahend)
    result = []
    for part in minuend:
        hits = _touching(part, low, high)
        if not len(hits):
            result.append(part)
        else:  # the boxes of the subtrahend's parts are disjoint: they compose to one without any computation
            taken = [subtrahend[i] for i in hits]
            result += as_parts(part.manifold - Manifold.compose([p.manifold for p in taken]),
                             part.surfaces, *(p.surfaces for p in taken))
    return result


def intersection(first: list[Part], second: list[Part]) -> list[Part]:
    """What two solids have in common."""
    low, high = boxes(second)
    return [p for part in first for i in _touching(part, low, high)
            for p in as_parts(part.manifold ^ second[i].manifold, part.surfaces, second[i].surfaces)]
