"""The CSG tree, evaluated by manifold3d, whose meshes are lazy: they are computed when they are looked at.

The tree is evaluated for each group of leaves whose boxes are connected by touching, as other leaves change nothing
there, and for each medium: what cuts is then all of its operand, and of the rest the leaves of that medium are taken.
Where two operands have surfaces in common, the first is perturbed before the operation and the result relaxed after it,
see :mod:`.coincidence`; all other operations are left to manifold3d, which takes many at a time. Long chains of + and -
are evaluated in halves. Of a sequence that takes X to X - S + P, with solids S and P, two in succession are again one:

    (X - S + P) - S' + P' = X - (S + S') + ((P - S') + P').

So few operations meet the whole result.
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
    """A scene's tree; the *number* of a leaf is its place among the leaves."""
    numbers = iter(range(len(nodes)))
    return [node.symbol if isinstance(node, Operator) else next(numbers) for node in nodes]


def fold(tree: Tree, leaf: Callable[[int], T], combine: Callable[[str, T, T], T]) -> T:
    """The value of a tree: ``leaf(number)`` of a leaf, ``combine(symbol, first, second)`` of an operator."""
    stack: list[T] = []
    for node in reversed(tree):
        stack.append(combine(node, stack.pop(), stack.pop()) if isinstance(node, str) else leaf(node))
    return stack.pop()


