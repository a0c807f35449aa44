"""Evaluates the CSG tree with manifold3d, which computes a mesh only when its data are needed.

Each connected component of touching boxes is evaluated separately, once for each medium. In the evaluation of a medium,
a leaf of another medium is used only if it cuts. If two operands share surfaces, their facets on these surfaces are
separated before the operation (see :mod:`.coincidence`). manifold3d evaluates all other operations in batches. In
chains of the operators + and -, each added body is cut by the later subtracted bodies that touch it; the union of these
parts is the result. If many bodies touch, a chain is evaluated in halves. The first half computes a solid X, the second
half changes X to X - S + P with solids S and P, and P is evaluated like a chain.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from manifold3d import Error, Manifold, OpType

from ..model import Leaf, Operator
from .coincidence import Planes
from .grouping import sweep, touching

T = TypeVar("T")
#: A CSG tree in prefix order: the symbols of its operators, and the numbers of its leaves.
Tree = Sequence[str | int]
#: An operand of an operator: its media, the number of its first leaf, and the number after its last leaf.
_Operand = tuple[frozenset[int], int, int]


def tree_of(nodes: Sequence[Operator | Leaf]) -> Tree:
    """Returns a scene's CSG tree; the leaves are numbered in their order."""
    numbers = iter(range(len(nodes)))
    return [node.symbol if isinstance(node, Operator) else next(numbers) for node in nodes]


def fold(tree: Tree, leaf: Callable[[int], T], combine: Callable[[str, T, T], T]) -> T:
    """Computes the value of a CSG tree: ``leaf(number)`` for a leaf, ``combine(symbol, first, second)`` for an
    operator.
    """
    stack: list[T] = []
    for node in reversed(tree):
        stack.append(combine(node, stack.pop(), stack.pop()) if isinstance(node, str) else leaf(node))
    return stack.pop()


def count_cut_media(tree: Tree, media_of: Sequence[int]) -> np.ndarray:
    """Returns, for each leaf, how many media the leaf can cut.

    A leaf in the second operand of an operator - or * can cut the media of the first operand. The result is the largest
    number of such media over all operators.
    """
    result = np.zeros(len(media_of), int)

    def combine(symbol: str, first: _Operand, second: _Operand) -> _Operand:
        """Returns the operand that an operator produces; updates the numbers of the leaves that cut."""
        media, begin, _ = first
        if symbol == "+":
            media = media | second[0]
        else:
            cut = result[second[1] : second[2]]
            np.maximum(cut, len(media), out=cut)
        return media, begin, second[2]

    fold(tree, lambda number: (frozenset([media_of[number]]), number, number + 1), combine)
    return result


@dataclass(eq=False)
class Body:
    """A solid of one medium.

    ``manifold()`` is its mesh, which manifold3d computes when it is needed. ``boxes`` (n, 10, 3) are the boxes of its
    leaves: minimum and maximum corner, then the eight corners of the rotated box. ``surfaces`` are the shared surfaces
    on which its faces may lie. Equal leaves have the same number ``solid``.
    """

    manifold: Callable[[], Manifold]
    boxes: np.ndarray
    surfaces: frozenset[int]
    planes: Planes
    solid: int | None = None

    @cached_property
    def box(self) -> np.ndarray:
        """The bounding box (2, 3) of the body: minimum and maximum corner."""
        return np.stack([self.boxes[:, 0].min(axis=0), self.boxes[:, 1].max(axis=0)])


def checked(manifold: Manifold) -> Manifold:
    """Computes and returns a lazy mesh. Raises ArithmeticError if manifold3d reports an error."""
    status = manifold.status()
    if status != Error.NoError:
        raise ArithmeticError(f"manifold3d: {status}")
    return manifold


