"""Evaluates the CSG tree with manifold3d, which computes a mesh only when its data are needed.

Leaves whose boxes touch are in one group. Each group is evaluated separately, once for each medium. The solid of a
medium consists of the leaves of this medium; leaves of other media can only cut it. If two operands share surfaces,
their facets on these surfaces are moved apart before the operation (see :mod:`.coincidence`).

Operators + and - that follow each other form a chain. If few bodies touch, each added body is cut by the subtracted
bodies that come later in the chain; the result is the union of the cut bodies. If many bodies touch, the chain is
divided into halves. The result of the first half is a solid X. The result of the chain is X - S + P: S are the
subtracted bodies of the second half, and P is the result of the second half alone.
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
from .solids import Solid

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

    ``media_of`` has the medium of each leaf. A leaf in the second operand of an operator - or * can cut the media of
    the first operand. If the leaf is in the second operand of several such operators, the largest number counts.
    """
    result = np.zeros(len(media_of), int)

    def combine(symbol: str, first: _Operand, second: _Operand) -> _Operand:
        """Returns the media and the leaves of an operator's result; updates ``result`` for the leaves that cut."""
        (media, begin, _), (other_media, middle, end) = first, second
        if symbol == "+":
            return media | other_media, begin, end
        np.maximum(result[middle:end], len(media), out=result[middle:end])
        return media, begin, end

    fold(tree, lambda number: (frozenset([media_of[number]]), number, number + 1), combine)
    return result


@dataclass(eq=False)
class Body:
    """A solid of one medium.

    ``manifold()`` returns the mesh of the solid. ``boxes`` (n, 10, 3) are the boxes of its leaves: minimum and maximum
    corner of the box along the axes, then the eight corners of the rotated box. ``surfaces`` are the numbers of the
    shared surfaces on which faces of the solid may lie. ``planes`` are all planes of the scene on which facets of
    several bodies may lie. Bodies with the same ``solid`` are equal; ``solid`` is None for the result of an operation.
    """

    manifold: Callable[[], Manifold]
    boxes: np.ndarray
    surfaces: frozenset[int]
    planes: Planes
    solid: Solid | None = None

    @cached_property
    def box(self) -> np.ndarray:
        """The bounding box (2, 3) of the body: minimum and maximum corner."""
        return np.stack([self.boxes[:, 0].min(axis=0), self.boxes[:, 1].max(axis=0)])


def checked(manifold: Manifold) -> Manifold:
    """Lets manifold3d compute a mesh, and returns the mesh. Raises ArithmeticError if manifold3d reports an error."""
    status = manifold.status()
    if status != Error.NoError:
        raise ArithmeticError(f"manifold3d: {status}")
    return manifold


def evaluate(tree: Tree, groups: Sequence[int], body: Callable[[int], Body | None]) -> dict[int, Body]:
    """Evaluates the CSG tree separately for each group of leaves that touch; returns the result of each group.

    ``groups`` has the number of the group of each leaf. ``body(number)`` returns the solid of a leaf, or None if the
    leaf has no effect. Groups whose result contains no leaf are left out.
    """

    def leaf(number: int) -> dict[int, _Chain]:
        """Returns the chain of a single leaf, by the group of the leaf; empty if the leaf has no solid."""
        value = body(number)
        return {groups[number]: _Chain(value)} if value else {}

    def combine(symbol: str, left: dict[int, _Chain], right: dict[int, _Chain]) -> dict[int, _Chain]:
        """Applies an operator to two operands, group by group; an operand has a chain of + and - for each group."""
        # If only one operand has a group, + keeps the group, - keeps a group of the left operand, * removes the group.
        small, large = sorted((left, right), key=len)
        common = {group: left[group].combined(symbol, right[group]) for group in small if group in large}
        if symbol == "*":
            return common
        if symbol == "+":
            large.update(small)
            left = large
        left.update(common)
        return left

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
        """Returns the chain for the operator ``symbol`` with the operands ``self`` and ``other``.

        A + (B + C) and A - (B + C) become one chain. Changes both operands.
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
        """Returns the result of the chain.

        Bodies that do not touch may change places. So the bodies are sorted by rounds: each round first subtracts
        bodies, and then adds bodies. Each body belongs to the first possible round in which it still comes after all
        earlier bodies of the other sign that it touches.
        """
        last = {body.solid: i if self.has_minus else math.inf for i, (_, body) in enumerate(self.operands)}

        def enclosed(i: int, body: Body) -> bool:
            """Whether the operand ``i`` lies inside another operand, which must come later if the chain has a minus."""
            return body.solid is not None and any(last.get(outer, -1) > i for outer in body.solid.enclosing)

        operands = [(sign, body) for i, (sign, body) in enumerate(self.operands) if i == 0 or not enclosed(i, body)]
        if self.has_minus:
            adds = np.array([sign == "+" for sign, _ in operands])
            boxes = np.array([body.box for _, body in operands])
            rounds = np.zeros(len(adds), int)
            for i in range(1, len(adds)):
                earlier = touching(boxes[:i], boxes[i])
                rounds[i] = (rounds[earlier] + (adds[earlier] & ~adds[i])).max(initial=0)
            result, _ = evaluate_chain([operands[i] for i in np.argsort(2 * rounds + adds, kind="stable")])
        else:
            result = union(body for _, body in operands)
        assert result
        return result


def evaluate_chain(operands: list[Operand]) -> tuple[Body | None, list[Body]]:
    """Returns the result of a part of a chain, and bodies whose union is the union of the subtracted bodies.

    The part starts with the empty solid; its result is None if it adds no body. If few bodies touch, each added body is
    cut by the later subtracted bodies that touch it. Otherwise the part is divided into halves.
    """
    subtracted = [body for sign, body in operands if sign == "-"]
    boxes = np.array([body.box for body in subtracted]).reshape(-1, 2, 3)
    passed = np.cumsum([sign == "-" for sign, _ in operands])  # the number of subtracted bodies before each added body
    cuts = [(body, n + touching(boxes[n:], body.box)) for (sign, body), n in zip(operands, passed) if sign == "+"]
    if sum(len(cutters) for _, cutters in cuts) <= len(operands) and _divisible(operands, True):
        return union(difference(body, [subtracted[i] for i in cutters]) for body, cutters in cuts), subtracted
    changes = [i for i in range(2, len(operands)) if operands[i - 1][0] == "+" and operands[i][0] == "-"]
    middle = changes[len(changes) // 2]
    (first, cut_first), later = evaluate_chain(operands[:middle]), operands[middle:]
    if first and not _divisible([("+", first), *later]):
        result, cut = evaluate_chain([("+", first), *later])
        return result, [*cut_first, *cut]
    added, cut = evaluate_chain(later)
    cut = [body for body in [union(cut)] if body]  # one body, which the caller uses again
    rest = first and difference(first, cut)
    return union([rest, added]), [*cut_first, *cut]


def _divisible(operands: list[Operand], all_faces: bool = False) -> bool:
    """Whether a chain gives each face the right owner if its added bodies are cut one by one.

    An example: a body is added that covers a face of the first body. Then a body is subtracted that has a face on the
    same surface, and uncovers the covered face. From left to right, the subtracted body owns the uncovered face. If the
    first body is cut on its own, its face was never covered, and the first body owns it. This cannot happen if all
    material is on one side of the surface. The covered face may also be a face of a subtracted body, or of any added
    body if ``all_faces``.
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


