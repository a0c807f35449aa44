"""Parts of an image: the pixels that one of several processes renders, without communication between the processes."""

from __future__ import annotations

from dataclasses import dataclass
from math import gcd

import numpy as np

from .plan import Rectangle, area

#: Minimum side of a tile in pixels; maximum side of a tile, as a multiple of the margin whose samples are used;
#: minimum number of tiles of a part. A part also takes the first samples of the pixels around its tiles: large tiles
#: have fewer of these pixels, small tiles divide the work more equally.
SMALLEST, LARGEST, TILES = 8, 12, 16

#: Shift of the owners from one row of tiles to the next, as a fraction of the number of parts. With the golden ratio,
#: no part gets whole columns or diagonals.
SHIFT = 0.6180339887


@dataclass(frozen=True)
class Part:
    """One of several parts of an image: part ``number``, counted from 1, of ``of`` parts."""

    number: int
    of: int

    def __post_init__(self) -> None:
        if not 1 <= self.number <= self.of:
            raise ValueError(f"part {self.number} of {self.of}: parts are counted from 1 to their number")

    def __str__(self) -> str:
        return f"{self.number}-of-{self.of}"


def part_numbers(region: Rectangle, parts: int, margin: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Returns the number of the part that owns each pixel (x, y) of ``region``; x and y are integer arrays.

    Tiles are assigned to the ``parts`` in turn. The size of a tile depends on ``margin``, the width in pixels of the
    neighbourhood that the adaptive-sampling policy uses. A process also samples this margin around its tiles, so a wide
    margin needs large tiles. If ``margin`` is 0, the tiles have the smallest size, which balances the work best.
    """
    left, top, right, bottom = region
    side = max(min(int((area(region) / (TILES * parts)) ** 0.5), LARGEST * margin), SMALLEST)
    columns, rows = max(1, (right - left) // side), max(1, (bottom - top) // side)
    column, row = (x - left) * columns // (right - left), (y - top) * rows // (bottom - top)
    # From row to row, the owners shift by the number coprime to ``parts`` that is nearest to SHIFT * parts. Because the
    # numbers are coprime, the tiles of a column belong to all parts in turn.
    coprime = (shift for shift in range(1, parts + 1) if gcd(shift, parts) == 1)
    return (column + row * min(coprime, key=lambda shift: abs(shift - SHIFT * parts))) % parts + 1
