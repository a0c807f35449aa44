"""The CSG tree, evaluated by manifold3d, whose meshes are lazy: they are computed when they are looked at.

The tree is evaluated for each group of leaves whose boxes are connected by touching; other leaves change nothing there.
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
from typing import TypeVar

import numpy as np
from manifold3d import Error, Manifold, OpType

from ..model import Leaf, Operator
from .coincidence import Planes
from .grouping import sweep, touching

T = TypeVar("T")
Nodes = Sequence[Operator | Leaf]


def leaves(nodes: Nodes) -> list[Leaf]:
    """The leaves in the order of the tree; a leaf's *number* is its place in this list."""
    return [node for node in nodes if isinstance(node, Leaf)]


def fold(nodes: Nodes, leaf: Callable[[int, Leaf], T], combine: Callable[[str, T, T], T]) -> T:
    """The value of a tree: ``leaf(number, leaf)`` of a leaf, ``combine(symbol, first, second)`` of an operator."""
    stack: list[T] = []
    number = sum(isinstance(node, Leaf) for node in nodes)
    for node in reversed(nodes):
        if isinstance(node, Leaf):
            number -= 1
            stack.append(leaf(number, node))
        else:
            stack.append(combine(node.symbol, stack.pop(), stack.pop()))
    return stack.pop()


DEEP = 16  # alternations of + and -, from which on a chain is evaluated in halves
CROWD = 64  # solids for each triangle of another one that they touch, from which on that is refined
FEW = 32  # solids for each triangle then, about
SMALL = 8  # is a solid that has so many times less volume than the other one
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


#: A solid of several media, by the number of the medium.
Value = dict[int, Body]


def checked(manifold: Manifold) -> Manifold:
    """A mesh that has been computed. Raises ArithmeticError where that fails."""
    status = manifold.status()
    if status != Error.NoError:
        raise ArithmeticError(f"manifold3d: {status}")
    return manifold


def evaluate(nodes: Nodes, groups: Sequence[int], value: Callable[[int], Value]) -> dict[int, Value]:
    """The value of a tree for each group of leaves alone, by the number of the group.

    ``groups`` are those of the leaves; ``value(number)`` returns the value of a leaf.
    """

    def leaf(number: int, _: Leaf) -> dict[int, _Chain]:
        return {groups[number]: _Chain(value(number))}

    def combine(symbol: str, left: dict[int, _Chain], right: dict[int, _Chain]) -> dict[int, _Chain]:
        small, large = sorted((left, right), key=len)
        both = [(group, left[group].combined(symbol, right[group])) for group in small if group in large]
        if symbol == "*":
            return dict(both)
        result = left
        if symbol == "+":
            result = large
            result.update(small)
        result.update(both)
        return result

    return {group: chain.value() for group, chain in sorted(fold(nodes, leaf, combine).items())}


class _Chain:
    """A growing chain of + and -, or of *: operands with their signs, the first of which does not matter."""

    def __init__(self, first: Value) -> None:
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
        left.operands.extend((symbol, value) for _, value in right.operands)
        left.signs.add(symbol)
        return left

    def value(self) -> Value:
        """The chain evaluated from left to right."""
        (_, result), *rest = self.operands
        if "*" not in self.signs:
            return _sums(list(self.operands)) if rest else result
        for _, value in rest:
            solid = union(value.values())
            result = {m: combined("*", body, solid) for m, body in result.items()} if solid else {}
        return result


def _sums(operands: list[tuple[str, Value]]) -> Value:
    """A chain of + and -, the first operand being positive.

    Operands that do not touch commute. So each joins the earliest step (which takes away first, and then adds) that
    comes after all earlier operands that it touches, but for those of its own sign.
    """
    chain = [operand for operand in operands if operand[1]]
    adds = np.array([sign == "+" for sign, _ in chain])
    boxes = np.array([_around(value.values()) for _, value in chain]).reshape(-1, 2, 3)
    low, high = np.asfortranarray(boxes[:, 0]), np.asfortranarray(boxes[:, 1])
    step = np.zeros(len(chain), int)
    for i in range(len(chain)):
        near = touching(low[:i], high[:i], boxes[i])
        step[i] = (step[near] + (adds[near] & ~adds[i])).max(initial=0)
    taken: list[list[Body]] = [[] for _ in range(step.max(initial=0) + 1)]
    added: list[list[Value]] = [[] for _ in taken]
    for (sign, value), number in zip(chain, step.tolist()):
        if sign == "+":
            added[number].append(value)
        else:
            taken[number] += value.values()
    steps = [(union(bodies), _united(values)) for bodies, values in zip(taken, added)]
    if len(steps) > DEEP and _associative(chain, adds, low, high):
        return halves(steps, True)[1]
    result: Value = {}
    for solid, value in steps:
        result = _united([_without(result, solid), value])
    return result


