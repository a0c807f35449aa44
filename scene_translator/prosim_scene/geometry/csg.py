"""Evaluates the CSG tree with manifold3d. manifold3d computes the mesh of a result only when the mesh's data are
needed.

Leaves of the CSG tree whose boxes touch are in one group. The tree is evaluated separately for each group and for each
medium (opaque, or a kind of dielectric). The solid of a medium consists of the leaves of this medium; leaves of other
media can only cut this solid. If two operands share surfaces, their facets on the shared surfaces are moved apart
before the Boolean operation (see :mod:`.coincidence`).

Operators + and - that follow each other in the CSG tree form a chain, such as A + B - C + D. If few bodies of a chain
touch, each added body is cut by the subtracted bodies that come later in the chain, and the result of the chain is the
union of the cut bodies. Otherwise the runs of bodies with the same operator are added and subtracted one after the
other.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby
from operator import itemgetter
from typing import TypeVar

import numpy as np
from manifold3d import Error, Manifold, OpType

from ..model import Leaf, Operator
from .coincidence import Planes
from .grouping import touching
from .solids import Solid

T = TypeVar("T")
#: A CSG tree in prefix order: the symbols of its operators, and the numbers of its leaves.
Tree = Sequence[str | int]
#: An operand of an operator: its media, the number of its first leaf, and the number after its last leaf.
_Operand = tuple[frozenset[int], int, int]


def tree_of(nodes: Sequence[Operator | Leaf]) -> Tree:
    """Returns a scene's CSG tree in prefix order; the leaves are numbered from 0, in the order of ``nodes``."""
    numbers = iter(range(len(nodes)))
    return [node.symbol if isinstance(node, Operator) else next(numbers) for node in nodes]


def fold(tree: Tree, leaf: Callable[[int], T], combine: Callable[[str, T, T], T]) -> T:
    """Returns the value of a CSG tree from the leaves upwards; ``combine(symbol, first, second)`` is an operator's."""
    stack: list[T] = []
    for node in reversed(tree):
        stack.append(combine(node, stack.pop(), stack.pop()) if isinstance(node, str) else leaf(node))
    return stack.pop()


def count_cut_media(tree: Tree, media_of: Sequence[int]) -> np.ndarray:
    """Returns, for each leaf of the CSG tree, the number of media that the leaf can cut.

    ``media_of`` has the number of the medium of each leaf. A leaf in the second operand of an operator - or * can cut
    the media of the leaves in the first operand. If a leaf is in the second operands of several operators - or *, the
    largest of their numbers of media counts.
    """
    result = np.zeros(len(media_of), int)

    def combine(symbol: str, first: _Operand, second: _Operand) -> _Operand:
        (media, begin, _), (other_media, middle, end) = first, second
        if symbol == "+":
            return media | other_media, begin, end
        np.maximum(result[middle:end], len(media), out=result[middle:end])
        return media, begin, end

    fold(tree, lambda number: (frozenset([media_of[number]]), number, number + 1), combine)
    return result


@dataclass(eq=False)
class Body:
    """A solid of one medium: a leaf of the CSG tree, or the result of Boolean operations.

    ``manifold()`` returns the mesh of the body. ``boxes`` (n, 2, 3) are the boxes of its n leaves. ``surfaces`` are the
    numbers of the shared surfaces on which faces of the body may lie. ``planes`` are all planes of the scene on which
    facets of several bodies may lie. ``leaf`` is the number of the first leaf. The attribute ``solid`` of a leaf is the
    same object for equal leaves; ``solid`` is None for the result of an operation.
    """

    manifold: Callable[[], Manifold]
    boxes: np.ndarray
    surfaces: frozenset[int]
    planes: Planes
    leaf: int
    solid: Solid | None = None

    @cached_property
    def box(self) -> np.ndarray:
        """The bounding box (2, 3) of the body along the axes of the world: the minimum and the maximum corner."""
        return np.stack([self.boxes[:, 0].min(axis=0), self.boxes[:, 1].max(axis=0)])


class OperationError(Exception):
    """manifold3d reports an error; the arguments are the name of the error, and the number of a leaf of the mesh."""


def checked(manifold: Manifold, leaf: int) -> Manifold:
    """Makes manifold3d compute the mesh, of which ``leaf`` is a leaf, and returns it. Raises OperationError."""
    status = manifold.status()
    if status != Error.NoError:
        raise OperationError(status.name, leaf)
    return manifold