CROWDED = 8  # a union is divided if each body touches more than twice this number of other bodies, on average


def union(bodies: Iterable[Body | None]) -> Body | None:
    """Returns the union of bodies, or None if all are None. The first of the bodies owns a common face."""
    solids: dict[Solid | None, Body] = {}
    distinct = [body for body in bodies if body and (body.solid is None or solids.setdefault(body.solid, body) is body)]
    if len(distinct) < 2:
        return distinct[0] if distinct else None
    shared, boxes = _share_surfaces(distinct), np.array([body.box for body in distinct])
    pairs = sum(len(first) for first, _ in sweep(boxes[:, 0], boxes[:, 1]))
    if len(distinct) == 2 or (not shared and pairs <= CROWDED * len(distinct)):
        return _combined(distinct, OpType.Add, distinct)
    if not shared:
        axis = np.ptp(boxes.sum(axis=1), axis=0).argmax()
        distinct = [distinct[i] for i in np.argsort(boxes[:, :, axis].sum(axis=1))]
    middle = len(distinct) // 2
    result = union([union(distinct[:middle]), union(distinct[middle:])])
    if result and not shared:
        checked(result.manifold())  # otherwise manifold3d would join this operation and the next one
    return result


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


def _combined(bodies: Sequence[Body], operation: OpType | None, boxed: Sequence[Body]) -> Body:
    """Returns the result of a Boolean operation on ``bodies``; the result gets the boxes of the bodies ``boxed``.

    The operation None is the second body minus the first body. Only two bodies may share surfaces. On these surfaces,
    the first body grows; for subtraction and intersection it shrinks, see :meth:`.Planes.separate`.
    """
    solids, planes = [body.manifold() for body in bodies], bodies[0].planes
    if _share_surfaces(bodies) and len(touching(bodies[0].boxes, bodies[1].box)):
        first, second = solids
        solids = planes.separate(first, second, -1 if operation in (OpType.Subtract, OpType.Intersect) else 1)
    result = Manifold.batch_boolean(solids if operation else solids[::-1], operation or OpType.Subtract)
    boxes = np.concatenate([body.boxes for body in boxed])
    return Body(lambda: result, boxes, frozenset().union(*(body.surfaces for body in bodies)), planes)


def _share_surfaces(bodies: Sequence[Body]) -> bool:
    """Whether two of the bodies have a common surface."""
    return sum(len(body.surfaces) for body in bodies) > len(frozenset().union(*(body.surfaces for body in bodies)))


MAX_NEIGHBOURS = 64  # a leaf's mesh is refined if more small solids than this touch it, per triangle
REFINED_NEIGHBOURS = 32  # the approximate number of small solids per triangle of a refined mesh
SMALL = 8  # a solid is small if its box has less than 1/8 of the volume of the other box


def count_small_neighbours(boxes: np.ndarray) -> np.ndarray:
    """Returns, for each of n boxes (n, 10, 3), how many small boxes touch it; see :class:`Body` and SMALL."""
    result = np.zeros(len(boxes), int)
    size = (boxes[:, 1] - boxes[:, 0]).prod(axis=1)
    for pair in sweep(boxes[:, 0], boxes[:, 1]):
        for large, small in (pair, pair[::-1]):
            np.add.at(result, large[size[small] < size[large] / SMALL], 1)
    return result


def refined(manifold: Manifold, small_neighbours: int) -> Manifold:
    """Returns the mesh of a leaf. If many small solids touch the leaf, such as holes in a plate, its edges are split.

    If n solids cut one triangle, manifold3d needs a time proportional to n² to triangulate it.
    """
    if small_neighbours <= MAX_NEIGHBOURS * manifold.num_tri():
        return manifold
    box = manifold.bounding_box()
    _, middle, longest = sorted(high - low for low, high in zip(box[:3], box[3:]))
    by_area = math.sqrt(middle * longest * REFINED_NEIGHBOURS / small_neighbours)
    return manifold.refine_to_length(max(by_area, longest * REFINED_NEIGHBOURS / small_neighbours))