def halves(steps: list[tuple[Body | None, Value]], begins: bool) -> tuple[Body | None, Value]:
    """S and P of a sequence of such; of one that ``begins`` the chain S does not matter, and is None."""
    if len(steps) == 1:
        return steps[0]
    middle = len(steps) // 2
    taken, added = halves(steps[:middle], begins)
    taken_later, added_later = halves(steps[middle:], False)
    solid = None if begins else union(body for body in (taken, taken_later) if body)
    return solid, _united([_without(added, taken_later), added_later])


def _associative(chain: list[tuple[str, Value]], adds: np.ndarray, low: np.ndarray, high: np.ndarray) -> bool:
    """Whether a chain may be evaluated in halves: every face goes to the operand that it goes to from left to right.

    A later operand may cover a face, and one still later that has a face on the same surface lay it bare again. The
    face is the latter's from left to right, but the first one's in halves. It cannot be covered if nothing that is
    added reaches beyond the surface.
    """
    surfaces = [frozenset().union(*(body.surfaces for body in value.values())) for _, value in chain]
    for i in np.flatnonzero(~adds).tolist():
        if not surfaces[i]:
            continue
        near = touching(low, high, (low[i], high[i]))
        before = [surfaces[j] & surfaces[i] for j in near[near < i].tolist()]
        added = near[adds[near]]
        planes = next(iter(chain[i][1].values())).planes
        if not all(planes.one_sided(s, low[added], high[added]) for s in frozenset().union(*before)):
            return False
    return True


def _around(bodies: Iterable[Body]) -> tuple[np.ndarray, np.ndarray]:
    """A box around bodies."""
    low, high = zip(*(body.box for body in bodies))
    return np.min(low, axis=0), np.max(high, axis=0)


def _united(values: Iterable[Value]) -> Value:
    """The union of values, medium by medium."""
    media: dict[int, list[Body]] = {}
    for value in values:
        for medium, body in value.items():
            media.setdefault(medium, []).append(body)
    return {medium: whole for medium, bodies in media.items() if (whole := union(bodies))}


def _without(value: Value, solid: Body | None) -> Value:
    """A value less a solid."""
    return {m: combined("-", body, solid) if solid else body for m, body in value.items()}


def union(bodies: Iterable[Body]) -> Body | None:
    """The union of bodies; of a common face that of the first one in their order is left. None where there are none."""
    solids: dict[int, Body] = {}
    bodies = [body for body in bodies if body.solid is None or solids.setdefault(body.solid, body) is body]
    if len(bodies) < 2:
        return bodies[0] if bodies else None
    surfaces = frozenset().union(*(body.surfaces for body in bodies))
    if len(surfaces) < sum(len(body.surfaces) for body in bodies):
        middle = len(bodies) // 2
        first, second = union(bodies[:middle]), union(bodies[middle:])
        assert first and second
        return combined("+", first, second)
    result = Manifold.batch_boolean(_refined(bodies), OpType.Add)
    return Body(result, np.concatenate([body.boxes for body in bodies]), surfaces, bodies[0].planes)


def combined(symbol: str, first: Body, second: Body) -> Body:
    """The union (+), difference (-) or intersection (*) of two bodies; a common face is the first one's."""
    if symbol == "-" and not first.touches(second):
        return first
    operation = {"+": OpType.Add, "-": OpType.Subtract, "*": OpType.Intersect}[symbol]
    boxes = np.concatenate([first.boxes, second.boxes]) if symbol == "+" else first.boxes
    return _operation(first, second, lambda a, b: ([a, b], operation), 1 if symbol == "+" else -1, boxes)


def beneath(first: Body, second: Body) -> Body:
    """The second body less the first one; a common face is the first one's."""
    return _operation(first, second, lambda a, b: ([b, a], OpType.Subtract), 1, second.boxes)


def _operation(
    first: Body,
    second: Body,
    arranged: Callable[[Manifold, Manifold], tuple[list[Manifold], OpType]],
    outwards: int,
    boxes: np.ndarray,
) -> Body:
    """The result of an operation on two bodies, the first of which is moved ``outwards`` (1 or -1) on the surfaces that
    they have in common.
    """
    planes = first.planes
    common = first.surfaces & second.surfaces if first.touches(second) else frozenset()
    mesh = planes.perturb(_crowded(first, second), common, outwards)
    result = Manifold.batch_boolean(*arranged(mesh, _crowded(second, first)))
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
    """The mesh of a body that so many smaller ones touch. Where they are a crowd for its triangles, as holes are in the
    face of a plate, it has more of them.

    manifold3d gives the rest of a triangle new triangles in a time that grows as the square of what has cut it.
    """
    if others <= LEAST * CROWD or others <= CROWD * body.manifold.num_tri():
        return body.manifold
    low, high = body.box
    _, middle, longest = sorted((high - low).tolist())
    return body.manifold.refine_to_length(max(math.sqrt(middle * longest * FEW / others), longest * FEW / others))
