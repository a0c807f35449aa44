"""Evaluates the CSG tree with manifold3d, whose meshes are lazy: they are computed on first access.

Each connected component of touching boxes is evaluated by itself, once for each medium. For a medium, leaves of other
media take part only if they cut. If two operands share surfaces, the first is perturbed before the operation, and the
result is relaxed after it, see :mod:`.coincidence`; manifold3d evaluates all other operations in batches. Long chains
of + and - are evaluated in halves: a step takes X to X - S + P with solids S and P, and two steps merge into one:

    (X - S + P) - S' + P' = X - (S + S') + ((P - S') + P').

So few operations have the whole result as an operand.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from typing import TypeVar

import numpy as np
from manifold3d import Error, Manifold, OpType

from ..model import Leaf, Operator
from .coincidence import Planes
from .grouping import sweep, touching

T = TypeVar("T")
#: A tree in prefix order: the symbols of its operators, and the numbers of its leaves.
Tree = Sequence[str | int]


def tree_of(nodes: Sequence[Operator | Leaf]) -> Tree:
    """A scene's tree; leaves are numbered in their order."""
    numbers = iter(range(len(nodes)))
    return [node.symbol if isinstance(node, Operator) else next(numbers) for node in nodes]


def fold(tree: Tree, leaf: Callable[[int], T], combine: Callable[[str, T, T], T]) -> T:
    """The value of a tree: ``leaf(number)`` of a leaf, ``combine(symbol, first, second)`` of an operator."""
    stack: list[T] = []
    for node in reversed(tree):
        stack.append(combine(node, stack.pop(), stack.pop()) if isinstance(node, str) else leaf(node))
    return stack.pop()