def evaluate(tree: Tree, groups: Sequence[int], body: Callable[[int], Body | None]) -> dict[int, Body]:
    """Evaluates the CSG tree separately for each group of leaves that touch; returns the resulting body of each group.

    ``groups`` has, for each leaf, the number of its group. ``body(number)`` returns the body of a leaf, or None if the
    leaf has no effect in the evaluated medium. The returned dictionary has no entry for a group of which no leaf is
    left in the result.
    """

    def leaf(number: int) -> dict[int, _Chain]:
        value = body(number)
        return {groups[number]: _Chain(value)} if value else {}

    def combine(symbol: str, left: dict[int, _Chain], right: dict[int, _Chain]) -> dict[int, _Chain]:
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
    def __init__(self, first: Body) -> None:
        self.operands = deque([("+", first)])
        self.has_minus = False

    def combined(self, symbol: str, other: _Chain) -> _Chain:
        """Returns the chain of the two operands: A + (B + C) becomes the chain A + B + C, and A - (B + C) becomes the
        chain A - B - C. The operands are changed, so the caller cannot use them again.
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
        """Evaluates the chain, and returns the resulting body."""
        result = evaluate_chain(self.operands) if self.has_minus else union(body for _, body in self.operands)
        assert result
        return result


def evaluate_chain(operands: Sequence[Operand]) -> Body | None:
    """Evaluates a chain of + and -, which begins with +. If few operands touch, each added body is cut by the later
    subtracted ones that touch it.
    """
    subtracted = [body for sign, body in operands if sign == "-"]
    boxes = np.array([body.box for body in subtracted])
    passed = np.cumsum([sign == "-" for sign, _ in operands])  # the number of subtracted bodies before each added body
    cuts = [(body, n + touching(boxes[n:], body.box)) for (sign, body), n in zip(operands, passed) if sign == "+"]
    if sum(len(cutters) for _, cutters in cuts) <= len(operands) and _divisible(operands):
        return union(difference(body, [subtracted[i] for i in cutters]) for body, cutters in cuts)
    result: Body | None = None
    for sign, run in groupby(operands, itemgetter(0)):
        bodies = [body for _, body in run]
        if sign == "+":
            result = union([result, union(bodies)])
        elif result:
            result = difference(result, bodies)
    return result


def _divisible(operands: Iterable[Operand]) -> bool:
    """Whether each face of a chain's result gets the right owner if each added body of the chain is cut separately. The
    owner of a face is the leaf whose material the face gets.

    An example of a wrong owner: A + B - C, where B covers a face of A, and C has a face on the same surface and
    uncovers the covered face of A. If A + B - C is evaluated from left to right, C owns the uncovered face. If A is cut
    by C separately, the face of A was never covered, and A owns the face.
    """
    (_, first), *later = operands
    added = np.concatenate([first.boxes[:0], *(body.boxes for sign, body in later if sign == "+")])
    surfaces, end = set(first.surfaces), 0  # the surfaces of earlier operands, and the number of boxes added earlier
    for sign, body in later:
        if sign == "+":
            end += len(body.boxes)
        elif surfaces & body.surfaces and len(touching(added[:end], body.box)):
            return False
        surfaces |= body.surfaces
    return True


def union(bodies: Iterable[Body | None]) -> Body | None:
    """Returns the union of bodies, or None if all are None. If bodies have a common face, the first of these bodies
    owns the face.

    A union of bodies that share no surface is one operation of manifold3d, unless all boxes have a common point. Other
    unions are divided into halves.
    """
    solids: dict[Solid | None, Body] = {}
    distinct = [body for body in bodies if body and (body.solid is None or solids.setdefault(body.solid, body) is body)]
    if len(distinct) < 2:
        return distinct[0] if distinct else None
    boxes, shares = np.array([body.box for body in distinct]).reshape(-1, 6), _share_surfaces(distinct)
    if len(distinct) == 2 or (not shares and (boxes[:, :3].max(axis=0) > boxes[:, 3:].min(axis=0)).any()):
        return _combined(distinct, OpType.Add, distinct)
    if not shares:  # the union of bodies with similar boxes hides the most faces, so the next operation is faster
        order = np.argsort(boxes[:, np.ptp(boxes, axis=0).argmax()], kind="stable")
        distinct = [distinct[i] for i in order]
    middle = len(distinct) // 2
    return union([union(distinct[:middle]), union(distinct[middle:])])


#: A mesh without shared surfaces from which more solids are subtracted, per triangle, is refined before: n cuts of one
#: triangle take manifold3d a time proportional to n².
MAX_CUTS = 16


def difference(first: Body, others: Sequence[Body]) -> Body:
    """Returns ``first`` minus ``others``; the earliest body owns a common face."""
    near = [body for body in others if len(touching(body.boxes, first.box))]
    solid = first.manifold()
    if not first.surfaces and 0 < MAX_CUTS * solid.num_tri() < len(near):
        refined = solid.refine(math.ceil(math.sqrt(len(near) / (MAX_CUTS * solid.num_tri()))))
        first = replace(first, manifold=lambda: refined)
    cutter = union(near)
    return _combined([first, cutter], OpType.Subtract, [first]) if cutter else first


def remainder(first: Body, second: Body) -> Body:
    """Returns the second body minus the first, which owns the faces on surfaces that both share."""
    return _combined([first, second], None, [second])


def _combined(bodies: Sequence[Body], operation: OpType | None, boxed: Sequence[Body]) -> Body:
    """Returns the body that results from a Boolean operation on ``bodies``; the returned body gets the ``boxes`` of the
    bodies ``boxed``.

    If ``operation`` is None, the result is the second body minus the first body. Bodies may share surfaces only if
    there are two bodies. On the surfaces that two bodies share, the first body grows before a union and before the
    operation None, and shrinks before a subtraction or an intersection; see :meth:`.Planes.separate`.
    """
    solids, planes = [body.manifold() for body in bodies], bodies[0].planes
    if _share_surfaces(bodies) and len(touching(bodies[0].boxes, bodies[1].box)):
        first, second = solids
        solids = planes.separate(first, second, -1 if operation in (OpType.Subtract, OpType.Intersect) else 1)
    # Without the check, manifold3d would join this operation and the next one, and change the order of their operands.
    leaf, boxes = boxed[0].leaf, np.concatenate([body.boxes for body in boxed])
    result = Manifold.batch_boolean(solids if operation else solids[::-1], operation or OpType.Subtract)
    checked(result, leaf)
    return Body(lambda: result, boxes, frozenset().union(*(body.surfaces for body in bodies)), planes, leaf)


def _share_surfaces(bodies: Sequence[Body]) -> bool:
    return sum(len(body.surfaces) for body in bodies) > len(frozenset().union(*(body.surfaces for body in bodies)))
