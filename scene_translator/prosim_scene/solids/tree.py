"""The CSG tree as the prefix list of :attr:`prosim_scene.model.Scene.csg`, walked without recursion at any depth."""

from collections.abc import Callable, Sequence
from typing import TypeVar

from ..model import Leaf, Operator

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
