"""``prosim language-server``: tells an editor, by the Language Server Protocol, what ``symbols`` knows of a text."""

import asyncio
import gc
import re
from bisect import bisect_right
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from urllib.parse import unquote

import click

from . import extras

try:
    from lsprotocol import types as lsp
    from pygls.exceptions import JsonRpcException
    from pygls.lsp.server import LanguageServer
    from pygls.protocol import LanguageServerProtocol, lsp_method
    from pygls.uris import to_fs_path
except ModuleNotFoundError:
    raise click.ClickException(extras.needs("the language server", "editors")) from None

from .evaluation import evaluated
from .language.diagnostics import Diagnostic, SceneError
from .language.formatter import format
from .symbols import Completion, Occurrence, Symbols

#: Larger trees are evaluated by ``prosim translate --check`` alone.
LARGEST = 1000
#: Seconds without a keystroke after which a text is read again.
DELAY = 0.03
#: The most words that are offered at once.
WORDS = 500
KINDS = {
    "statement": lsp.CompletionItemKind.Keyword,
    "keyword": lsp.CompletionItemKind.Property,
    "metal": lsp.CompletionItemKind.Color,
    "glass": lsp.CompletionItemKind.Color,
    "texture": lsp.CompletionItemKind.Color,
    "solid": lsp.CompletionItemKind.Class,
    "index": lsp.CompletionItemKind.Value,
    "name": lsp.CompletionItemKind.Variable,
    "function": lsp.CompletionItemKind.Function,
}
#: What ends a line by the protocol. For Python's ``splitlines`` others do as well, such as the form feed.
NEWLINE = re.compile(r"\r\n?|\n")
ENCODINGS = {"utf-8": ("utf-8", 1), "utf-16": ("utf-16-le", 2), "utf-32": ("utf-32-le", 4)}


class Text:
    """A text as an editor has it: in lines, and columns of units of an ``encoding``, both from 0."""

    def __init__(self, text: str, encoding: str = "utf-16") -> None:
        self.text, self.encoding = text, encoding

    @cached_property
    def lines(self) -> list[int]:
        """Offsets at which the lines begin."""
        return [0, *(newline.end() for newline in NEWLINE.finditer(self.text))]

    @property
    def newline(self) -> str:
        """What ends the first line."""
        found = NEWLINE.search(self.text)
        return found[0] if found else "\n"

    @cached_property
    def scene(self) -> str:
        """The text as if it was read from a file, but each character has its place: CR LF stays, others are LF."""
        text = " " + self.text[1:] if self.text.startswith("\ufeff") else self.text
        return re.sub(r"\r(?!\n)", "\n", text) if "\r" in text else text

    def offset(self, line: int, column: int) -> int:
        """The offset of a position; of one behind the end of a line, or of the text, that end."""
        if line >= len(self.lines):
            return len(self.text)
        start = self.lines[line]
        found = NEWLINE.search(self.text, start)
        inside = self.text[start : found.start() if found else len(self.text)]
        if inside.isascii():
            return start + min(column, len(inside))
        return start + bisect_right(range(1, len(inside) + 1), column, key=lambda n: self._units(inside[:n]))

    def position(self, offset: int) -> tuple[int, int]:
        """The line and column of an offset."""
        line = bisect_right(self.lines, offset) - 1
        return line, self._units(self.text[self.lines[line] : offset])

    def changed(self, start: tuple[int, int], end: tuple[int, int], text: str) -> "Text":
        """The text with another one in the place of what stands from ``start`` to ``end``."""
        first = self.offset(*start)
        last = max(first, self.offset(*end))
        return Text(self.text[:first] + text + self.text[last:], self.encoding)

    def _units(self, text: str) -> int:
        """How many units a text has."""
        codec, size = ENCODINGS[self.encoding]
        return len(text) if text.isascii() else len(text.encode(codec, "surrogatepass")) // size


