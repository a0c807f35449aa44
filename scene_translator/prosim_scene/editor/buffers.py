"""A text as an editor has it: in lines and columns, and changed in parts."""

import re
from bisect import bisect_left, bisect_right
from functools import cached_property
from itertools import takewhile

#: What ends a line by the protocol. For Python's ``splitlines`` others do as well, such as the form feed.
MARK = re.compile(r"\r\n?|\n")
ENCODINGS = {"utf-8": ("utf-8", 1), "utf-16": ("utf-16-le", 2), "utf-32": ("utf-32-le", 4)}

#: Line and column, both from 0, in units of an encoding.
Position = tuple[int, int]


class Buffer:
    """A ``text``, whose columns are counted in units of ``encoding``: "utf-8", "utf-16" or "utf-32"."""

    def __init__(self, text: str, encoding: str = "utf-16") -> None:
        self.text, self.encoding = text, encoding

    @cached_property
    def lines(self) -> list[int]:
        """Offsets at which the lines begin."""
        return [0, *(mark.end() for mark in MARK.finditer(self.text))]

    @property
    def newline(self) -> str:
        """What ends the first line."""
        found = MARK.search(self.text)
        return found[0] if found else "\n"

    def scene(self) -> str:
        """The text as it were read from a file, but that each character has its place: CR LF stays, others are LF."""
        text = " " + self.text[1:] if self.text.startswith("\ufeff") else self.text
        return re.sub(r"\r(?!\n)", "\n", text) if "\r" in text else text

    def offset(self, position: Position) -> int:
        """The offset of a position; of one behind the end of a line, or of the text, that end."""
        number, column = position
        if number >= len(self.lines):
            return len(self.text)
        start = self.lines[number]
        found = MARK.search(self.text, start)
        line = self.text[start : found.start() if found else len(self.text)]
        if line.isascii():
            return start + min(column, len(line))
        return start + bisect_right(range(1, len(line) + 1), column, key=lambda n: self._units(line[:n]))

    def position(self, offset: int) -> Position:
        """The position of an offset."""
        number = bisect_right(self.lines, offset) - 1
        return number, self._units(self.text[self.lines[number] : offset])

    def change(self, start: Position, end: Position, text: str) -> None:
        """Puts ``text`` in the place of what stands from ``start`` to ``end``."""
        first = self.offset(start)
        last = max(first, self.offset(end))
        behind = first + len(text)
        # Next to the change a CR and a LF may have come together, or apart.
        same, after = max(1, bisect_left(self.lines, first)), bisect_left(self.lines, last + 2)
        self.text = self.text[:first] + text + self.text[last:]
        starts = (mark.end() for mark in MARK.finditer(self.text, self.lines[same - 1]))
        between = takewhile(lambda at: at < behind + 2, starts)
        self.lines[same:] = [*between, *(at - last + behind for at in self.lines[after:])]

    def _units(self, text: str) -> int:
        """How many units a text has."""
        codec, size = ENCODINGS[self.encoding]
        return len(text) if text.isascii() else len(text.encode(codec, "surrogatepass")) // size
