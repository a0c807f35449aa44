"""``prosim language-server``: the Language Server Protocol over ``symbols``."""

import asyncio
import gc
import re
from bisect import bisect_right
from importlib.metadata import version
from pathlib import Path

import click

from . import extras

try:
    from lsprotocol import types as lsp
    from pygls.exceptions import JsonRpcException
    from pygls.lsp.server import LanguageServer
    from pygls.uris import to_fs_path
except ModuleNotFoundError:
    raise click.ClickException(extras.needs("the language server", "editors")) from None

from .evaluation import evaluate_in_process
from .language.diagnostics import SceneError, SceneWarning
from .language.formatter import format
from .symbols import Completion, Occurrence, Symbols

#: The largest tree that the server evaluates; ``prosim translate --check`` has no limit.
LARGEST = 1000
#: Seconds after a keystroke until the text is read again.
DELAY = 0.03
#: The largest length of a list of completions.
WORDS = 500
KINDS = {
    "statement": lsp.CompletionItemKind.Keyword,
    "keyword": lsp.CompletionItemKind.Property,
    "value": lsp.CompletionItemKind.Color,
    "solid": lsp.CompletionItemKind.Class,
    "index": lsp.CompletionItemKind.Value,
    "name": lsp.CompletionItemKind.Variable,
    "function": lsp.CompletionItemKind.Function,
}
#: The line ends of the protocol; Python's ``splitlines`` has more, such as the form feed.
NEWLINE = re.compile(r"\r\n?|\n")
ENCODINGS = {"utf-8": ("utf-8", 1), "utf-16": ("utf-16-le", 2), "utf-32": ("utf-32-le", 4)}


class OpenDocument:
    """A document that is open in an editor. Lines and columns are from 0; columns are in units of ``encoding``."""

    def __init__(self, uri: str, text: str, encoding: str = "utf-16", version: int | None = None) -> None:
        path = to_fs_path(uri)
        self.uri, self.version, self.encoding = uri, version, encoding
        self.path = Path(path) if path else None
        self.pending: asyncio.Task[None] | asyncio.TimerHandle | None = None
        self.change(text, version)

    def change(self, text: str, version: int | None) -> None:
        """Sets the text, and cancels pending work for the previous one."""
        self.cancel()
        self.text, self.version = text, version
        self.lines = [0, *(newline.end() for newline in NEWLINE.finditer(text))]
        # As from a file, with the same offsets: a lone CR becomes LF.
        text = " " + text[1:] if text.startswith("\ufeff") else text
        self.scene = re.sub(r"\r(?!\n)", "\n", text)
        self._symbols: Symbols | None = None

    def cancel(self) -> None:
        """Cancels pending work."""
        if self.pending is not None:
            self.pending.cancel()

    @property
    def symbols(self) -> Symbols:
        """The text, read."""
        self._symbols = self._symbols or Symbols(self.scene, self.path or self.uri)
        return self._symbols

    def offset(self, position: lsp.Position) -> int:
        """The offset of a position, clamped to the end of its line and of the text."""
        if position.line >= len(self.lines):
            return len(self.text)
        start = self.lines[position.line]
        found = NEWLINE.search(self.text, start)
        inside = self.text[start : found.start() if found else len(self.text)]
        if inside.isascii():
            return start + min(position.character, len(inside))
        return start + bisect_right(
            range(1, len(inside) + 1), position.character, key=lambda n: self._units(inside[:n])
        )

    def position(self, offset: int) -> lsp.Position:
        """The position of an offset."""
        line = bisect_right(self.lines, offset) - 1
        return lsp.Position(line, self._units(self.text[self.lines[line] : offset]))

    def range(self, start: int, end: int) -> lsp.Range:
        """The protocol's range of two offsets."""
        return lsp.Range(self.position(start), self.position(end))

    def locations(self, found: list[Occurrence]) -> list[lsp.Location]:
        """The protocol's locations of occurrences."""
        return [lsp.Location(self.uri, self.range(one.start, one.end)) for one in found]

    def diagnostic(self, one: SceneError | SceneWarning) -> lsp.Diagnostic:
        """The protocol's diagnostic of an error or a warning; without a span it is at the beginning of the text."""
        severity = lsp.DiagnosticSeverity.Error if isinstance(one, SceneError) else lsp.DiagnosticSeverity.Warning
        start, end = one.span or (0, 1)
        place = self.range(start, max(end, start + 1))
        return lsp.Diagnostic(place, one.reason, severity=severity, code=one.code or None, source="prosim")

    def _units(self, text: str) -> int:
        """The number of units in a text."""
        codec, size = ENCODINGS[self.encoding]
        return len(text) if text.isascii() else len(text.encode(codec, "surrogatepass")) // size