def evaluate(tree: Tree, groups: Sequence[int], body: Callable[[int], Body | None]) -> dict[int, Body]:
    """Evaluates the CSG tree for each connected group of touching leaves; returns the solids that are not empty.

    ``groups`` has the group of each leaf. ``body(number)`` returns the solid of a leaf, or None.
    """

    def leaf(number: int) -> dict[int, _Chain]:
        """Returns the chain of a single leaf, by the group of the leaf; empty if the leaf has no solid."""
        value = body(number)
        return {groups[number]: _Chain(value)} if value else {}

    def combine(symbol: str, left: dict[int, _Chain], right: dict[int, _Chain]) -> dict[int, _Chain]:
        """Combines two operands, which have one chain of + and - for each group of touching leaves, group by group."""
        # If only one operand has a group, + keeps the group, - keeps a group of the left operand, * removes the group.
        small, large = sorted((left, right), key=len)
        common = {group: left[group].combined(symbol, right[group]) for group in small if group in large}
        if symbol == "*":
            return common
        result = left
        if symbol == "+":
            result = large
            result.update(small)
        result.update(common)
        return result

    return {group: chain.value() for group, chain in sorted(fold(tree, leaf, combine).items())}


#: An operand of a chain: its sign + or -, and the body.
Operand = tuple[str, Body]


class _Chain:
    """A chain of the operators + and -: operands with their signs; the first operand is positive."""

    def __init__(self, first: Body) -> None:
        """Makes a chain with the single operand ``first``."""
        self.operands = deque([("+", first)])
        self.has_minus = False

    def combined(self, symbol: str, other: _Chain) -> _Chain:
        """Returns the chain for an operator with this chain and ``other`` as operands.

        A + (B + C) and A - (B + C) are flattened to one chain.
        """
        if symbol == "*":
            first = self.value()
            return _Chain(_combined([first, other.value()], OpType.Intersect, [first]))
        right = _Chain(other.value()) if other.has_minus else other
        if symbol == "+" and not self.has_minus and len(self.operands) < len(right.operands):
            right.operands.extendleft(reversed(self.operands))
            return right
        self.operands.extend((symbol, body) for _, body in right.operands)
        self.has_minus |= symbol == "-"
        return self

    def value(self) -> Body:
        """Evaluates the chain from left to right.

        Operands that do not touch can be exchanged. So each operand is moved to the earliest possible step: after the
        steps of all earlier operands that it touches, or to the same step if the signs are equal.
        """
        operands = list(self.operands)
        if self.has_minus:
            adds = np.array([sign == "+" for sign, _ in operands])
            boxes = np.array([body.box for _, body in operands])
            step = np.zeros(len(adds), int)
            for i in range(1, len(adds)):
                earlier = touching(boxes[:i], boxes[i])
                step[i] = (step[earlier] + (adds[earlier] & ~adds[i])).max(initial=0)
            result = apply([operands[i] for i in np.argsort(2 * step + adds, kind="stable")])
        else:
            result = union(body for _, body in operands)
        assert result
        return result


