"""Errors and warnings that show the place in the scene's text."""

import re
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from typing import NamedTuple

USE = re.compile(r"\$([A-Za-z_]\w*)", re.ASCII)
CLIP = 60  # a word or a line of the source is quoted up to this length: a file may be one line of 16 MiB
OTHERS = 4  # so many errors are told beside the first one
MOST = 100  # so many more are looked for


class Place(NamedTuple):
    """Where something stands in the text: character offsets ``start`` and ``end``."""

    start: int
    end: int


class SceneWarning(UserWarning):
    """Something in a scene that is most likely not meant, but has a meaning. Emitted through ``warnings.warn``.

    ``reason`` is the message without its place, ``place`` that in the text, or None where there is none.
    """

    def __init__(self, message: str, reason: str = "", place: Place | None = None) -> None:
        super().__init__(message)
        self.reason, self.place = reason or message, place


class SceneError(ValueError):
    """Wrong input. ``str()`` is the whole message: file, line, column, what was found and expected, and a caret.

    The parts are attributes too: ``filename``, ``line``, ``column`` (both from 1; 0 where the error has no place in the
    text), ``reason``, and ``place``, or None. Where other errors are known as well, ``others``, the text has them too.
    """

    others: tuple["SceneError", ...] = ()

    def __init__(
        self,
        message: str,
        filename: str = "",
        line: int = 0,
        column: int = 0,
        reason: str = "",
        place: Place | None = None,
    ) -> None:
        super().__init__(message)
        self.filename, self.line, self.column, self.reason = filename, line, column, reason or message
        self.place = place


def together(first: SceneError, others: Sequence[SceneError]) -> SceneError:
    """The first error, whose text goes on with the others."""
    if not others:
        return first
    more = len(others) - OTHERS
    rest = "and many more errors" if len(others) >= MOST else f"and {more} more errors"
    text = "\n".join([str(first), *map(str, others[:OTHERS]), *([rest] if more > 0 else [])])
    result = type(first)(text, first.filename, first.line, first.column, first.reason, first.place)
    result.others = tuple(others)
    return result


@dataclass(frozen=True)
class Said:
    """What an error or a warning says, and where; ``start`` and ``end`` are offsets; ``undefined``: the ``$name`` that
    has no value, where that is the error.
    """

    start: int
    end: int
    reason: str
    error: bool
    undefined: str | None = None


def what_is_said(message: SceneError | SceneWarning, otherwise: int = 0) -> Said:
    """What a message says; at ``otherwise`` where it has no place."""
    place = message.place or Place(otherwise, otherwise + 1)
    return Said(place.start, place.end, message.reason, isinstance(message, SceneError))


class Source:
    """The text of a scene and its file name; turns offsets into lines, columns and messages."""

    def __init__(self, text: str, filename: str | PathLike[str]) -> None:
        self.text, self.filename = text, str(filename)
        #: What ``$names`` stand for, and where that is from: ``'5', by -D x=5``. Messages about them say it.
        self.names: dict[str, str] = {}
        #: What has been found doubtful so far.
        self.doubts: list[Said] = []

    @cached_property
    def line_starts(self) -> list[int]:
        """Offsets at which the lines begin."""
        return [0, *(newline.end() for newline in re.finditer("\n", self.text))]

    def line_column(self, offset: int) -> tuple[int, int]:
        """Line and column, both from 1, of a character offset."""
        line = bisect_right(self.line_starts, offset)
        return line, offset - self.line_starts[line - 1] + 1

    def line(self, place: Place) -> int:
        """The line, from 1, on which a place begins."""
        return self.line_column(place.start)[0]

    def message(self, place: Place, reason: str) -> str:
        """``file:line:column: reason`` and the source line with a caret under the place."""
        line, column = self.line_column(place.start)
        start = self.line_starts[line - 1]
        end = self.text.find("\n", place.start)
        end = len(self.text) if end < 0 else end
        # A long line is quoted around the place only.
        first, last = max(start, place.start - CLIP), min(end, place.start + CLIP)
        before, after = "…" * (first > start), "…" * (last < end)
        quoted = before + "".join(c if c.isprintable() else " " for c in self.text[first:last]) + after
        width = max(1, min(place.end, last) - place.start)
        caret = " " * (len(before) + place.start - first) + "^" + "~" * (width - 1)
        return f"{self.filename}:{line}:{column}: {reason}\n    {quoted}\n    {caret}"

    def _of_names(self, place: Place, reason: str) -> str:
        """``; `` and what the names at a place stand for, of which the reason does not speak."""
        found = dict.fromkeys(USE.findall(self.text[place.start : min(place.end, place.start + CLIP)]))
        said = [f"${n} stands for {self.names[n]}" for n in found if n in self.names and f"${n}" not in reason]
        return f"; {listing(said[:3], 'and')}" if said else ""

    def error(self, place: Place, reason: str, names: bool = True) -> SceneError:
        """The error to raise about what stands at ``place``; it says what the ``names`` there stand for."""
        reason += self._of_names(place, reason) if names else ""
        line, column = self.line_column(place.start)
        return SceneError(self.message(place, reason), self.filename, line, column, reason, place)

    def warning(self, place: Place, reason: str, names: bool = True) -> SceneWarning:
        """The warning to emit about what stands at ``place``; it says what the ``names`` there stand for."""
        reason += self._of_names(place, reason) if names else ""
        return SceneWarning(self.message(place, reason), reason, place)

    def said(self, place: Place, reason: str, error: bool = False) -> Said:
        """What an error or a warning is to say about what stands at ``place``."""
        return Said(*place, reason + self._of_names(place, reason), error)

    def doubt(self, place: Place, reason: str) -> None:
        """Keeps a warning about what stands at ``place`` until all has been read."""
        self.doubts.append(self.said(place, reason))


def quote(text: str) -> str:
    """``'text'``, clipped where it is too long to print."""
    text = str(text)
    return repr(text if len(text) <= CLIP else text[: CLIP - 3] + "...")


def listing(words: Iterable[object], last: str = "or") -> str:
    """``A, B or C``."""
    texts = [str(word) for word in words]
    return texts[0] if len(texts) == 1 else f"{', '.join(texts[:-1])} {last} {texts[-1]}"
