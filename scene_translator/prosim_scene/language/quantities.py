"""What follows a word: how many numbers, and in which range they are; or TRUE and FALSE."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

#: Lengths go from 1 / LARGE to LARGE: their squares have to be numbers of single precision, which is Mitsuba's.
LARGE = 1e15


@dataclass(frozen=True)
class Numbers:
    """The numbers that follow a word: how many, what they are called in messages, and where they lie."""

    count: int = 1
    what: str = ""
    low: float = 0
    high: float = 1
    whole: bool = False
    channels: bool = False  #: r g b, or one for all channels
    direction: bool = False  #: a vector that may not have length 0
    least: float = 0  #: smaller magnitudes are refused, but for 0
    nonzero: bool = False  #: and 0 too
    unit: str = ""

    def counted(self) -> str:
        """How many there are, in words."""
        return f"{self.count} number{'s' * (self.count > 1)} ({self.what})" + ", or 1 for all channels" * self.channels

    def bounds(self) -> str:
        """What is allowed, in words."""
        kind = ("a whole number" if self.whole else "") + (f" of {self.unit}" if self.unit else "")
        magnitude = "a magnitude of " if self.low < 0 else ""
        low = max(self.low, self.least)
        least = f"{low:g} or more, " if low > 0 or not magnitude else ""
        zero = "0, or " if self.least and not self.nonzero else ""
        return f"{zero}{kind}{', ' * bool(kind)}{magnitude}{least}{self.high:.10g} at most"

    def allow(self, value: float) -> bool:
        """Whether a number is in the range."""
        return (
            self.low <= value <= self.high
            and (abs(value) >= self.least or value == 0)
            and (value != 0 or not self.nonzero)
            and (value == int(value) or not self.whole)
        )

    def value(self, given: Sequence[float]) -> Any:
        """What so many numbers come to: one, or a tuple; None where their count is wrong, or one is not allowed."""
        if len(given) != self.count and not (self.channels and len(given) == 1):
            return None
        if not (self.low <= min(given) and max(given) <= self.high):
            return None
        small = self.least and min(map(abs, given)) < self.least
        if (small or self.whole or (self.nonzero and 0 in given)) and not all(map(self.allow, given)):
            return None
        if self.direction and math.hypot(*given) < 1 / LARGE:
            return None
        values = tuple(map(int, given)) if self.whole else tuple(given)
        return values[0] if self.count == 1 else values * (self.count // len(values))


@dataclass(frozen=True)
class Flags:
    """The TRUE or FALSE that follow a word: how many, and what they are called in messages."""

    count: int = 1
    what: str = ""

    def counted(self) -> str:
        """How many there are, in words."""
        return f"{self.count} words, each TRUE or FALSE ({self.what})" if self.count > 1 else "TRUE or FALSE"
