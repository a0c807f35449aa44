"""The CSG tree evaluated.

How it stays fast: chains of + and - and chains of * become n-ary operations; operands of a chain whose boxes do not touch
are exchanged freely, so that a long chain of additions and subtractions takes few operations on the whole.

A value maps each medium to its parts: {medium: [Part]}. Media are what solids are made of as far as optics are concerned,
see :mod:`.media`.
"""

from collections import deque
from collections.abc import Callable, Hashable

import numpy as np

from ..model import Leaf
from . import tree
from .parts import Part, boxes, difference, intersection, union

Value = dict[Hashable, list[Part]]


def _total(value):
    """All media of a value as one solid."""
    return next(iter(value.values())) if len(value) == 1 else union(value.values())


def _union(values):
    media = {}
    for value in values:
        for medium, parts in value.items():
            media.setdefault(medium, []).append(parts)
    return {medium: union(parts) for medium, parts in media.items()}


def _difference(minuend, subtrahends):
    if not subtrahends:
        return minuend
    subtrahend = union([_total(value) for value in subtrahends])
    return {medium: difference(parts, subtrahend) for medium, parts in minuend.items()}


class _Sum:
    """A chain of + and -, still growing: signed operands, the first one positive."""

    def __init__(self, first):
        self.operands = deque([("+", first)])
        self.adds_only = True

    def add(self, sign, other):
        """Appends ``other``, by its operands where it is a chain of + alone: A - (B + C) = A - B - C."""
        if isinstance(other, _Sum) and other.adds_only:
            if sign == "+" and len(self.operands) < len(other.operands) and self.adds_only:
                other.operands.extendleft(reversed(self.operands))
                return other
            self.operands.extend((sign, value) for _, value in other.operands)
        else:
            self.operands.append((sign, _value(other)))
        self.adds_only &= sign == "+"
        return self

    def value(self):
        """Works through the chain in rounds, each of which first takes away and then adds.

        An operand joins the earliest round that comes after all earlier operands that it touches and does not commute
        with; so the number of rounds is that of the additions and subtractions that alternate at one place.
        """
        if self.adds_only:
            return _union([value for _, value in self.operands])
        ends = [boxes([p for parts in value.values() for p in parts]) for _, value in self.operands]
        low = np.array([b.min(axis=0, initial=np.inf) for b, _ in ends])
        high = np.array([b.max(axis=0, initial=-np.inf) for _, b in ends])
        sign = np.array([s == "+" for s, _ in self.operands])
        round_ = np.zeros(len(sign), int)
        for i in range(1, len(sign)):
            touching = np.all((low[:i] <= high[i]) & (high[:i] >= low[i]), axis=1)
            round_[i] = (round_[:i] + (sign[:i] & ~sign[i]))[touching].max(initial=0)
        result = {}
        for r in range(round_.max() + 1):
            chosen = [self.operands[i] for i in np.flatnonzero(round_ == r)]
            result = _difference(result, [value for s, value in chosen if s == "-"])
            result = _union([result, *(value for s, value in chosen if s == "+")])
        return result


class _Product:
    """A chain of *, still growing."""

    def __init__(self, first):
        self.operands = deque([first])

    def add(self, other):
        if isinstance(other, _Product):
            if len(self.operands) < len(other.operands):
                other.operands.extendleft(reversed(self.operands))
                return other
            self.operands.extend(other.operands)
        else:
            self.operands.append(_value(other))
        return self

    def value(self):
        result, *rest = self.operands
        for value in rest:
            total = _total(value)
            result = {medium: intersection(parts, total) for medium, parts in result.items()}
        return result


def _value(item):
    return item.value() if isinstance(item, (_Sum, _Product)) else item


def evaluate(nodes: tree.Nodes, leaf_value: Callable[[int, Leaf], Value]) -> Value:
    """The value of a tree; ``leaf_value(number, leaf)`` makes a leaf's."""
    def combine(symbol, left, right):
        if symbol == "*":
            return (left if isinstance(left, _Product) else _Product(_value(left))).add(right)
        return (left if isinstance(left, _Sum) else _Sum(_value(left))).add(symbol, right)

    return _value(tree.fold(nodes, leaf_value, combine))
