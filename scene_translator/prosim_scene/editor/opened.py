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
        self.reading = Reading(self.buffer.scene(), path or document.uri)
        self.evaluation: asyncio.Task[None] | None = None

    def change(self, change: lsp.DidChangeTextDocumentParams) -> None:
        """Takes another text in the place of parts, or of the whole."""
        for one in change.content_changes:
            if isinstance(one, lsp.TextDocumentContentChangePartial):
                start, end = one.range.start, one.range.end
                self.buffer.change((start.line, start.character), (end.line, end.character), one.text)
            else:
                self.buffer = Buffer(one.text, self.buffer.encoding)
        self.version = change.text_document.version
        self.reading.change(self.buffer.scene())

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
