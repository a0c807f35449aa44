"""A part of an image: pixels that one of several processes renders, none of which knows of the others."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import gcd

import numpy as np

from .plan import Rectangle, area

#: Minimum side of a tile in pixels; maximum side over the margin that decisions look at; and minimum number of tiles of
#: a part. A part also takes the first samples of the margin: large tiles have less margin, small ones cost about the
#: same.
SMALLEST, LARGEST, TILES = 8, 12, 16

#: The shift of the owners from one row of tiles to the next, as a fraction of their number: by the golden section no
#: part gets whole columns or diagonals.
SHIFT = 0.6180339887


@dataclass(frozen=True)
class Part:
    """Part ``number``, from 1, of ``of`` parts of an image."""

    number: int
    of: int

    def __post_init__(self) -> None:
        if not 1 <= self.number <= self.of:
            raise ValueError(f"part {self.number} of {self.of}: parts are counted from 1 to their number")

    def __str__(self) -> str:
        return f"{self.number}-of-{self.of}"


@dataclass(frozen=True)
class Tiles:
    """The pixels of ``region``, cut into columns and rows of tiles that are distributed over ``parts`` in turn."""

    region: Rectangle
    columns: int
    rows: int
    parts: int

    @classmethod
    def of(cls, region: Rectangle, parts: int, margin: int) -> Tiles:
        """As equal as may be where decisions look at ``margin`` pixels around each: where they look at none, the
        smallest tiles cost nothing.
        """
        side = max(min(int((area(region) / (TILES * parts)) ** 0.5), LARGEST * margin), SMALLEST)
        width, height = region[2] - region[0], region[3] - region[1]
        return cls(region, max(1, width // side), max(1, height // side), parts)

    def owned(self, part: Part, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Which of the pixels (x, y) of the region, integer arrays, are those of ``part``."""
        left, top, right, bottom = self.region
        column, row = (x - left) * self.columns // (right - left), (y - top) * self.rows // (bottom - top)
        return (column + row * self.shift) % self.parts == part.number - 1

    @cached_property
    def shift(self) -> int:
        """The shift of the owners from one row to the next; it is coprime, so that every owner has tiles in every
        column.
        """
        coprime = (shift for shift in range(1, self.parts + 1) if gcd(shift, self.parts) == 1)
        return min(coprime, key=lambda shift: abs(shift - SHIFT * self.parts))

    def near(self, part: Part, x: np.ndarray, y: np.ndarray, reach: int) -> np.ndarray:
        """Which of the pixels (x, y), all within ``reach`` of the region, are within ``reach`` of one of ``part``;
        ``reach``: at most the side of a tile.
        """
        left, top, right, bottom = self.region
        result = np.zeros(np.broadcast_shapes(x.shape, y.shape), bool)
        for px in (np.clip(x + step, left, right - 1) for step in (-reach, 0, reach)):
            for py in (np.clip(y + step, top, bottom - 1) for step in (-reach, 0, reach)):
                result |= self.owned(part, px, py)
        return result