def cutters(tree: Tree, media_of: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Which leaves cut others, being in the second operand of - or *; and which cut leaves of several media at once."""
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
    """The tree of each group of leaves alone, by the number of the group; ``groups`` are those of the leaves."""

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


DEEP = 16  # alternations of + and -, from which on a chain is evaluated in halves
CROWD = 64  # solids for each triangle of another one that they touch, from which on that is refined
FEW = 32  # solids for each triangle then, about
SMALL = 8  # a solid counts as small if its volume is less than that of the other one by this factor
LEAST = 4  # triangles of a closed mesh


@dataclass(eq=False)
class Body:
    """A solid of one medium: its lazy mesh, the ``boxes`` (n, 2, 3) of the leaves that it comes from (min and max
    corner), and the shared ``surfaces`` that its faces may lie on. ``solid`` is equal for leaves that are the same.
    """

    manifold: Manifold
    boxes: np.ndarray
    surfaces: frozenset[int]
    planes: Planes
    solid: int | None = None

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """A box around it, min and max corner."""
        return self.boxes[:, 0].min(axis=0), self.boxes[:, 1].max(axis=0)

    def touches(self, other: Body) -> bool:
        """Whether a box of the other's touches the box around this one."""
        return len(touching(other.boxes[:, 0], other.boxes[:, 1], self.box)) > 0


def checked(manifold: Manifold) -> Manifold:
    """A mesh that has been computed. Raises ArithmeticError where that fails."""
    status = manifold.status()
    if status != Error.NoError:
        raise ArithmeticError(f"manifold3d: {status}")
    return manifold


def evaluate(tree: Tree, body: Callable[[int], Body | None]) -> Body | None:
    """The value of a tree; ``body(number)`` is that of a leaf. None is empty."""

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
    """A growing chain of + and -, or of *: operands with their signs, the first of which does not matter."""

    def __init__(self, first: Body) -> None:
        self.operands = deque([("+", first)])
        self.signs: set[str] = set()

    def combined(self, symbol: str, other: _Chain) -> _Chain:
        """This chain and ``other`` as one, whose operands are taken as its own where A op (B op C) is A op B op C."""
        alike = {"*"} if symbol == "*" else {"+"}
        left = self if not self.signs or ("*" in self.signs) == (symbol == "*") else _Chain(self.value())
        right = other if other.signs <= alike else _Chain(other.value())
        if len(left.operands) < len(right.operands) and left.signs | {symbol} == alike:
            right.operands[0] = symbol, right.operands[0][1]
            right.operands.extendleft(reversed(left.operands))
            right.signs = alike
            return right
        left.operands.extend((symbol, body) for _, body in right.operands)
        left.signs.add(symbol)
        return left

    def value(self) -> Body:
        """The chain evaluated from left to right."""
        if "*" not in self.signs:
            return _sums(list(self.operands))
        bodies = [body for _, body in self.operands]
        return reduce(partial(combined, "*"), bodies)


#: The bodies that a step of a chain takes away, and those that it adds then.
Step = tuple[Body | None, Body | None]


def _sums(chain: list[tuple[str, Body]]) -> Body:
    """A chain of + and -, the first operand being positive.

    Operands that do not touch commute. So each joins the earliest step (which takes away first, and then adds) that
    comes after all earlier operands that it touches, but for those of its own sign.
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
    if len(steps) > DEEP and _associative(chain, adds, low, high):
        result = halves(steps)[1]
    else:
        result = reduce(lambda before, step: _both((None, before), step)[1], steps, None)
    assert result
    return result


def halves(steps: list[Step]) -> Step:
    """A sequence of steps as one, by halves."""
    if len(steps) == 1:
        return steps[0]
    middle = len(steps) // 2
    return _both(halves(steps[:middle]), halves(steps[middle:]))


def _both(first: Step, second: Step) -> Step:
    """Two steps as one."""
    rest = combined("-", first[1], second[0]) if first[1] and second[0] else first[1]
    return union([first[0], second[0]]), union([rest, second[1]])


def _associative(chain: list[tuple[str, Body]], adds: np.ndarray, low: np.ndarray, high: np.ndarray) -> bool:
    """Whether a chain may be evaluated in halves: every face goes to the operand that it goes to from left to right.

    A later operand may cover a face, and one still later that has a face on the same surface lay it bare again. The
    face is the latter's from left to right, but the first one's in halves. It cannot be covered if nothing that is
    added reaches beyond the surface.
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
    """The union of bodies; of a common face that of the first one in their order is left. None where there are none."""
    solids: dict[int | None, Body] = {}
    some = [body for body in bodies if body and (body.solid is None or solids.setdefault(body.solid, body) is body)]
    if len(some) < 2:
        return some[0] if some else None
    surfaces = frozenset().union(*(body.surfaces for body in some))
    if len(surfaces) < sum(len(body.surfaces) for body in some):
        middle = len(some) // 2
        first, second = union(some[:middle]), union(some[middle:])
        assert first and second
        return combined("+", first, second)
    result = Manifold.batch_boolean(_refined(some), OpType.Add)
    return Body(result, np.concatenate([body.boxes for body in some]), surfaces, some[0].planes)


def combined(symbol: str, first: Body, second: Body) -> Body:
    """The union (+), difference (-) or intersection (*) of two bodies; a common face is the first one's."""
    if symbol == "-" and not first.touches(second):
        return first
    operation = {"+": OpType.Add, "-": OpType.Subtract, "*": OpType.Intersect}[symbol]
    boxes = np.concatenate([first.boxes, second.boxes]) if symbol == "+" else first.boxes
    return _operation(first, second, operation, 1 if symbol == "+" else -1, boxes)


def beneath(first: Body, second: Body) -> Body:
    """The second body less the first one; a common face is the first one's."""
    return _operation(first, second, None, 1, second.boxes)


def _operation(first: Body, second: Body, operation: OpType | None, outwards: int, boxes: np.ndarray) -> Body:
    """The result of an operation on two bodies, None for the second one less the first one. The first one is moved
    ``outwards`` (1 or -1) on the surfaces that they have in common.
    """
    planes = first.planes
    common = first.surfaces & second.surfaces if first.touches(second) else frozenset()
    pair = [planes.perturb(_crowded(first, second), common, outwards), _crowded(second, first)]
    result = Manifold.batch_boolean(pair if operation else pair[::-1], operation or OpType.Subtract)
    if common and not checked(result).is_empty():
        result = planes.relax(result, common)
    return Body(result, boxes, first.surfaces | second.surfaces, planes)


def _refined(bodies: list[Body]) -> list[Manifold]:
    """The meshes of bodies, those of which are refined that a crowd of others touches."""
    if len(bodies) <= LEAST * CROWD:
        return [body.manifold for body in bodies]
    low, high = (np.array(ends) for ends in zip(*(body.box for body in bodies)))
    size = (high - low).prod(axis=1)
    others = np.zeros(len(bodies), int)
    for one, other in sweep(low, high):
        for large, small in ((one, other), (other, one)):
            np.add.at(others, large[size[small] < size[large] / SMALL], 1)
    return [_divided(body, count) for body, count in zip(bodies, others.tolist())]


def _crowded(body: Body, other: Body) -> Manifold:
    """The mesh of a body, refined if a crowd of leaves of another one touches it."""
    if len(other.boxes) <= LEAST * CROWD:
        return body.manifold
    low, high = body.box
    boxes = other.boxes[touching(other.boxes[:, 0], other.boxes[:, 1], (low, high))]
    size = (boxes[:, 1] - boxes[:, 0]).prod(axis=1)
    return _divided(body, int((size < (high - low).prod() / SMALL).sum()))


def _divided(body: Body, others: int) -> Manifold:
    """The mesh of a body that ``others`` smaller ones touch, refined if these are many for its triangles, such as holes
    in the face of a plate.

    manifold3d gives the rest of a triangle new triangles in a time that grows as the square of what has cut it.
    """
    if others <= LEAST * CROWD or others <= CROWD * body.manifold.num_tri():
        return body.manifold
    low, high = body.box
    _, middle, longest = sorted((high - low).tolist())
    return body.manifold.refine_to_length(max(math.sqrt(middle * longest * FEW / others), longest * FEW / others))
