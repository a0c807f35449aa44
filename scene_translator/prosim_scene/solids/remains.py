"""What of a solid can be left in the result: balls that contain it, found from the tree alone."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..model import Leaf
from . import tree
from .grouping import alike
from .solid import Solid


class Ball(NamedTuple):
    """A ball in the world."""

    center: tuple[float, float, float]
    radius: float


EVERYWHERE = Ball((0.0, 0.0, 0.0), math.inf)


def remains(nodes: tree.Nodes, solids: Sequence[Solid], of_leaf: Sequence[int]) -> list[Ball]:
    """For each of the solids a ball, outside of which it does not matter to the result; EVERYWHERE, if none is known.

    ``of_leaf``: the solid of each leaf. What is taken away matters in what it is taken from, and each of two solids
    that are intersected in the other.
    """
    result = [EVERYWHERE] * len(solids)
    if all(node.symbol == "+" for node in nodes if not isinstance(node, Leaf)):
        return result
    balls_of = around(solids)
    leaves = np.zeros(len(nodes), int)
    leaves[[i for i, node in enumerate(nodes) if isinstance(node, Leaf)]] = of_leaf
    balls = [EVERYWHERE] * len(nodes)  # around the value of each node
    operands: list[tuple[int, int]] = [(0, 0)] * len(nodes)
    stack: list[int] = []
    for i in range(len(nodes) - 1, -1, -1):
        node = nodes[i]
        if isinstance(node, Leaf):
            balls[i] = balls_of[leaves[i]]
        else:
            a, b = operands[i] = stack.pop(), stack.pop()
            first, second = balls[a], balls[b]
            balls[i] = first if node.symbol == "-" else (joined if node.symbol == "+" else meeting)(first, second)
        stack.append(i)
    bounds = [EVERYWHERE] * len(nodes)
    for i, node in enumerate(nodes):
        if isinstance(node, Leaf):
            result[leaves[i]] = bounds[i] if result[leaves[i]] is EVERYWHERE else joined(result[leaves[i]], bounds[i])
        else:
            a, b = operands[i]
            bounds[a] = meeting(bounds[i], balls[b]) if node.symbol == "*" else bounds[i]
            bounds[b] = bounds[i] if node.symbol == "+" else meeting(bounds[i], balls[a])
    return result


def clipped(corners: np.ndarray, balls: Sequence[Ball]) -> np.ndarray:
    """The corners (n, 8, 3) of boxes, each moved into the box around a ball as far as it lies without."""
    center = np.array([ball.center for ball in balls])[:, None]
    radius = np.array([ball.radius for ball in balls])[:, None, None]
    return np.asarray(np.clip(corners, center - radius, center + radius))


def around(solids: Sequence[Solid]) -> list[Ball]:
    """Balls around solids at their places."""
    result = [EVERYWHERE] * len(solids)
    for primitive, numbers in alike(s.primitive for s in solids).items():
        places = np.array([solids[i].to_world for i in numbers])
        linear, offset = places[:, :3, :3], places[:, :3, 3]
        if primitive.curved is None:
            corners = primitive.box_corners @ linear.transpose(0, 2, 1)
            center = corners.mean(axis=1)
            radius = np.linalg.norm(corners - center[:, None], axis=2).max(axis=1)
        else:
            _, center, radius = primitive.ball(linear)
        for i, (x, y, z), r in zip(numbers, (center + offset).tolist(), radius.tolist()):
            result[i] = Ball((x, y, z), r)
    return result


def joined(a: Ball, b: Ball) -> Ball:
    """A ball around two."""
    apart = math.dist(a.center, b.center)
    small, large = sorted((a, b), key=lambda ball: ball.radius)
    if not apart + small.radius > large.radius:
        return large
    radius = (apart + a.radius + b.radius) / 2
    return Ball(_between(a, b, (radius - a.radius) / apart), radius)


def meeting(a: Ball, b: Ball) -> Ball:
    """A ball around what two have in common."""
    small = min(a, b, key=lambda ball: ball.radius)
    apart = math.dist(a.center, b.center)
    if max(a.radius, b.radius) == math.inf or apart**2 <= abs(a.radius**2 - b.radius**2):
        return small
    along = (apart + (a.radius - b.radius) * (a.radius + b.radius) / apart) / 2  # to the circle that they meet in
    return Ball(_between(a, b, along / apart), math.sqrt(max((a.radius - along) * (a.radius + along), 0.0)))


def _between(a: Ball, b: Ball, share: float) -> tuple[float, float, float]:
    x, y, z = (p + share * (q - p) for p, q in zip(a.center, b.center))
    return x, y, z
