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
OTHERS = 4  # a message shows this many errors after the first one
MOST = 100  # the reader stops after this many more errors


class Span(NamedTuple):
    """A part of the text: character offsets ``start`` and ``end``."""

    start: int
    end: int


class SceneWarning(UserWarning):
    """Something in a scene that is most likely not meant, but has a meaning. Emitted through ``warnings.warn``.

    ``reason`` is the message without its place, ``span`` that place or None, ``code`` a stable name of the problem.
    """

    def __init__(self, message: str, reason: str = "", span: Span | None = None, code: str = "") -> None:
        super().__init__(message)
        self.reason, self.span, self.code = reason or message, span, code


class SceneError(ValueError):
    """Wrong input. ``str()`` is the whole message: file, line, column, what was found and expected, and a caret.

    The parts are attributes too: ``filename``, ``line``, ``column`` (both from 1; 0 where the error has no place in the
    text), ``reason``, ``span`` or None, and ``code``, a stable name of the problem. ``others`` are the further errors
    of the text; the message shows the first of them.
    """

    others: tuple["SceneError", ...] = ()

    def __init__(
        self,
        message: str,
        filename: str = "",
        line: int = 0,
        column: int = 0,
        reason: str = "",
        span: Span | None = None,
        code: str = "",
    ) -> None:
        super().__init__(message)
        self.filename, self.line, self.column, self.reason = filename, line, column, reason or message
        self.span, self.code = span, code


def together(first: SceneError, others: Sequence[SceneError]) -> SceneError:
    """The first error; its message goes on with the others."""
    if not others:
        return first
    more = len(others) - OTHERS
    rest = "and many more errors" if len(others) >= MOST else f"and {more} more errors"
    text = "\n".join([str(first), *map(str, others[:OTHERS]), *([rest] if more > 0 else [])])
    result = SceneError(text, first.filename, first.line, first.column, first.reason, first.span, first.code)
    result.others = tuple(others)
    return result


@dataclass(frozen=True)
class Diagnostic:
    """An error or a warning about the text from offset ``start`` to ``end``; ``code`` is a stable name of the problem.

    ``undefined``: the ``$name`` that has no value, where that is the error.
    """

    start: int
    end: int
    reason: str
    error: bool
    code: str = ""
    undefined: str | None = None


def diagnostic(message: SceneError | SceneWarning, undefined: str | None = None) -> Diagnostic:
    """What a message says; at the beginning of the text where it has no place."""
    span = message.span or Span(0, 1)
    return Diagnostic(*span, message.reason, isinstance(message, SceneError), message.code, undefined)


class Source:
    """The text of a scene and its file name; turns offsets into lines, columns and messages."""

    def __init__(self, text: str, filename: str | PathLike[str]) -> None:
        self.text, self.filename = text, str(filename)
        #: What ``$names`` stand for, and where that is from: ``'5', by -D x=5``. Messages about them say it.
        self.names: dict[str, str] = {}

    @cached_property
    def line_starts(self) -> list[int]:
        """Offsets at which the lines begin."""
        return [0, *(newline.end() for newline in re.finditer("\n", self.text))]

    def line_column(self, offset: int) -> tuple[int, int]:
        """Line and column, both from 1, of a character offset."""
        line = bisect_right(self.line_starts, offset)
        return line, offset - self.line_starts[line - 1] + 1

    def line(self, span: Span) -> int:
        """The line, from 1, on which a span begins."""
        return self.line_column(span.start)[0]

    def message(self, span: Span, reason: str) -> str:
        """``file:line:column: reason`` and the source line with a caret under the span."""
        line, column = self.line_column(span.start)
        start = self.line_starts[line - 1]
        end = self.text.find("\n", span.start)
        end = len(self.text) if end < 0 else end
        # A long line is quoted around the place only.
        first, last = max(start, span.start - CLIP), min(end, span.start + CLIP)
        before, after = "…" * (first > start), "…" * (last < end)
        quoted = before + "".join(c if c.isprintable() else " " for c in self.text[first:last]) + after
        width = max(1, min(span.end, last) - span.start)
        caret = " " * (len(before) + span.start - first) + "^" + "~" * (width - 1)
        return f"{self.filename}:{line}:{column}: {reason}\n    {quoted}\n    {caret}"

    def explained(self, span: Span, reason: str) -> str:
        """The reason, and what the ``$names`` in a span stand for where it does not say that."""
        found = dict.fromkeys(USE.findall(self.text[span.start : min(span.end, span.start + CLIP)]))
        values = [f"${n} stands for {self.names[n]}" for n in found if n in self.names and f"${n}" not in reason]
        return f"{reason}; {listing(values[:3], 'and')}" if values else reason

    def error(self, span: Span, reason: str, code: str = "") -> SceneError:
        """The error to raise about what stands at ``span``."""
        reason = self.explained(span, reason)
        line, column = self.line_column(span.start)
        return SceneError(self.message(span, reason), self.filename, line, column, reason, span, code)

    def warning(self, span: Span, reason: str, code: str = "") -> SceneWarning:
        """The warning to emit about what stands at ``span``."""
        reason = self.explained(span, reason)
        return SceneWarning(self.message(span, reason), reason, span, code)

    def diagnostic(self, span: Span, reason: str, code: str = "", error: bool = False) -> Diagnostic:
        """The diagnostic of what stands at ``span``."""
        return Diagnostic(*span, self.explained(span, reason), error, code)


def quote(text: str) -> str:
    """``'text'``, clipped where it is too long to print."""
    text = str(text)
    return repr(text if len(text) <= CLIP else text[: CLIP - 3] + "...")


def listing(words: Iterable[object], last: str = "or") -> str:
    """``A, B or C``."""
    texts = [str(word) for word in words]
    return texts[0] if len(texts) == 1 else f"{', '.join(texts[:-1])} {last} {texts[-1]}"