class Opened:
    """A document that an editor has open, and what the server is still to do for it."""

    def __init__(self, document: lsp.TextDocumentItem, encoding: str) -> None:
        self.uri, self.version = document.uri, document.version
        path = to_fs_path(document.uri)
        self.path = Path(path) if path else None
        self.text = Text(document.text, encoding)
        self._symbols: Symbols | None = None
        self.evaluation: asyncio.Task[None] | None = None
        self.timer: asyncio.TimerHandle | None = None

    @property
    def symbols(self) -> Symbols:
        """The text as it is now, read."""
        if self._symbols is None or self._symbols.text != self.text.scene:
            self._symbols = Symbols(self.text.scene, self.path or self.uri)
        return self._symbols

    def cancel(self) -> None:
        """Ends what has been begun because of the text as it was."""
        for one in (self.evaluation, self.timer):
            if one is not None:
                one.cancel()

    def change(self, change: lsp.DidChangeTextDocumentParams) -> None:
        """Changes parts of the text, or the whole."""
        for one in change.content_changes:
            if isinstance(one, lsp.TextDocumentContentChangePartial):
                start, end = one.range.start, one.range.end
                self.text = self.text.changed((start.line, start.character), (end.line, end.character), one.text)
            else:
                self.text = Text(one.text, self.text.encoding)
        self.version = change.text_document.version

    def offset(self, position: lsp.Position) -> int:
        """A position of the protocol as an offset."""
        return self.text.offset(position.line, position.character)

    def range(self, start: int, end: int) -> lsp.Range:
        """Offsets as the protocol has them."""
        return lsp.Range(lsp.Position(*self.text.position(start)), lsp.Position(*self.text.position(end)))

    def locations(self, found: list[Occurrence]) -> list[lsp.Location]:
        """Occurrences as the protocol has them."""
        return [lsp.Location(self.uri, self.range(one.start, one.end)) for one in found]

    def diagnostic(self, one: Diagnostic) -> lsp.Diagnostic:
        """An error or a warning as the protocol has it."""
        severity = lsp.DiagnosticSeverity.Error if one.error else lsp.DiagnosticSeverity.Warning
        place = self.range(one.start, max(one.end, one.start + 1))
        return lsp.Diagnostic(place, one.reason, severity=severity, code=one.code or None, source="prosim")


class Protocol(LanguageServerProtocol):
    """pygls's own, but for the texts of documents, whose lines pygls ends where Python does."""

    _server: "SceneServer"

    @lsp_method(lsp.TEXT_DOCUMENT_DID_OPEN)
    def lsp_text_document__did_open(self, params: lsp.DidOpenTextDocumentParams) -> None:
        """Takes a document, and publishes all diagnostics, also of its tree."""
        self._server.forget(params.text_document.uri)
        encoding = lsp.PositionEncodingKind(self._server.workspace.position_encoding or "utf-16").value
        document = Opened(params.text_document, encoding)
        self._server.documents[unquote(document.uri)] = document
        self._server.diagnose(document, whole=True)

    @lsp_method(lsp.TEXT_DOCUMENT_DID_CHANGE)
    def lsp_text_document__did_change(self, params: lsp.DidChangeTextDocumentParams) -> None:
        """Changes a document, and publishes the diagnostics soon."""
        if document := self._server.document(params.text_document):
            document.change(params)
            self._server.diagnose_soon(document)

    @lsp_method(lsp.TEXT_DOCUMENT_DID_CLOSE)
    def lsp_text_document__did_close(self, params: lsp.DidCloseTextDocumentParams) -> None:
        """Forgets a document and its diagnostics."""
        if self._server.forget(params.text_document.uri):
            self._server.text_document_publish_diagnostics(lsp.PublishDiagnosticsParams(params.text_document.uri, []))


class SceneServer(LanguageServer):
    """A server, and the documents that are open."""

    def __init__(self) -> None:
        super().__init__("prosim", version("mitsuba-prosim"), protocol_cls=Protocol)
        self.documents: dict[str, Opened] = {}

    def document(self, named: lsp.TextDocumentIdentifier | lsp.VersionedTextDocumentIdentifier) -> Opened | None:
        """A document, if it is open."""
        return self.documents.get(unquote(named.uri))

    def forget(self, uri: str) -> bool:
        """Forgets a document; whether there was one."""
        document = self.documents.pop(unquote(uri), None)
        if document is not None:
            document.cancel()
        return document is not None

    def diagnose_soon(self, document: Opened) -> None:
        """Publishes the diagnostics of a document when nothing has been typed for a moment."""
        document.cancel()
        document.timer = asyncio.get_running_loop().call_later(DELAY, self.diagnose, document, False)

    def diagnose(self, document: Opened, whole: bool) -> None:
        """Publishes the diagnostics of a document; ``whole``: later again, with those of its evaluated tree."""
        document.cancel()
        symbols = document.symbols
        self.publish(document, symbols.diagnostics)
        if whole and symbols.document is not None and len(symbols.document.scene.csg) <= LARGEST:
            document.evaluation = asyncio.get_running_loop().create_task(self.evaluate(document, symbols.diagnostics))

    async def evaluate(self, document: Opened, found: list[Diagnostic]) -> None:
        """Publishes the diagnostics of the tree beside those ``found``; cancelled when the document changes."""
        if more := await evaluated(document.text.scene, document.path):
            self.publish(document, [*found, *more])

    def publish(self, document: Opened, found: list[Diagnostic]) -> None:
        """Publishes diagnostics."""
        diagnostics = [document.diagnostic(one) for one in found]
        self.text_document_publish_diagnostics(
            lsp.PublishDiagnosticsParams(document.uri, diagnostics, document.version)
        )

    def symbol(self, named: lsp.TextDocumentIdentifier, position: lsp.Position) -> tuple[Opened, Occurrence] | None:
        """The document and the symbol at a place."""
        document = self.document(named)
        here = document.symbols.at(document.offset(position)) if document else None
        return (document, here) if document and here else None


