"""A part of an image: pixels that one of several processes renders, none of which knows of the others."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import gcd

import numpy as np

from .plan import Rectangle, area

#: Pixels of the side of a tile, at least; and at most, for each pixel around that decisions look at. A part also takes
#: the first samples of these: large tiles have less around them, small ones are more alike. So many tiles each part
#: should have at least.
SMALLEST, LARGEST, TILES = 8, 12, 16

#: The part of all owners by which they move on from one row to the next, about: the golden section, by which no part
#: gets columns or diagonals of its own.
SHIFT = 0.6180339887


@dataclass(frozen=True)
class Part:
    """Part ``number``, from 1, of ``of``: every so-manieth tile of the image."""

    number: int
    of: int

    def __post_init__(self) -> None:
        if not 1 <= self.number <= self.of:
            raise ValueError(f"part {self.number} of {self.of}: parts are counted from 1 to their number")

    def __str__(self) -> str:
        return f"{self.number}-of-{self.of}"


@dataclass(frozen=True)
class Tiles:
    """The pixels of ``region``, cut into columns and rows of tiles that are dealt out to so many parts in turn."""

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
        """By how many owners these move on from one row to the next; each comes to each column in the end."""
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
