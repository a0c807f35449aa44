"""The CSG tree evaluated.

How it stays fast: chains of + and - and chains of * become n-ary operations; operands of a chain whose boxes do not
touch are exchanged freely, so that a long chain of additions and subtractions takes few operations on the whole, see
:mod:`.chains`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from ..model import Leaf
from . import chains, tree
from .values import Value, total, united, within


def evaluate(nodes: tree.Nodes, leaf_value: Callable[[int, Leaf], Value]) -> Value:
    """The value of a tree; ``leaf_value(number, leaf)`` makes a leaf's."""

    def combine(symbol: str, left: _Term, right: _Term) -> _Term:
        if symbol == "*":
            return (left if isinstance(left, _Product) else _Product(_value(left))).add(right)
        return (left if isinstance(left, _Sum) else _Sum(_value(left))).add(symbol, right)

    def leaf(number: int, leaf: Leaf) -> _Term:
        return leaf_value(number, leaf)

    return _value(tree.fold(nodes, leaf, combine))


class _Sum:
    """A chain of + and -, still growing: signed operands, the first one positive."""

    def __init__(self, first: Value) -> None:
        self.operands = deque([("+", first)])
        self.adds_only = True

    def add(self, sign: str, other: _Term) -> _Sum:
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

    def value(self) -> Value:
        return united(value for _, value in self.operands) if self.adds_only else chains.evaluate(self.operands)


class _Product:
    """A chain of *, still growing."""

    def __init__(self, first: Value) -> None:
        self.operands = deque([first])

    def add(self, other: _Term) -> _Product:
        """Appends ``other``, by its operands where it is a chain of *."""
        if isinstance(other, _Product):
            if len(self.operands) < len(other.operands):
                other.operands.extendleft(reversed(self.operands))
                return other
            self.operands.extend(other.operands)
        else:
            self.operands.append(_value(other))
        return self

    def value(self) -> Value:
        """What all operands have in common, in the first one's media."""
        result, *rest = self.operands
        for value in rest:
            result = within(result, total(value))
        return result


_Term = Value | _Sum | _Product


def _value(item: _Term) -> Value:
    return item.value() if isinstance(item, _Sum | _Product) else item
