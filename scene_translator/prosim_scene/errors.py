"""Errors and warnings that show the place in the scene's text."""

import difflib
from bisect import bisect_right
from dataclasses import dataclass

CLIP = 60  # a word or a line of the source is quoted up to this length: a file may be one line of 16 MiB


class SceneWarning(UserWarning):
    """Something in a scene that is most likely not meant, but has a meaning. Emitted through ``warnings.warn``."""


class SceneError(ValueError):
    """Wrong input. ``str()`` is the whole message: file, line, column, what was found and expected, and a caret.

    The parts are attributes too: ``filename``, ``line``, ``column`` (both from 1; 0 where the error has no place in the
    text), ``reason``.
    """

    def __init__(self, message, filename="", line=0, column=0, reason=""):
        super().__init__(message)
        self.filename, self.line, self.column, self.reason = filename, line, column, reason or message


@dataclass(frozen=True)
class Place:
    """Where something stands in the text: character offsets ``start`` and ``end``."""

    start: int
    end: int


class Source:
    """The text of a scene and its file name; turns offsets into lines, columns and messages."""

    def __init__(self, text, filename):
        self.text, self.filename = text, str(filename)
        self._line_starts = None

    def line_column(self, offset):
        """Line and column, both from 1, of a character offset."""
        if self._line_starts is None:
            self._line_starts = [0]
            self._line_starts += [i + 1 for i, c in enumerate(self.text) if c == "\n"]
        line = bisect_right(self._line_starts, offset)
        return line, offset - self._line_starts[line - 1] + 1

    def line(self, place):
        return self.line_column(place.start)[0]

    def message(self, place, reason):
        """``file:line:column: reason`` and the source line with a caret under the place."""
        line, column = self.line_column(place.start)
        start = self._line_starts[line - 1]
        end = self.text.find("\n", place.start)
        end = len(self.text) if end < 0 else end
        # A long line is quoted around the place only.
        first = max(start, place.start - CLIP)
        quoted = self.text[first:min(end, place.start + CLIP)]
        quoted = "".join(c if c.isprintable() else " " for c in quoted)
        width = max(1, min(place.end, end, place.start + CLIP) - place.start)
        caret = " " * (place.start - first) + "^" + "~" * (width - 1)
        return f"{self.filename}:{line}:{column}: {reason}\n    {quoted}\n    {caret}"

    def error(self, place, reason):
        line, column = self.line_column(place.start)
        return SceneError(self.message(place, reason), self.filename, line, column, reason)

    def warning(self, place, reason):
        return SceneWarning(self.message(place, reason))


def quote(text):
    """``'text'``, clipped where it is too long to print."""
    text = str(text)
    return repr(text if len(text) <= CLIP else text[:CLIP - 3] + "...")


def listing(words, last="or"):
    """``A, B or C``."""
    words = [str(word) for word in words]
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}"


def nearest(word, words, cutoff=0.6):
    """``; did you mean 'X'?`` for the known word nearest to ``word``, or nothing where none is near."""
    folded = {w.lower(): w for w in words}
    match = difflib.get_close_matches(str(word).lower()[:CLIP], folded, n=1, cutoff=cutoff)
    return f"; did you mean {folded[match[0]]!r}?" if match else ""