def apply(operands: list[Operand]) -> Body | None:
    """Evaluates a part of a chain; returns None if the part adds no body.

    If few bodies touch, each added body is cut by the later subtracted bodies that touch it. Otherwise the chain is
    evaluated in halves.
    """
    subtracted = [body for sign, body in operands if sign == "-"]
    boxes = np.array([body.box for body in subtracted]).reshape(-1, 2, 3)
    passed = np.cumsum([sign == "-" for sign, _ in operands])  # the number of subtracted bodies before each added body
    cuts = [(body, n + touching(boxes[n:], body.box)) for (sign, body), n in zip(operands, passed) if sign == "+"]
    if sum(len(cutters) for _, cutters in cuts) <= len(operands) and _mergeable(operands, True):
        return union(difference(body, [subtracted[i] for i in cutters]) for body, cutters in cuts)
    changes = [i for i in range(2, len(operands)) if operands[i - 1][0] == "+" and operands[i][0] == "-"]
    middle = changes[len(changes) // 2]
    rest, later = apply(operands[:middle]), operands[middle:]
    if rest and not _mergeable([("+", rest), *later]):
        return apply([("+", rest), *later])
    return union([rest and difference(rest, [body for sign, body in later if sign == "-"]), apply(later)])


def _mergeable(operands: list[Operand], all_faces: bool = False) -> bool:
    """Whether merged operations give each face the same owner as operations that are applied one after the other.

    An added body may cover a face of the first body or of a subtracted body; if ``all_faces``, also of another added
    body. A later body may be subtracted that has a face on the same surface, and so uncover the covered face. If the
    operations are applied one after the other, the later body owns the face; after merging, the earlier body owns it.
    No face is covered if there is material on only one side of the surface.
    """
    (_, first), *later = operands
    boxes = np.concatenate([first.boxes, *(body.boxes for sign, body in later if sign == "+")])
    surfaces, end = set(first.surfaces), len(first.boxes)  # of faces, and of boxes, in earlier operations
    for sign, body in later:
        if sign == "-" and (common := surfaces & body.surfaces):
            near = touching(boxes[:end], body.box)
            if (near >= len(first.boxes)).any() and not first.planes.one_sided(common, boxes[near]):
                return False
        if sign == "+":
            end += len(body.boxes)
        if sign == "-" or all_faces:
            surfaces |= body.surfaces
    return True


def union(bodies: Iterable[Body | None]) -> Body | None:
    """Returns the union of bodies, or None if there are none. The first of the bodies owns a common face."""
    solids: dict[int | None, Body] = {}
    distinct = [body for body in bodies if body and (body.solid is None or solids.setdefault(body.solid, body) is body)]
    if len(distinct) < 2:
        return distinct[0] if distinct else None
    if len(distinct) == 2 or not _share_surfaces(distinct):
        return _combined(distinct, OpType.Add, distinct)
    middle = len(distinct) // 2
    return union([union(distinct[:middle]), union(distinct[middle:])])


def difference(first: Body, others: Sequence[Body]) -> Body:
    """Returns the first body minus the other bodies; an earlier body owns a common face."""
    near = [body for body in others if len(touching(body.boxes, first.box))]
    if _share_surfaces([first, *near]) and (body := union(near)):
        near = [body]
    return _combined([first, *near], OpType.Subtract, [first]) if near else first


def remainder(first: Body, second: Body) -> Body:
    """Returns the second body minus the first body. On common surfaces, the faces of the result belong to the first
    body.
    """
    return _combined([first, second], None, [second])


def _combined(bodies: Sequence[Body], operation: OpType | None, around: Sequence[Body]) -> Body:
    """Returns the result of a Boolean operation, which has the boxes of the bodies ``around``.

    The operation None is the second body minus the first body. If bodies share surfaces, there are only two bodies. On
    these surfaces, the first body grows; for subtraction and intersection it shrinks, see :meth:`.Planes.separate`.
    """
    solids, planes = [body.manifold() for body in bodies], bodies[0].planes
    if _share_surfaces(bodies):
        first, second = solids
        solids = planes.separate(first, second, -1 if operation in (OpType.Subtract, OpType.Intersect) else 1)
    result = Manifold.batch_boolean(solids if operation else solids[::-1], operation or OpType.Subtract)
    boxes = np.concatenate([body.boxes for body in around])
    return Body(lambda: result, boxes, frozenset().union(*(body.surfaces for body in bodies)), planes)


def _share_surfaces(bodies: Sequence[Body]) -> bool:
    """Whether two of the bodies have a common surface."""
    return sum(len(body.surfaces) for body in bodies) > len(frozenset().union(*(body.surfaces for body in bodies)))


MAX_NEIGHBOURS = 64  # a leaf's mesh is refined if more small solids than this touch it, per triangle
REFINED_NEIGHBOURS = 32  # the approximate number of small solids per triangle of a refined mesh
SMALL = 8  # a solid is small if its box has less than 1/8 of the volume of the other box


def count_small_neighbours(boxes: np.ndarray) -> np.ndarray:
    """Returns, for each of the ``boxes`` (see :class:`Body`), how many small boxes touch it."""
    result = np.zeros(len(boxes), int)
    size = (boxes[:, 1] - boxes[:, 0]).prod(axis=1)
    for pair in sweep(boxes[:, 0], boxes[:, 1]):
        for large, small in (pair, pair[::-1]):
            np.add.at(result, large[size[small] < size[large] / SMALL], 1)
    return result


def refined(manifold: Manifold, small_neighbours: int) -> Manifold:
    """Returns a leaf's mesh, which is refined if many small solids touch it, such as holes in a plate.

    The time in which manifold3d triangulates a cut triangle grows as the square of the number of cuts.
    """
    if small_neighbours <= MAX_NEIGHBOURS * manifold.num_tri():
        return manifold
    box = manifold.bounding_box()
    _, middle, longest = sorted(high - low for low, high in zip(box[:3], box[3:]))
    by_area = math.sqrt(middle * longest * REFINED_NEIGHBOURS / small_neighbours)
    return manifold.refine_to_length(max(by_area, longest * REFINED_NEIGHBOURS / small_neighbours))
