"""Divides an image into parts, so that several processes can each render one part without communication."""

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
    """One of the ``of`` parts of an image; ``number``, from 1 to ``of``, is the number of this part."""

    number: int
    of: int

    def __post_init__(self) -> None:
        if not 1 <= self.number <= self.of:
            raise ValueError(f"part {self.number} of {self.of} does not exist; give a number from 1 to {self.of}")

    def __str__(self) -> str:
        return f"{self.number}-of-{self.of}"


def part_numbers(region: Rectangle, parts: int, margin: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Returns, for each pixel (x, y) of ``region``, the number of the part of the image that contains the pixel, from 1
    to ``parts``.

    x and y are integer arrays. The tiles of the image are assigned in turn to the parts; ``parts`` is the number of
    parts. The size of a tile depends on ``margin``, the width in pixels of the neighbourhood that the adaptive-sampling
    policy uses. The process that renders a part also takes samples in a margin around each of its tiles, so the tiles
    are larger for a wider margin. If ``margin`` is 0, the tiles have the smallest size, which balances the work best.
    """
    left, top, right, bottom = region
    side = max(min(int((area(region) / (TILES * parts)) ** 0.5), LARGEST * margin), SMALLEST)
    columns, rows = max(1, (right - left) // side), max(1, (bottom - top) // side)
    column, row = (x - left) * columns // (right - left), (y - top) * rows // (bottom - top)
    # From row to row, the owners shift by the number coprime to ``parts`` that is nearest to SHIFT * parts. Because the
    # numbers are coprime, the tiles of a column belong to all parts in turn.
    coprime = (shift for shift in range(1, parts + 1) if gcd(shift, parts) == 1)
    return (column + row * min(coprime, key=lambda shift: abs(shift - SHIFT * parts))) % parts + 1