def cutters(tree: Tree, media_of: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Which leaves cut others (they are in a second operand of - or *), and which cut leaves of several media."""
    cut, cut_several = (np.zeros(len(media_of) + 1, int) for _ in range(2))

    def leaf(number: int) -> tuple[set[int], int, int]:
        return {media_of[number]}, number, number + 1

    def combine(
        symbol: str, first: tuple[set[int], int, int], second: tuple[set[int], int, int]
    ) -> tuple[set[int], int, int]:
        if symbol != "+":
            for ends in (cut, cut_several)[: len(first[0])]:
                ends[second[1]] += 1
                ends[second[2]] -= 1
        return first[0] | second[0] if symbol == "+" else first[0], first[1], second[2]

    fold(tree, leaf, combine)
    return cut.cumsum()[:-1] > 0, cut_several.cumsum()[:-1] > 0


def split(tree: Tree, groups: Sequence[int]) -> dict[int, Tree]:
    """The tree restricted to each group of leaves, by group; ``groups`` has the group of each leaf."""

    def leaf(number: int) -> dict[int, deque[str | int]]:
        return {groups[number]: deque([number])}

    def both(symbol: str, left: deque[str | int], right: deque[str | int]) -> deque[str | int]:
        if len(left) < len(right):
            right.extendleft(reversed(left))
            left = right
        else:
            left.extend(right)
        left.appendleft(symbol)
        return left

    def combine(
        symbol: str, left: dict[int, deque[str | int]], right: dict[int, deque[str | int]]
    ) -> dict[int, deque[str | int]]:
        small, large = sorted((left, right), key=len)
        common = {group: both(symbol, left[group], right[group]) for group in small if group in large}
        if symbol == "*":
            return common
        result = left
        if symbol == "+":
            result = large
            result.update(small)
        result.update(common)
        return result

    return dict(sorted(fold(tree, leaf, combine).items()))


MAX_SEQUENCE = 16  # steps of a chain that are evaluated one by one; a longer chain is evaluated in halves
MAX_CUTS = 64  # small solids that touch a mesh, per triangle; above it the mesh is refined
REFINED_CUTS = 32  # small solids per triangle of a refined mesh, approximately
SMALL = 8  # a solid is small if its volume is less than that of the other one by this factor
MIN_TRIANGLES = 4  # of a closed mesh


@dataclass(eq=False)
class Body:
    """A solid of one medium: its lazy mesh, the ``boxes`` (n, 2, 3) of its leaves (min and max corner), and the shared
    ``surfaces`` that its faces may lie on. Equal leaves have the same ``solid``.
    """

    manifold: Manifold
    boxes: np.ndarray
    surfaces: frozenset[int]
    planes: Planes
    solid: int | None = None

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Its bounding box, min and max corner."""
        return self.boxes[:, 0].min(axis=0), self.boxes[:, 1].max(axis=0)

    def touches(self, other: Body) -> bool:
        """Whether a leaf's box of ``other`` touches the bounding box of this body."""
        return len(touching(other.boxes[:, 0], other.boxes[:, 1], self.box)) > 0


def checked(manifold: Manifold) -> Manifold:
    """Computes and returns a lazy mesh. Raises ArithmeticError if that fails."""
    status = manifold.status()
    if status != Error.NoError:
        raise ArithmeticError(f"manifold3d: {status}")
    return manifold


def evaluate(tree: Tree, body: Callable[[int], Body | None]) -> Body | None:
    """The solid of a tree, or None if it is empty; ``body(number)`` is the solid of a leaf."""

    def leaf(number: int) -> _Chain | None:
        value = body(number)
        return _Chain(value) if value else None

    def combine(symbol: str, left: _Chain | None, right: _Chain | None) -> _Chain | None:
        if left and right:
            return left.combined(symbol, right)
        return {"+": left or right, "-": left, "*": None}[symbol]

    chain = fold(tree, leaf, combine)
    return chain.value() if chain else None


class _Chain:
    """A chain of + and -, or of *: operands with their signs. The sign of the first operand is ignored."""

    def __init__(self, first: Body) -> None:
        self.operands = deque([("+", first)])
        self.signs: set[str] = set()

    def combined(self, symbol: str, other: _Chain) -> _Chain:
        """The chain of this one, ``symbol`` and ``other``, flattened where A op (B op C) equals A op B op C."""
        flat_signs = {"*"} if symbol == "*" else {"+"}
        left = self if not self.signs or ("*" in self.signs) == (symbol == "*") else _Chain(self.value())
        right = other if other.signs <= flat_signs else _Chain(other.value())
        if len(left.operands) < len(right.operands) and left.signs | {symbol} == flat_signs:
            right.operands[0] = symbol, right.operands[0][1]
            right.operands.extendleft(reversed(left.operands))
            right.signs = flat_signs
            return right
        left.operands.extend((symbol, body) for _, body in right.operands)
        left.signs.add(symbol)
        return left

    def value(self) -> Body:
        """The chain evaluated from left to right."""
        if "*" not in self.signs:
            return _sum_chain(list(self.operands))
        bodies = [body for _, body in self.operands]
        return reduce(partial(combined, "*"), bodies)


#: A step of a chain: the body that it subtracts first, and the body that it adds then.
Step = tuple[Body | None, Body | None]


def _sum_chain(chain: list[tuple[str, Body]]) -> Body:
    """The value of a chain of + and -; the first operand is positive.

    Operands that do not touch commute. So each operand is moved to the earliest possible step: after the steps of all
    earlier operands that it touches, or in the same step if their signs are equal.
    """
    adds = np.array([sign == "+" for sign, _ in chain])
    boxes = np.array([body.box for _, body in chain])
    low, high = np.asfortranarray(boxes[:, 0]), np.asfortranarray(boxes[:, 1])
    step = np.zeros(len(chain), int)
    for i in range(1, len(chain)):
        near = touching(low[:i], high[:i], boxes[i])
        step[i] = (step[near] + (adds[near] & ~adds[i])).max(initial=0)
    taken: list[list[Body]] = [[] for _ in range(step.max() + 1)]
    added: list[list[Body]] = [[] for _ in taken]
    for (sign, body), number in zip(chain, step.tolist()):
        (added if sign == "+" else taken)[number].append(body)
    steps = [(union(bodies), union(others)) for bodies, others in zip(taken, added)]
    if len(steps) > MAX_SEQUENCE and _associative(chain, adds, low, high):
        result = merge_in_halves(steps)[1]
    else:
        result = reduce(lambda before, step: _merge((None, before), step)[1], steps, None)
    assert result
    return result


def merge_in_halves(steps: list[Step]) -> Step:
    """Merges a sequence of steps into one, by halves."""
    if len(steps) == 1:
        return steps[0]
    middle = len(steps) // 2
    return _merge(merge_in_halves(steps[:middle]), merge_in_halves(steps[middle:]))


def _merge(first: Step, second: Step) -> Step:
    """Merges two successive steps."""
    rest = combined("-", first[1], second[0]) if first[1] and second[0] else first[1]
    return union([first[0], second[0]]), union([rest, second[1]])


def _associative(chain: list[tuple[str, Body]], adds: np.ndarray, low: np.ndarray, high: np.ndarray) -> bool:
    """Whether a chain may be evaluated in halves: each face has the same owner as in evaluation from left to right.

    An operand may cover a face, and a later one with a face on the same surface may cut it open again. From left to
    right the later operand owns the face, in halves the first one. A face cannot be covered if no added operand extends
    beyond its surface.
    """
    bodies = [body for _, body in chain]
    for i in np.flatnonzero(~adds).tolist():
        near = touching(low, high, (low[i], high[i]))
        before = frozenset().union(*(bodies[j].surfaces for j in near[near < i].tolist()))
        added = near[adds[near]]
        if not all(bodies[i].planes.one_sided(s, low[added], high[added]) for s in before & bodies[i].surfaces):
            return False
    return True


def union(bodies: Iterable[Body | None]) -> Body | None:
    """The union of bodies, or None if there are none; the first body owns a common face."""
    solids: dict[int | None, Body] = {}
    distinct = [body for body in bodies if body and (body.solid is None or solids.setdefault(body.solid, body) is body)]
    if len(distinct) < 2:
        return distinct[0] if distinct else None
    surfaces = frozenset().union(*(body.surfaces for body in distinct))
    if len(surfaces) < sum(len(body.surfaces) for body in distinct):
        middle = len(distinct) // 2
        first, second = union(distinct[:middle]), union(distinct[middle:])
        assert first and second
        return combined("+", first, second)
    result = Manifold.batch_boolean(_refined(distinct), OpType.Add)
    return Body(result, np.concatenate([body.boxes for body in distinct]), surfaces, distinct[0].planes)


def combined(symbol: str, first: Body, second: Body) -> Body:
    """The union (+), difference (-) or intersection (*) of two bodies; the first one owns a common face."""
    if symbol == "-" and not first.touches(second):
        return first
    operation = {"+": OpType.Add, "-": OpType.Subtract, "*": OpType.Intersect}[symbol]
    boxes = np.concatenate([first.boxes, second.boxes]) if symbol == "+" else first.boxes
    return _operation(first, second, operation, 1 if symbol == "+" else -1, boxes)


def remainder(first: Body, second: Body) -> Body:
    """The second body minus the first one; the first one owns a common face."""
    return _operation(first, second, None, 1, second.boxes)


def _operation(first: Body, second: Body, operation: OpType | None, outwards: int, boxes: np.ndarray) -> Body:
    """The result of an operation on two bodies; None is the second body minus the first one.

    The first one is perturbed on common surfaces: outwards (1) or inwards (-1).
    """
    planes = first.planes
    common = first.surfaces & second.surfaces if first.touches(second) else frozenset()
    pair = [planes.perturb(_refined_for(first, second), common, outwards), _refined_for(second, first)]
    result = Manifold.batch_boolean(pair if operation else pair[::-1], operation or OpType.Subtract)
    if common and not checked(result).is_empty():
        result = planes.relax(result, common)
    return Body(result, boxes, first.surfaces | second.surfaces, planes)


def _refined(bodies: list[Body]) -> list[Manifold]:
    """The meshes of bodies; those that many smaller bodies touch are refined."""
    if len(bodies) <= MIN_TRIANGLES * MAX_CUTS:
        return [body.manifold for body in bodies]
    low, high = (np.array(ends) for ends in zip(*(body.box for body in bodies)))
    size = (high - low).prod(axis=1)
    others = np.zeros(len(bodies), int)
    for one, other in sweep(low, high):
        for large, small in ((one, other), (other, one)):
            np.add.at(others, large[size[small] < size[large] / SMALL], 1)
    return [_refined_mesh(body, count) for body, count in zip(bodies, others.tolist())]


def _refined_for(body: Body, other: Body) -> Manifold:
    """The mesh of a body, refined if many smaller leaves of another one touch it."""
    if len(other.boxes) <= MIN_TRIANGLES * MAX_CUTS:
        return body.manifold
    low, high = body.box
    boxes = other.boxes[touching(other.boxes[:, 0], other.boxes[:, 1], (low, high))]
    size = (boxes[:, 1] - boxes[:, 0]).prod(axis=1)
    return _refined_mesh(body, int((size < (high - low).prod() / SMALL).sum()))


def _refined_mesh(body: Body, others: int) -> Manifold:
    """The mesh of a body that ``others`` smaller bodies touch, refined if these are many, such as holes in a plate.

    manifold3d triangulates a cut triangle in a time that grows as the square of the number of cuts.
    """
    if others <= MIN_TRIANGLES * MAX_CUTS or others <= MAX_CUTS * body.manifold.num_tri():
        return body.manifold
    low, high = body.box
    _, middle, longest = sorted((high - low).tolist())
    return body.manifold.refine_to_length(
        max(math.sqrt(middle * longest * REFINED_CUTS / others), longest * REFINED_CUTS / others)
    )
