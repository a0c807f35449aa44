"""Solids as lists of parts, and their union, difference and intersection by manifold3d.

A solid is a list of *parts* whose bounding boxes are disjoint, so that an operation costs what it touches and nothing
else. Where operands are reordered, those that may share a face keep the order of the tree: the first one gets it, see
:mod:`.coincidence`.
"""

import math
from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from manifold3d import Error, Manifold, Mesh64

from .coincidence import Planes
from .hidden import Extent
from .results import Content, kept
from .sweep import components, sweep, touching

CROWD = 64  # parts for each triangle that they may touch, from which on the triangles are divided
FEW = 32  # parts for each triangle then, about


class Run(NamedTuple):
    """The mesh of a primitive: its triangles bear an ``original_id`` and the numbers of their ``facets``."""

    vertices: np.ndarray
    triangles: np.ndarray
    facets: np.ndarray
    original_id: int


@dataclass(eq=False)
class Part:
    """A piece of a solid: how to make its mesh, its bounding box (min and max corner), the numbers of the surfaces that
    its faces may have in common with others, and for a whole primitive a ``key``, equal for those that are the same,
    its ``extent``, its mesh as a ``run``, and the number of its ``leaf``, None where its curved face is shared.
    ``content``: what it comes from, where results are kept.
    """

    make: Callable[[], Manifold]
    low: np.ndarray
    high: np.ndarray
    surfaces: frozenset[int]
    planes: Planes
    key: Hashable = None
    leaf: int | None = None
    extent: Callable[[], Extent] | None = None
    content: Content | None = None
    run: Run | None = None

    @cached_property
    def manifold(self) -> Manifold:
        """The mesh, made when it is first needed."""
        return self.make()


def solid(
    run: Run,
    box: np.ndarray,
    planes: Planes,
    surfaces: frozenset[int] = frozenset(),
    key: Hashable = None,
    leaf: int | None = None,
    extent: Callable[[], Extent] | None = None,
    content: Content | None = None,
) -> list[Part]:
    """A closed mesh as a list of one part; ``box`` (2, 3) is around it."""
    low, high = box[0] - planes.step, box[1] + planes.step
    return [Part(lambda: _made_of([run]), low, high, surfaces, planes, key, leaf, extent, content, run)]


def as_parts(
    manifold: Manifold, planes: Planes, *surfaces: frozenset[int], content: Content | None = None
) -> list[Part]:
    """A list of one part, or of none where nothing is left. Boxes are a little too large: faces that touch but for
    rounding are in touching boxes.
    """
    if _checked(manifold).is_empty():
        return []
    box = np.array(manifold.bounding_box())  # evaluates the operation
    low, high = box[:3] - planes.step, box[3:] + planes.step
    return [Part(lambda: manifold, low, high, frozenset().union(*surfaces), planes, content=content)]


def reserve_ids(count: int) -> int:
    """The first of so many original ids that nobody else has."""
    return int(Manifold.reserve_ids(count))


def boxes(parts: list[Part]) -> tuple[np.ndarray, np.ndarray]:
    """Min and max corners (n, 3) of the parts' boxes."""
    return np.array([p.low for p in parts]).reshape(-1, 3), np.array([p.high for p in parts]).reshape(-1, 3)


def union(operands: Iterable[list[Part]]) -> list[Part]:
    """Union of solids."""
    parts = _different([p for operand in operands for p in operand])
    while len(parts) > 1:
        groups = _components(parts)
        if len(groups) == len(parts):
            break
        parts = [p for group in groups for p in (_merge(group) if len(group) > 1 else group)]
    return parts


def difference(minuend: list[Part], subtrahend: list[Part]) -> list[Part]:
    """The first solid without the second."""
    if not minuend or not subtrahend:
        return minuend
    result = []
    for part, hits in zip(minuend, _hits(minuend, subtrahend)):
        if not hits:
            result.append(part)
        else:
            # The boxes of the subtrahend's parts are disjoint: they compose to one without any computation.
            result += _combined("-", _divided(part, len(hits)), _composed([subtrahend[i] for i in hits]))
    return result


def beneath(solid: list[Part], others: list[Part]) -> list[Part]:
    """The parts of a solid that touch others, without these: wherever the two touch, bounded by the others' faces."""
    if not solid or not others:
        return []
    touched = [(part, hits) for part, hits in zip(solid, _hits(solid, others)) if hits]
    if len(touched) > CROWD:  # each by itself would have a table of all that the others come from
        together = sorted({i for _, hits in touched for i in hits})
        touched = [(_composed([part for part, _ in touched]), together)]
    return [
        rest
        for part, hits in touched
        for rest in _combined("b-a", _composed([others[i] for i in hits]), _divided(part, len(hits)))
    ]


def intersection(first: list[Part], second: list[Part]) -> list[Part]:
    """What two solids have in common."""
    if not first or not second:
        return []
    hits = _hits(first, second)
    return [p for part, numbers in zip(first, hits) for i in numbers for p in _combined("*", part, second[i])]


def _hits(first: list[Part], second: list[Part]) -> list[list[int]]:
    """For each of some parts the numbers of the others whose boxes it touches."""
    result: list[list[int]] = [[] for _ in first]
    low, high = boxes(second)
    if len(first) <= len(second):
        return [touching(low, high, (part.low, part.high)).tolist() for part in first]
    own = boxes(first)
    for j, box in enumerate(zip(low, high)):
        for i in touching(*own, box).tolist():
            result[i].append(j)
    return result