server = SceneServer()


@click.command("language-server")
def language_server() -> None:
    """Help an editor with scenes: errors while you write, completion, meanings, renaming, layout.

    An editor starts it, and speaks with it by standard input and output.
    """
    server.start_io()
    gc.freeze()  # Python would look at all that there is for garbage before it ends: seconds, after a long scene


@server.feature(lsp.TEXT_DOCUMENT_DID_SAVE)
def saved(ls: SceneServer, params: lsp.DidSaveTextDocumentParams) -> None:
    """Publishes all diagnostics, also of the tree."""
    if document := ls.document(params.text_document):
        ls.diagnose(document, whole=True)


@server.feature(lsp.TEXT_DOCUMENT_COMPLETION, lsp.CompletionOptions(trigger_characters=["$", "-"]))
def complete(ls: SceneServer, params: lsp.CompletionParams) -> lsp.CompletionList:
    """The words that fit; of very many those that have what is typed already, and the editor asks again with more."""
    document = ls.document(params.text_document)
    if document is None:
        return lsp.CompletionList(False, [])
    offset = document.offset(params.position)
    found = document.symbols.completions(offset)
    incomplete = len(found) > WORDS
    if incomplete:
        typed = document.symbols.text[found[0].start : offset].casefold()
        found = [one for one in found if typed in one.label.casefold()][:WORDS]
    return lsp.CompletionList(incomplete, [_completion(one, document.range(one.start, offset)) for one in found])


def _completion(one: Completion, place: lsp.Range) -> lsp.CompletionItem:
    """A word as the protocol has it. Indices are in their order as numbers."""
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
    """What a word means."""
    document = ls.document(params.text_document)
    if document is None or (found := document.symbols.hover(document.offset(params.position))) is None:
        return None
    start, end, text = found
    return lsp.Hover(lsp.MarkupContent(lsp.MarkupKind.Markdown, text), document.range(start, end))


@server.feature(lsp.TEXT_DOCUMENT_DEFINITION)
def definition(ls: SceneServer, params: lsp.DefinitionParams) -> list[lsp.Location]:
    """SURFACE and TRANSFORM of an index, TEXTURE of a texture, DEFAULT of a name."""
    if (found := ls.symbol(params.text_document, params.position)) is None:
        return []
    document, here = found
    return document.locations([one for one in document.symbols.occurrences(here.symbol) if one.defines])


@server.feature(lsp.TEXT_DOCUMENT_REFERENCES)
def references(ls: SceneServer, params: lsp.ReferenceParams) -> list[lsp.Location]:
    """Where an index, a texture or a name stands."""
    if (found := ls.symbol(params.text_document, params.position)) is None:
        return []
    document, here = found
    return document.locations(document.symbols.occurrences(here.symbol))


@server.feature(lsp.TEXT_DOCUMENT_PREPARE_RENAME)
def prepare_rename(ls: SceneServer, params: lsp.PrepareRenameParams) -> lsp.Range | None:
    """What would be renamed."""
    found = ls.symbol(params.text_document, params.position)
    return found[0].range(found[1].start, found[1].end) if found else None


@server.feature(lsp.TEXT_DOCUMENT_RENAME, lsp.RenameOptions(prepare_provider=True))
def rename(ls: SceneServer, params: lsp.RenameParams) -> lsp.WorkspaceEdit | None:
    """Another name for an index, a texture or a name, everywhere; raises JsonRpcException, which says why not."""
    if (found := ls.symbol(params.text_document, params.position)) is None:
        return None
    document, here = found
    try:
        everywhere = document.symbols.renamed(here.symbol, params.new_name)
    except ValueError as error:
        raise JsonRpcException(str(error), lsp.LSPErrorCodes.RequestFailed) from None
    new = "$" + params.new_name.removeprefix("$") if here.symbol.kind == "name" else params.new_name
    edits = [lsp.TextEdit(document.range(one.start, one.end), new) for one in everywhere]
    return lsp.WorkspaceEdit({document.uri: edits})


@server.feature(lsp.TEXT_DOCUMENT_FORMATTING)
def formatting(ls: SceneServer, params: lsp.DocumentFormattingParams) -> list[lsp.TextEdit] | None:
    """The canonical layout; nothing where the text is wrong."""
    document = ls.document(params.text_document)
    if document is None:
        return None
    text = document.text.scene
    lines = text.replace("\r\n", "\n")
    try:
        tidy = format(lines, document.path or document.uri)
    except SceneError:
        return None
    new = tidy.replace("\n", document.text.newline)
    return [lsp.TextEdit(document.range(0, len(text)), new)] if tidy != lines else []