class SceneServer(LanguageServer):
    """A server, and the documents that are open."""

    def __init__(self) -> None:
        # An editor sends the whole text, because the reader needs all of it.
        super().__init__("prosim", version("mitsuba-prosim"), text_document_sync_kind=lsp.TextDocumentSyncKind.Full)
        self.documents: dict[str, OpenDocument] = {}

    def diagnose(self, document: OpenDocument, whole: bool) -> None:
        """Publishes the diagnostics of a document; ``whole``: also those of its evaluated tree, later."""
        document.cancel()
        symbols = document.symbols
        self.publish(document, symbols.diagnostics)
        if whole and symbols.document is not None and len(symbols.document.scene.csg) <= LARGEST:
            document.pending = asyncio.get_running_loop().create_task(self.evaluate(document, symbols.diagnostics))

    async def evaluate(self, document: OpenDocument, found: list[SceneError | SceneWarning]) -> None:
        """Publishes ``found`` and the diagnostics of the tree; a change of the document cancels it."""
        if more := await evaluate_in_process(document.scene, document.path):
            self.publish(document, [*found, *more])

    def publish(self, document: OpenDocument, found: list[SceneError | SceneWarning]) -> None:
        """Publishes diagnostics."""
        diagnostics = [document.diagnostic(one) for one in found]
        self.text_document_publish_diagnostics(
            lsp.PublishDiagnosticsParams(document.uri, diagnostics, document.version)
        )

    def symbol(
        self, params: lsp.DefinitionParams | lsp.ReferenceParams | lsp.RenameParams
    ) -> tuple[OpenDocument, Occurrence] | None:
        """The document and the symbol at a position."""
        document = self.documents.get(params.text_document.uri)
        here = document.symbols.at(document.offset(params.position)) if document else None
        return (document, here) if document and here else None


server = SceneServer()


@click.command("language-server")
def language_server() -> None:
    """Help an editor with scenes: errors while you write, completion, meanings, renaming, layout.

    An editor starts it, and communicates with it by standard input and output.
    """
    server.start_io()
    gc.freeze()  # skips a garbage collection at exit, which takes seconds after a long scene


@server.feature(lsp.TEXT_DOCUMENT_DID_OPEN)
def opened(ls: SceneServer, params: lsp.DidOpenTextDocumentParams) -> None:
    """Adds a document, and publishes all diagnostics, also those of its tree."""
    one = params.text_document
    encoding = lsp.PositionEncodingKind(ls.workspace.position_encoding or "utf-16").value
    ls.documents[one.uri] = OpenDocument(one.uri, one.text, encoding, one.version)
    ls.diagnose(ls.documents[one.uri], whole=True)


@server.feature(lsp.TEXT_DOCUMENT_DID_CHANGE)
def changed(ls: SceneServer, params: lsp.DidChangeTextDocumentParams) -> None:
    """Changes a document, and publishes the diagnostics after a delay without a keystroke."""
    document = ls.documents[params.text_document.uri]
    for change in params.content_changes:
        text = change.text
        if isinstance(change, lsp.TextDocumentContentChangePartial):  # from a client that ignores the kind of sync
            start = document.offset(change.range.start)
            end = max(start, document.offset(change.range.end))
            text = document.text[:start] + text + document.text[end:]
        document.change(text, params.text_document.version)
    document.pending = asyncio.get_running_loop().call_later(DELAY, ls.diagnose, document, False)


@server.feature(lsp.TEXT_DOCUMENT_DID_SAVE)
def saved(ls: SceneServer, params: lsp.DidSaveTextDocumentParams) -> None:
    """Publishes all diagnostics, also those of the tree."""
    if document := ls.documents.get(params.text_document.uri):
        ls.diagnose(document, whole=True)