def _made_of(runs: list[Run]) -> Manifold:
    """Meshes that do not touch as one."""
    first = np.cumsum([0, *(len(run.vertices) for run in runs[:-1])])
    mesh = Mesh64(
        np.concatenate([run.vertices for run in runs]).astype(np.float64, copy=False),
        np.concatenate([run.triangles + begin for run, begin in zip(runs, first)]).astype(np.uint64),
        run_index=np.cumsum([0, *(3 * len(run.triangles) for run in runs)]).astype(np.uint64),
        run_original_id=np.array([run.original_id for run in runs], dtype=np.uint32),
        face_id=np.concatenate([run.facets for run in runs]).astype(np.uint64),
    )
    return _checked(Manifold(mesh))


def _divided(part: Part, others: int) -> Part:
    """A part that so many others touch. Where these are a crowd for its triangles, as are holes in the face of a plate,
    it has more of them, without becoming another solid.

    manifold3d gives the rest of a triangle new triangles in a time that grows as the square of what has cut it.
    """
    if others <= 4 * CROWD:  # a closed mesh has four triangles at least
        return part

    def make() -> Manifold:
        if others <= CROWD * part.manifold.num_tri():
            return part.manifold
        _, middle, longest = sorted((part.high - part.low).tolist())
        length = max(math.sqrt(middle * longest * FEW / others), longest * FEW / others)
        return _checked(part.manifold.refine_to_length(length))

    content = Content.combined(f"divided for {others}", [part.content])
    return replace(part, make=make, run=None, content=content)


def _checked(manifold: Manifold) -> Manifold:
    status = manifold.status()
    if status != Error.NoError:
        raise ArithmeticError(f"manifold3d: {status}")
    return manifold


def _combined(operator: str, first: Part, second: Part) -> list[Part]:
    """One operation on two parts, +, -, * or ("b-a") the second one without the first one, whose common planes are told
    apart while it is done.
    """
    content = Content.combined(operator, [first.content, second.content])
    result = kept(content, "mesh", lambda: _made(operator, first, second), Manifold.num_tri)
    return as_parts(result, first.planes, first.surfaces, second.surfaces, content=content)


def _made(operator: str, first: Part, second: Part) -> Manifold:
    common, planes = first.surfaces & second.surfaces, first.planes
    a, b = first.manifold, second.manifold
    if common:
        a = planes.apart(a, common, 1 if operator in ("+", "b-a") else -1)
    result = b + a if operator == "+" else a - b if operator == "-" else b - a if operator == "b-a" else a ^ b
    if common and not _checked(result).is_empty():
        result = planes.closer(result, common)
    return _checked(result)


def _composed(parts: list[Part]) -> Part:
    """Parts whose boxes are disjoint as one."""
    if len(parts) == 1:
        return parts[0]
    low, high = boxes(parts)
    runs = [p.run for p in parts if p.run is not None]
    # To put thousands of meshes together takes longer than to make one of them all.
    at_once = len(runs) == len(parts) > CROWD
    return Part(
        lambda: _made_of(runs) if at_once else Manifold.compose([p.manifold for p in parts]),
        low.min(axis=0),
        high.max(axis=0),
        frozenset().union(*(p.surfaces for p in parts)),
        parts[0].planes,
        content=Content.combined("", (p.content for p in parts)),
    )


def _different(parts: list[Part]) -> list[Part]:
    """Parts without those that are the same primitive as an earlier one."""
    first: dict[Hashable, Part] = {}
    return [p for p in parts if p.key is None or first.setdefault(p.key, p) is p]


def _components(parts: list[Part]) -> list[list[Part]]:
    """Groups of parts whose boxes are connected by touching, each group in the given order."""
    groups: dict[int, list[Part]] = {}
    for part, group in zip(parts, components(*boxes(parts)).tolist()):
        groups.setdefault(group, []).append(part)
    return list(groups.values())


def _layers(parts: list[Part]) -> list[list[Part]] | None:
    """Few lists of parts, the parts of each disjoint, that may be united in this order; None where there are too many.

    Greedy colouring in the order of the tree; a part goes behind every earlier one with which it may share a face to
    the same side. (Where their boxes only touch, faces look at each other, and it does not matter which comes first.)
    """
    low, high = boxes(parts)
    color = np.zeros(len(parts), int)
    bearers: dict[int, set[int]] = {}  # surface -> the parts so far that have a face on it
    limit = 8 + 2 * math.ceil(math.log2(len(parts)))
    for i, part in enumerate(parts):
        near = touching(low[:i], high[:i], (part.low, part.high))
        depth = (np.minimum(high[near], part.high) - np.maximum(low[near], part.low)).min(axis=1)
        overlapping = set(near[depth > 4 * part.planes.step].tolist())
        sharing = [j for surface in part.surfaces for j in overlapping & bearers.setdefault(surface, set())]
        taken = set(color[near].tolist())
        color[i] = max((color[j] + 1 for j in sharing), default=0)
        while color[i] in taken:
            color[i] += 1
        if color[i] > limit:
            return None
        for surface in part.surfaces:
            bearers[surface].add(i)
    layers: list[list[Part]] = [[] for _ in range(color.max() + 1)]
    touched = np.zeros((len(parts), len(layers)), int)  # parts of each layer
    for first, second in sweep(low, high):
        np.add.at(touched, (np.append(first, second), color[np.append(second, first)]), 1)
    for part, c, others in zip(parts, color, touched.max(axis=1).tolist()):
        layers[c].append(_divided(part, others))
    return layers


def _merge(parts: list[Part]) -> list[Part]:
    """Union of parts, as a list of at most one part."""
    layers = _layers(parts) if len(parts) > 3 else None
    if layers:
        parts = [_composed(layer) for layer in layers]
    while len(parts) > 1:  # neighbours, in the order of the tree
        parts = [
            p
            for i in range(0, len(parts), 2)
            for p in (_combined("+", parts[i], parts[i + 1]) if i + 1 < len(parts) else [parts[i]])
        ]
    return parts
