"""Evaluates the CSG tree with manifold3d. manifold3d computes the mesh of a result only when the mesh's data are
needed.

Leaves of the CSG tree whose boxes touch are in one group. The tree is evaluated separately for each group and for each
medium (opaque, or a kind of dielectric). The solid of a medium consists of the leaves of this medium; leaves of other
media can only cut this solid. If two operands share surfaces, their facets on the shared surfaces are moved apart
before the Boolean operation (see :mod:`.coincidence`).

Operators + and - that follow each other in the CSG tree form a chain, such as A + B - C + D, which is evaluated from
left to right. Operands with the same sign that follow each other are united first: A - B - C is A - (B + C).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter
from typing import TypeVar

import numpy as np
from manifold3d import Error, Manifold, OpType

from ..model import Leaf, Operator
from .coincidence import Planes
from .grouping import touch

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
    """Returns the value of a CSG tree, computed from the leaves upwards: the value of a leaf is ``leaf(number)``, and
    the value of an operator is ``combine(symbol, first, second)``, with the values of its two operands.
    """
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
        """Returns the media and the range of leaves of an operator's result; for - and *, also updates ``result`` for
        the leaves of the second operand.
        """
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

    ``manifold()`` returns the mesh of the body. ``box`` (2, 3) has the minimum and the maximum corner of a box that
    contains the body. ``surfaces`` are the numbers of the shared surfaces on which faces of the body may lie.
    ``planes`` are all planes of the scene on which facets of several bodies may lie.
    """

    manifold: Callable[[], Manifold]
    box: np.ndarray
    surfaces: frozenset[int]
    planes: Planes


def checked(manifold: Manifold) -> Manifold:
    """Makes manifold3d compute the mesh of ``manifold``, and returns ``manifold``. Raises ArithmeticError if manifold3d
    reports an error.
    """
    status = manifold.status()
    if status != Error.NoError:
        raise ArithmeticError(f"manifold3d: {status}")
    return manifold


def evaluate(tree: Tree, groups: Sequence[int], body: Callable[[int], Body | None]) -> dict[int, Body]:
    """Evaluates the CSG tree separately for each group of leaves that touch; returns the resulting body of each group.

    ``groups`` has, for each leaf, the number of its group. ``body(number)`` returns the body of a leaf, or None if the
    leaf has no effect in the evaluated medium. The returned dictionary has no entry for a group of which no leaf is
    left in the result.
    """

    def leaf(number: int) -> dict[int, _Chain]:
        """Returns a dictionary from the group of a leaf to a chain of this leaf alone; the dictionary is empty if
        ``body(number)`` is None.
        """
        value = body(number)
        return {groups[number]: _Chain(value)} if value else {}

    def combine(symbol: str, left: dict[int, _Chain], right: dict[int, _Chain]) -> dict[int, _Chain]:
        """Applies an operator of the CSG tree to two operands, group by group. Each operand is a dictionary from groups
        to chains of + and -.
        """
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
    """A chain of the operators + and -, such as A + B - C: the operands with their signs. The first operand has the
    sign +.
    """

    def __init__(self, first: Body) -> None:
        """Makes a chain that has only one operand, the body ``first`` with the sign +."""
        self.operands = deque([("+", first)])
        self.has_minus = False

    def combined(self, symbol: str, other: _Chain) -> _Chain:
        """Returns the chain that results from the operator ``symbol`` with the chains ``self`` and ``other`` as
        operands.

        A + (B + C) becomes the chain A + B + C, and A - (B + C) becomes the chain A - B - C. The chains ``self`` and
        ``other`` are changed, so the caller cannot use them again.
        """
        if symbol == "*":
            return _Chain(_combined([self.value(), other.value()], OpType.Intersect))
        right = _Chain(other.value()) if other.has_minus else other
        if symbol == "+" and not self.has_minus and len(self.operands) < len(right.operands):
            right.operands.extendleft(reversed(self.operands))
            return right
        self.operands.extend((symbol, body) for _, body in right.operands)
        self.has_minus |= symbol == "-"
        return self

    def value(self) -> Body:
        """Evaluates the chain from left to right, and returns the resulting body. Operands that follow each other and
        have the same sign are united first.
        """
        result: Body | None = None
        for sign, run in groupby(self.operands, itemgetter(0)):
            bodies = [body for _, body in run]
            result = difference(result, bodies) if sign == "-" and result else union([result, union(bodies)])
        assert result
        return result


def union(bodies: Iterable[Body | None]) -> Body | None:
    """Returns the union of bodies, or None if all are None. If bodies have a common face, the first of these bodies
    owns the face.

    A union of bodies that share no surface is one operation of manifold3d. Other bodies are divided into halves.
    """
    distinct = [body for body in bodies if body]
    if len(distinct) < 2:
        return distinct[0] if distinct else None
    if len(distinct) == 2 or not _share_surfaces(distinct):
        return _combined(distinct, OpType.Add)
    middle = len(distinct) // 2
    return union([union(distinct[:middle]), union(distinct[middle:])])


def difference(first: Body, others: Sequence[Body]) -> Body:
    """Returns the body ``first`` minus the bodies ``others``. If several of these bodies have a common face, the
    earliest of them owns the face.
    """
    near = [body for body in others if touch(body.box, first.box)]
    if _share_surfaces([first, *near]) and (body := union(near)):
        near = [body]
    return _combined([first, *near], OpType.Subtract) if near else first


def remainder(first: Body, second: Body) -> Body:
    """Returns the second body minus the first body. On surfaces that both bodies share, the faces of the result belong
    to the first body.
    """
    return _combined([first, second], None)


def _combined(bodies: Sequence[Body], operation: OpType | None) -> Body:
    """Returns the body that results from a Boolean operation on ``bodies``.

    If ``operation`` is None, the result is the second body minus the first body. Bodies may share surfaces only if
    there are two bodies. On the surfaces that two bodies share, the first body grows before a union and before the
    operation None, and shrinks before a subtraction or an intersection; see :meth:`.Planes.separate`.
    """
    solids, planes = [body.manifold() for body in bodies], bodies[0].planes
    if _share_surfaces(bodies) and touch(bodies[0].box, bodies[1].box):
        first, second = solids
        solids = planes.separate(first, second, -1 if operation in (OpType.Subtract, OpType.Intersect) else 1)
    # Without the check, manifold3d would join this operation and the next one, and change the order of their operands.
    result = checked(Manifold.batch_boolean(solids if operation else solids[::-1], operation or OpType.Subtract))
    box = np.reshape(result.bounding_box(), (2, 3)) + planes.thickness * np.array([[-1.0], [1.0]])
    return Body(lambda: result, box, frozenset().union(*(body.surfaces for body in bodies)), planes)


def _share_surfaces(bodies: Sequence[Body]) -> bool:
    """Whether any two of the bodies have faces on a common surface."""
    return sum(len(body.surfaces) for body in bodies) > len(frozenset().union(*(body.surfaces for body in bodies)))
