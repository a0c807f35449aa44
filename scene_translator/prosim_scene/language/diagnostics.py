"""Errors and warnings that show the faulty part of a scene's text."""

import re
import sys
import warnings
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from copy import copy
from functools import cached_property
from os import PathLike
from typing import NamedTuple, TypeVar

from .words import PROSE, preferred_spellings

#: Matches a word of a message outside of the quotations of the scene's text; a suggestion in quotes counts as outside.
MESSAGE_WORD = re.compile(r"(?<![\w])(?<!mean )'[^']*'|[\w-]+")
USE = re.compile(r"\$([^\W\d]\w*)")
AnyPath = str | PathLike[str]
OWN_PACKAGES = ("prosim_scene", "mitsuba_prosim", "prosim_start")
MAX_QUOTE = 60  # the largest number of characters that a message quotes
MAX_SHOWN = 4  # the number of errors that a message shows after the first one
MAX_ERRORS = 100  # the number of errors after which the reader stops


class Span(NamedTuple):
    """A part of a text, from the character offset ``start`` to the character offset ``end``."""

    start: int
    end: int


class Diagnostic(Exception):  # noqa: N818 - also of warnings
    """A problem in the text of a scene. ``str()`` returns the whole message: file, line, column, the problem, and a
    caret under the faulty text.

    The attributes are the parts of the message, namely ``filename``; ``line`` and ``column`` (both from 1; 0 if the
    problem has no position in the text); ``reason``; ``span`` or None; ``code``, a fixed name for this kind of problem.
    """

    line = column = 0
    span: Span | None = None

    def __init__(self, reason: str, filename: AnyPath = "", code: str = "", message: str = "") -> None:
        """If ``message`` is empty, the message consists of the file name, if there is one, and of the reason."""
        self.filename, self.reason, self.code = str(filename), reason, code
        super().__init__(message or (f"{filename}: {reason}" if filename else reason))


class SceneWarning(Diagnostic, UserWarning):
    """A probable mistake, or an approximation, in a valid scene, through ``warnings.warn``; with the attributes of a
    :class:`SceneError`, except ``others``.
    """

    def emit(self) -> None:
        """Emits this warning; its origin is the first caller that is not part of the project."""
        frame, level = sys._getframe(), 1  # noqa: SLF001 - warnings.warn has no other way for Python 3.10
        while frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] in OWN_PACKAGES:
            frame, level = frame.f_back, level + 1
        warnings.warn(self, stacklevel=level)


class SceneError(Diagnostic, ValueError):
    """An error in the input. ``str()`` returns the whole message: file, line, column, the problem, the expected input,
    and a caret under the faulty text.

    The attributes are the parts of the message, namely ``filename``; ``line`` and ``column`` (both from 1; 0 if the
    error has no position in the text); ``reason``; ``span`` or None; ``code``, a fixed name for this kind of error. The
    attribute ``others`` has the errors that follow the first error in the text; the message shows the first few of
    them.
    """

    others: tuple["SceneError", ...] = ()


Problem = SceneError | SceneWarning
Kind = TypeVar("Kind", SceneError, SceneWarning)


def combined_error(errors: Sequence[SceneError]) -> SceneError:
    """Returns the first error, with the messages of at most MAX_SHOWN others and a note of more; ``others`` has all of
    them.
    """
    first, *others = errors
    more = len(others) - MAX_SHOWN
    ending = ["and many more errors" if len(others) >= MAX_ERRORS else f"and {more} more errors"] if more > 0 else []
    text = "\n".join([*map(str, errors[: MAX_SHOWN + 1]), *ending])
    combined = copy(first)
    combined.args, combined.others = (text,), tuple(others)
    return combined


class Source:
    """The text of a scene and the name of its file; converts text offsets to lines and columns, and makes messages
    about parts of the text.
    """

    def __init__(self, text: str, filename: AnyPath) -> None:
        self.text, self.filename = text, str(filename)
        #: Name -> its value and the origin of the value, such as ``'5', by -D x=5``; for messages about the name.
        self.names: dict[str, str] = {}

    @cached_property
    def spellings(self) -> dict[str, str]:
        """A dictionary from the canonical spelling of each word to the spelling that messages about this text use."""
        return preferred_spellings(self.text)

    @cached_property
    def line_starts(self) -> list[int]:
        """The offsets at which the lines of the text begin."""
        return [0, *(newline.end() for newline in re.finditer("\n", self.text))]

    def line_column(self, offset: int) -> tuple[int, int]:
        """Returns the line and the column, both from 1, of a character offset."""
        line = bisect_right(self.line_starts, offset)
        return line, offset - self.line_starts[line - 1] + 1

    def message(self, span: Span, reason: str) -> str:
        """Returns ``file:line:column: reason``, the first line of the span, and a caret under it."""
        line, column = self.line_column(span.start)
        start = self.line_starts[line - 1]
        end = self.text.find("\n", span.start)
        end = len(self.text) if end < 0 else end
        # Only the part of a long line around the span is quoted.
        first, last = max(start, span.start - MAX_QUOTE), min(end, span.start + MAX_QUOTE)
        before, after = "…" * (first > start), "…" * (last < end)
        quoted = before + "".join(c if c.isprintable() else " " for c in self.text[first:last]) + after
        width = max(1, min(span.end, last) - span.start)
        caret = " " * (len(before) + span.start - first) + "^" + "~" * (width - 1)
        return f"{self.filename}:{line}:{column}: {reason}\n    {quoted}\n    {caret}"

    def error(self, span: Span, reason: str, code: str = "") -> SceneError:
        """Returns an error about the text at ``span``."""
        return self.diagnostic(SceneError, span, reason, code)

    def diagnostic(self, kind: type[Kind], span: Span, reason: str, code: str) -> Kind:
        """Returns an error or a warning (``kind``) about ``span``. If the text there contains ``$names`` that the
        reason does not mention, the values of at most three of them are added to the reason.
        """
        used = dict.fromkeys(USE.findall(self.text[span.start : min(span.end, span.start + MAX_QUOTE)]))
        unexplained = [name for name in used if name in self.names and f"${name}" not in reason]
        values = [f"${name} stands for {self.names[name]}" for name in unexplained]
        reason = MESSAGE_WORD.sub(lambda m: m[0] if m[0] in PROSE else self.spellings.get(m[0], m[0]), reason)
        reason += f"; {listing(values[:3], 'and')}" if values else ""
        diagnostic = kind(reason, self.filename, code, self.message(span, reason))
        diagnostic.span, (diagnostic.line, diagnostic.column) = span, self.line_column(span.start)
        return diagnostic


def quote(text: object) -> str:
    """Puts a text of at most MAX_QUOTE characters in quotes; a longer text is shortened."""
    text = str(text)
    return repr(text if len(text) <= MAX_QUOTE else text[: MAX_QUOTE - 3] + "...")


def listing(words: Iterable[object], last: str = "or") -> str:
    """Joins words to one phrase: ``A, B or C``."""
    *texts, end = map(str, words)
    return f"{', '.join(texts)} {last} {end}" if texts else end
