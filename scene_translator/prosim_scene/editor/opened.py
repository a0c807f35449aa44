"""A document that an editor has open, and what was read of it."""

import asyncio
from pathlib import Path

from lsprotocol import types as lsp
from pygls.uris import to_fs_path

from ..language.messages import Said
from ..language.reading import Reading
from .buffers import Buffer
from .places import Occurrence


class Opened:
    """A document that is open, and what was read of it."""

    def __init__(self, document: lsp.TextDocumentItem, encoding: str) -> None:
        self.uri, self.version = document.uri, document.version
        path = to_fs_path(document.uri)
        self.path = Path(path) if path else None
        self.buffer = Buffer(document.text, encoding)
        self._reading = Reading(filename=path or document.uri)
        self.evaluation: asyncio.Task[None] | None = None
        self.telling: asyncio.TimerHandle | None = None
        #: Seconds that it took to say what is wrong.
        self.took = 0.0

    @property
    def reading(self) -> Reading:
        """The text, read as it is now."""
        text = self.buffer.scene()
        if self._reading.source.text != text:
            self._reading.change(text)
        return self._reading

    def rest(self) -> None:
        """Ends what has been begun because of the text as it was."""
        for one in (self.evaluation, self.telling):
            if one is not None:
                one.cancel()

    def change(self, change: lsp.DidChangeTextDocumentParams) -> None:
        """Takes another text in the place of parts, or of the whole."""
        for one in change.content_changes:
            if isinstance(one, lsp.TextDocumentContentChangePartial):
                start, end = one.range.start, one.range.end
                self.buffer.change((start.line, start.character), (end.line, end.character), one.text)
            else:
                self.buffer = Buffer(one.text, self.buffer.encoding)
        self.version = change.text_document.version

    def offset(self, position: lsp.Position) -> int:
        """A position of the protocol as an offset."""
        return self.buffer.offset((position.line, position.character))

    def range(self, start: int, end: int) -> lsp.Range:
        """Offsets as the protocol has them."""
        return lsp.Range(lsp.Position(*self.buffer.position(start)), lsp.Position(*self.buffer.position(end)))

    def diagnostic(self, one: Said) -> lsp.Diagnostic:
        """An error or a warning."""
        severity = lsp.DiagnosticSeverity.Error if one.error else lsp.DiagnosticSeverity.Warning
        place = self.range(one.start, max(one.end, one.start + 1))
        return lsp.Diagnostic(place, one.reason, severity=severity, source="prosim")

    def locations(self, found: list[Occurrence]) -> list[lsp.Location]:
        """Occurrences as the protocol has them."""
        return [lsp.Location(self.uri, self.range(one.start, one.end)) for one in found]