@server.feature(lsp.TEXT_DOCUMENT_DID_CLOSE)
def closed(ls: SceneServer, params: lsp.DidCloseTextDocumentParams) -> None:
    """Removes a document and its diagnostics."""
    ls.documents.pop(params.text_document.uri).cancel()
    ls.text_document_publish_diagnostics(lsp.PublishDiagnosticsParams(params.text_document.uri, []))


@server.feature(lsp.TEXT_DOCUMENT_COMPLETION, lsp.CompletionOptions(trigger_characters=["$", "-"]))
def complete(ls: SceneServer, params: lsp.CompletionParams) -> lsp.CompletionList:
    """The words that fit. A long list has only words with the typed part, and is marked incomplete."""
    document = ls.documents[params.text_document.uri]
    offset = document.offset(params.position)
    found = document.symbols.completions(offset)
    incomplete = len(found) > WORDS
    if incomplete:
        typed = document.scene[found[0].start : offset].casefold()
        found = [one for one in found if typed in one.label.casefold()][:WORDS]
    return lsp.CompletionList(incomplete, [_completion(one, document.range(one.start, offset)) for one in found])


def _completion(one: Completion, place: lsp.Range) -> lsp.CompletionItem:
    """The protocol's item of a completion. Indices are sorted as numbers."""
    return lsp.CompletionItem(
        label=one.label,
        kind=KINDS[one.kind],
        detail=one.detail or None,
        documentation=lsp.MarkupContent(lsp.MarkupKind.Markdown, one.documentation) if one.documentation else None,
        sort_text=f"{one.rank}{one.label.zfill(9) if one.kind == 'index' else one.label}",
        text_edit=lsp.TextEdit(place, one.label),
    )


@server.feature(lsp.TEXT_DOCUMENT_HOVER)
def hover(ls: SceneServer, params: lsp.HoverParams) -> lsp.Hover | None:
    """The meaning of a word."""
    document = ls.documents[params.text_document.uri]
    if (found := document.symbols.hover(document.offset(params.position))) is None:
        return None
    start, end, text = found
    return lsp.Hover(lsp.MarkupContent(lsp.MarkupKind.Markdown, text), document.range(start, end))


@server.feature(lsp.TEXT_DOCUMENT_DEFINITION)
def definition(ls: SceneServer, params: lsp.DefinitionParams) -> list[lsp.Location]:
    """SURFACE and TRANSFORM of an index, TEXTURE of a texture, SOLID of a solid, DEFAULT of a name."""
    if (found := ls.symbol(params)) is None:
        return []
    document, here = found
    return document.locations([one for one in document.symbols.occurrences(here.symbol) if one.defines])


@server.feature(lsp.TEXT_DOCUMENT_REFERENCES)
def references(ls: SceneServer, params: lsp.ReferenceParams) -> list[lsp.Location]:
    """All occurrences of a symbol."""
    found = ls.symbol(params)
    return found[0].locations(found[0].symbols.occurrences(found[1].symbol)) if found else []


@server.feature(lsp.TEXT_DOCUMENT_RENAME)
def rename(ls: SceneServer, params: lsp.RenameParams) -> lsp.WorkspaceEdit | None:
    """Renames all occurrences of a symbol; raises JsonRpcException for an invalid name."""
    if (found := ls.symbol(params)) is None:
        return None
    document, here = found
    new = "$" * (here.symbol.kind == "name") + params.new_name.removeprefix("$")
    if document.symbols.renamed(here.symbol, new) is None:
        reason = f"{new!r} is another symbol's name, or not a name of this kind ({here.symbol.kind}); choose another"
        raise JsonRpcException(reason, lsp.LSPErrorCodes.RequestFailed)
    places = document.locations(document.symbols.occurrences(here.symbol))
    return lsp.WorkspaceEdit({document.uri: [lsp.TextEdit(one.range, new) for one in places]})


@server.feature(lsp.TEXT_DOCUMENT_FORMATTING)
def formatting(ls: SceneServer, params: lsp.DocumentFormattingParams) -> list[lsp.TextEdit] | None:
    """The canonical layout; None if the text has errors."""
    document = ls.documents[params.text_document.uri]
    lines = document.scene.replace("\r\n", "\n")
    try:
        formatted = format(lines, document.path or document.uri)
    except SceneError:
        return None
    newline = NEWLINE.search(document.text)
    new = formatted.replace("\n", newline[0] if newline else "\n")
    return [lsp.TextEdit(document.range(0, len(document.text)), new)] if formatted != lines else []
