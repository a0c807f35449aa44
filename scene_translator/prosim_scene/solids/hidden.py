"""Operands of a chain of + and - that never show, as later ones cover them.

Of A + B - C + D a point belongs to the result if the last operand that it lies in is an added one. So an operand does
not matter if all of it lies in later ones. That is looked for in a grid of cells, and in ever finer ones where it has
not been decided: what touches no cell but such as lie within later operands is hidden.

Where thousands of solids overlap at one place, most of them are, and the meshes of those that are left need not be cut
by each of the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

LEVELS = 10  # of cells, each half as wide as those of the last
SOON = 4  # where nothing has been found by then, most likely nothing is hidden
PAIRS = 1 << 22  # of cells and operands, at most
CHILDREN = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)


@dataclass(frozen=True)
class Extent:
    """Where a solid lies: ``outer`` (2, 3) is a box around it, and ``inner`` (2, 3) one in it, min and max corner, in
    the space that ``to_local`` (3, 4) takes the world to.
    """

    to_local: np.ndarray
    outer: np.ndarray
    inner: np.ndarray


def within_boxes(low: np.ndarray, high: np.ndarray) -> Extent:
    """The extent of a solid in a box, of which no more is known."""
    return Extent(np.eye(3, 4), np.stack([low, high]), np.array([[np.inf] * 3, [-np.inf] * 3]))


def covered(extents: Sequence[Extent], margin: float) -> np.ndarray:
    """Which of some solids lie within later ones, by ``margin`` at least; not all such are found."""
    count = len(extents)
    linear = np.array([e.to_local[:, :3] for e in extents])
    offset = np.array([e.to_local[:, 3] for e in extents])
    outer, inner = np.array([e.outer for e in extents]), np.array([e.inner for e in extents])
    low, high = _around(linear, offset, outer)
    half = (high - low) / 2 + margin
    cell, solid = np.zeros(count, int), np.arange(count)
    place = np.einsum("nij,j->ni", linear, (low + high) / 2) + offset  # of a pair: its cell's centre, to the solid
    certain = np.zeros(count, bool)  # not covered, or not to be found out
    for level in range(LEVELS + 1):
        reach = np.einsum("nij,j->ni", np.abs(linear), half + margin)
        touching = _between(outer[:, 0] - reach, place, outer[:, 1] + reach, solid)
        cell, solid, place = cell[touching], solid[touching], place[touching]
        holding = _between(inner[:, 0] + reach, place, inner[:, 1] - reach, solid)
        last = np.full(int(cell.max()) + 1, -1)
        np.maximum.at(last, cell[holding], solid[holding])
        # The last one to lie in the middle of a cell matters there.
        center = _between(inner[:, 0], place, inner[:, 1], solid)
        top = np.full(len(last), -1)
        np.maximum.at(top, cell[center], solid[center])
        certain[top[top >= 0]] = True
        open_ = np.zeros(len(last), bool)
        chosen = solid >= last[cell]
        open_[cell[chosen & ~certain[solid]]] = True
        chosen &= open_[cell]
        cell, solid, place = cell[chosen], solid[chosen], place[chosen]
        if not len(cell) or level == LEVELS or 8 * len(cell) > PAIRS:
            break
        if level == SOON and (certain | np.isin(np.arange(count), solid)).all():
            break
        half = half / 2
        steps = np.einsum("nij,kj->nki", linear, CHILDREN * half)
        place = (place[:, None] + steps[solid]).reshape(-1, 3)
        cell = (8 * np.unique(cell, return_inverse=True)[1][:, None] + np.arange(8)).ravel()
        solid = np.repeat(solid, 8)
    certain[solid] = True
    return ~certain


def _between(low: np.ndarray, place: np.ndarray, high: np.ndarray, solid: np.ndarray) -> np.ndarray:
    """Which places (m, 3) lie between the bounds (n, 3) of their solids (m,)."""
    result = np.ones(len(solid), bool)
    for axis in range(3):
        result &= (low[solid, axis] <= place[:, axis]) & (place[:, axis] <= high[solid, axis])
    return result


def _around(linear: np.ndarray, offset: np.ndarray, boxes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A box in the world around ``boxes`` (n, 2, 3) of other spaces."""
    middle, half = boxes.mean(axis=1), (boxes[:, 1] - boxes[:, 0]) / 2
    inverse = np.linalg.inv(linear)
    center = np.einsum("nij,nj->ni", inverse, middle - offset)
    reach = np.einsum("nij,nj->ni", np.abs(inverse), half)
    return (center - reach).min(axis=0), (center + reach).max(axis=0)
