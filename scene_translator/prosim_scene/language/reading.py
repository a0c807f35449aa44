"""A text that changes -> its statements, each read on its own, and read anew only where it has changed."""

from bisect import bisect_right
from collections.abc import Iterator, Mapping
from typing import Any

from lark import Token

from . import trees
from .definitions import Definitions
from .messages import MOST, Source
from .shapes import Shapes
from .units import Unit, read


class Reading:
    """A text and its statements: ``units``, and where each of them is now, ``bases``. ``given``: see Definitions.

    Where more than MOST statements are wrong, the text is ``cut``: what follows has not been read.
    """

    def __init__(self, text: str = "", filename: str = "<string>", given: Mapping[str, object] | None = None) -> None:
        self.source, self.given = Source("", filename), given
        self.units: list[Unit] = []
        self.bases: list[int] = []
        self.cut = False
        self.shapes = Shapes()
        self.change(text)

    def change(self, text: str) -> None:
        """Another text in the place of the last one; what both have is not read again."""
        old, units, bases = self.source.text, self.units, self.bases
        same_start, same_end = _common(old, text)
        shift = len(text) - len(old)
        # Where units of the end begin now. The first of them has its keyword whole within what is the same.
        after = {
            base + shift: i for i, base in enumerate(bases) if base >= max(len(old) - same_end, same_start) and i > 0
        }
        self.source = Source(text, self.source.filename)
        self.units, self.bases = [], []
        definitions = self.definitions = Definitions(self.source, self.given)
        wrong = position = i = 0
        while position < len(text) and wrong <= MOST:
            # An unchanged unit ends before the change, and so does the keyword that follows it.
            if not (i < len(units) and bases[i] == position and _end(units, bases, i, old) <= same_start):
                i = after.get(position, len(units))
            # What is wrong may come to be right by what stands farther down, such as a remark that is closed there.
            if i < len(units) and not units[i].wrong and _means_the_same(units[i], definitions):
                unit = units[i]
                length = unit.end - unit.base
            else:
                unit = self._read(position)
                length = unit.end - position
                wrong += unit.wrong
            for name, value in unit.defines.items():
                definitions.default(name, value)
            self.units.append(unit)
            self.bases.append(position)
            position += length
            i += 1
        self.cut = position < len(text)
        definitions.uses = {name for unit in self.units if unit.uses for name in unit.uses}

    def _read(self, start: int) -> Unit:
        """The unit that begins at ``start``."""
        source = self.source
        name = self.bases[-1] if self.units and self.units[-1].kind == "NAME" else None
        known = self.shapes.read(source, start) or trees.read(source, start)
        return known or read(source, start, self.definitions, name)

    def unit(self, offset: int) -> int | None:
        """The number of the unit that an offset is in."""
        i = bisect_right(self.bases, offset) - 1
        return i if i >= 0 else None

    def tokens(self, only: int | None = None) -> Iterator[tuple[Unit, Token, int]]:
        """All tokens, or those of one unit ``only``, with their units, and their offsets."""
        which = slice(None) if only is None else slice(only, only + 1)
        for base, unit in zip(self.bases[which], self.units[which]):
            for token in unit.tokens:
                yield unit, token, base + (token.start_pos or 0) - unit.base


class Last:
    """The last text that was read, for the next one of the same file."""

    def __init__(self) -> None:
        self._reading: Reading | None = None

    def changed(self, text: str, filename: str, given: Mapping[str, object]) -> Reading:
        """A text, read. ``given``: see Definitions."""
        reading, self._reading = self._reading, None  # an error leaves none that is half read
        if reading is None or reading.source.filename != filename:
            reading = Reading(text, filename, given)
        else:
            reading.given = given
            reading.change(text)
        self._reading = reading
        return reading


def _common(old: str, new: str) -> tuple[int, int]:
    """How long the beginning is that two texts have in common, and the end behind that."""
    most = min(len(old), len(new))
    start = _longest(most, lambda n: old[:n] == new[:n])
    return start, _longest(most - start, lambda n: not n or old[-n:] == new[-n:])


def _longest(most: int, same: Any) -> int:
    """The largest n up to ``most`` for which ``same(n)`` holds, as it does for all smaller ones."""
    low, high = 0, most
    if same(most):
        return most
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if same(middle) else (low, middle)
    return low


def _end(units: list[Unit], bases: list[int], i: int, text: str) -> int:
    """Up to where the text decides what unit i is: the end of the keyword that follows it."""
    if i + 1 == len(units):
        return len(text) + 1
    return bases[i + 1] + units[i + 1].opening + 1


def _means_the_same(unit: Unit, definitions: Definitions) -> bool:
    """Whether the names that a unit uses stand for what they did."""
    return all(definitions.now(name) == value for name, value in unit.uses.items())
