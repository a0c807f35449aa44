"""Evaluates the CSG tree with manifold3d, which computes a mesh only when its data are needed.

Each connected component of touching boxes is evaluated separately, once for each medium. In the evaluation of a medium,
a leaf of another medium is used only if it cuts. If two operands share surfaces, their facets on these surfaces are
separated before the operation (see :mod:`.coincidence`). manifold3d evaluates all other operations in batches. Chains
of the operators + and - are evaluated in halves. A step changes a solid X to X - S + P with solids S and P. Two steps
merge into one step:

    (X - S + P) - S' + P' = X - (S + S') + ((P - S') + P').

Therefore only few operations have the whole result as an operand.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TypeVar

import numpy as np
from manifold3d import Error, Manifold, OpType

from ..model import Leaf, Operator
from .coincidence import Planes
from .grouping import sweep, touching

T = TypeVar("T")
#: A CSG tree in prefix order: the symbols of its operators, and the numbers of its leaves.
Tree = Sequence[str | int]
#: An operand: its media, the number of its first leaf, and the number after its last leaf.
_Operand = tuple[frozenset[int], int, int]
OPERATIONS = {"+": OpType.Add, "-": OpType.Subtract, "*": OpType.Intersect}


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

    @property
    def box(self) -> np.ndarray:
        """The bounding box (2, 3) of the body: minimum and maximum corner."""
        return np.stack([self.boxes[:, 0].min(axis=0), self.boxes[:, 1].max(axis=0)])

    def touches(self, other: Body) -> bool:
        """Whether the box of a leaf of ``other`` touches the bounding box of this body."""
        return len(touching(other.boxes, self.box)) > 0


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
        """Applies an operator to the chains of two operands, separately for each group."""
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


#: A step of a chain: a body that is subtracted first, and a body that is added then.
Step = tuple[Body | None, Body | None]


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
            return _Chain(combined("*", self.value(), other.value()))
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
        if len(self.operands) == 1:
            return self.operands[0][1]
        adds = np.array([sign == "+" for sign, _ in self.operands])
        boxes = np.array([body.box for _, body in self.operands])
        step = np.zeros(len(adds), int)
        for i in range(1, len(adds) if self.has_minus else 0):
            earlier = touching(boxes[:i], boxes[i])
            step[i] = (step[earlier] + (adds[earlier] & ~adds[i])).max(initial=0)
        steps: list[tuple[list[Body], list[Body]]] = [([], []) for _ in range(step.max() + 1)]
        for (sign, body), number in zip(self.operands, step.tolist()):
            steps[number][sign == "+"].append(body)
        _, result = apply_steps(None, [(union(subtracted), union(added)) for subtracted, added in steps])
        assert result
        return result


def apply_steps(before: Body | None, steps: list[Step]) -> Step:
    """Applies a sequence of steps to a body; returns the union of all subtracted bodies, and the result."""
    if len(steps) == 1:
        ((subtracted, added),) = steps
        rest = combined("-", before, subtracted) if before and subtracted else before
        return subtracted, union([rest, added])
    if before and _mergeable(before, steps):
        return apply_steps(before, [apply_steps(None, steps)])
    middle = len(steps) // 2
    subtracted, rest = apply_steps(before, steps[:middle])
    also_subtracted, result = apply_steps(rest, steps[middle:])
    return union([subtracted, also_subtracted]), result


def _mergeable(before: Body, steps: list[Step]) -> bool:
    """Whether merged steps give each face the same owner as steps that are applied one after the other.

    An earlier step may cover a face of ``before`` or of a subtracted solid. A later step may subtract a solid that has
    a face on the same surface, and so uncover the covered face. If the steps are applied one after the other, the later
    solid owns the face; after merging, the earlier solid owns it. No face is covered if there is material on only one
    side of the surface.
    """
    surfaces, boxes = before.surfaces, before.boxes  # of faces, and of solids, in earlier steps
    for subtracted, added in steps:
        if subtracted:
            near = touching(boxes, subtracted.box)
            may_uncover = (near >= len(before.boxes)).any()
            if may_uncover and not before.planes.one_sided(surfaces & subtracted.surfaces, boxes[near]):
                return False
            surfaces = surfaces | subtracted.surfaces
        if added:
            boxes = np.concatenate([boxes, added.boxes])
    return True


MAX_BATCH = 500  # the largest number of bodies in one union; more bodies are united in two halves, which saves memory


def union(bodies: Iterable[Body | None]) -> Body | None:
    """Returns the union of bodies, or None if there are none. The first of the bodies owns a common face."""
    solids: dict[int | None, Body] = {}
    distinct = [body for body in bodies if body and (body.solid is None or solids.setdefault(body.solid, body) is body)]
    if len(distinct) < 2:
        return distinct[0] if distinct else None
    surfaces = frozenset().union(*(body.surfaces for body in distinct))

    @cache
    def manifold() -> Manifold:
        """Computes the union: in one batch if the bodies share no surfaces and are few, otherwise in two halves."""
        middle = len(distinct) // 2
        if len(distinct) <= MAX_BATCH and len(surfaces) == sum(len(body.surfaces) for body in distinct):
            result = Manifold.batch_boolean([body.manifold() for body in distinct], OpType.Add)
        else:
            first, second = union(distinct[:middle]), union(distinct[middle:])
            assert first and second
            result = checked(combined("+", first, second).manifold())
        distinct.clear()  # frees memory: this function outlives the operands
        return result

    return Body(manifold, np.concatenate([body.boxes for body in distinct]), surfaces, distinct[0].planes)


def combined(symbol: str, first: Body, second: Body) -> Body:
    """Returns the union (+), difference (-) or intersection (*) of two bodies; the first body owns a common face."""
    if symbol == "-" and not first.touches(second):
        return first
    boxes = np.concatenate([first.boxes, second.boxes]) if symbol == "+" else first.boxes
    return _operation(first, second, OPERATIONS[symbol], 1 if symbol == "+" else -1, boxes)


def remainder(first: Body, second: Body) -> Body:
    """Returns the second body minus the first body. On common surfaces, the faces of the result belong to the first
    body.
    """
    return _operation(first, second, None, 1, second.boxes)


def _operation(first: Body, second: Body, operation: OpType | None, outwards: int, boxes: np.ndarray) -> Body:
    """Returns the result of a Boolean operation on two bodies; the operation None is the second body minus the first
    body.

    ``boxes`` are the boxes of the result. On common surfaces, the first body grows (``outwards`` 1) or shrinks (-1)
    before the operation.
    """
    planes = first.planes
    pair = [first.manifold(), second.manifold()]
    if first.surfaces & second.surfaces and first.touches(second):
        pair = planes.separate(pair[0], pair[1], outwards)
    result = Manifold.batch_boolean(pair if operation else pair[::-1], operation or OpType.Subtract)
    return Body(lambda: result, boxes, first.surfaces | second.surfaces, planes)


MAX_NEIGHBOURS = 64  # a leaf's mesh is refined if more small solids than this touch it, per triangle
REFINED_NEIGHBOURS = 32  # the approximate number of small solids per triangle of a refined mesh
SMALL = 8  # a solid is small if its box has less than 1/8 of the volume of the other box
MIN_TRIANGLES = 4  # the smallest number of triangles of a closed mesh


def count_small_neighbours(boxes: np.ndarray) -> np.ndarray:
    """Returns, for each of the ``boxes`` (see :class:`Body`), how many small boxes touch it.

    The result is 0 for all boxes if there are too few boxes to refine a mesh.
    """
    result = np.zeros(len(boxes), int)
    if len(boxes) > MIN_TRIANGLES * MAX_NEIGHBOURS:
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
