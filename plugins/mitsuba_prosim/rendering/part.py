"""A part of an image: pixels that one of several processes renders, none of which knows of the others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from .plan import Rectangle, area

#: Pixels of the side of a tile, at least and at most, and about how many tiles a part has in between. A part also takes
#: the first samples of the pixels around its tiles, as far as its decisions look: large tiles have less around them,
#: small ones are more alike.
SMALLEST, LARGEST, TILES = 8, 128, 16

#: The part of a row of tiles by which the owners move on from one row to the next: the golden section, by which no part
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

    def owns(self, region: Rectangle, x: Any, y: Any) -> Any:
        """Which of the pixels (x, y) of ``region``, integer arrays of Dr.Jit or NumPy, are this part's."""
        side = min(max(int((area(region) / (TILES * self.of)) ** 0.5), SMALLEST), LARGEST)
        column, row = (x - region[0]) // side, (y - region[1]) // side
        return (column + row * round(SHIFT * self.of)) % self.of == self.number - 1

    def near(self, region: Rectangle, x: mi.Int32, y: mi.Int32, reach: int) -> mi.Bool:
        """Which of the pixels (x, y), all within ``reach`` of ``region``, are so near to one of this part's; ``reach``:
        at most the side of a tile.
        """
        xs = [dr.clip(x + step, region[0], region[2] - 1) for step in (-reach, 0, reach)]
        ys = [dr.clip(y + step, region[1], region[3] - 1) for step in (-reach, 0, reach)]
        result = mi.Bool(False)
        for px in xs:
            for py in ys:
                result |= self.owns(region, px, py)
        return result
