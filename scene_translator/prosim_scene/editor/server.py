"""The Language Server Protocol: what the other files know, told to an editor."""

import asyncio
import gc
from importlib.metadata import version
from time import perf_counter
from urllib.parse import unquote

from lsprotocol import types as lsp
from pygls.exceptions import JsonRpcException
from pygls.lsp.server import LanguageServer
from pygls.protocol import LanguageServerProtocol, lsp_method

from ..collector import still
from ..language.formatter import format
from ..language.judging import judge
from ..language.messages import Said, SceneError
from . import apart, completing, places
from .opened import Opened

#: Larger trees are evaluated by ``prosim translate --check`` alone.
LARGEST = 1000

#: Seconds that at most pass before what is wrong with a long text is looked for, if no more is typed.
SOON = 0.05

#: So many words are offered at once.
WORDS = 500

KINDS = {
    "statement": lsp.CompletionItemKind.Keyword,
    "keyword": lsp.CompletionItemKind.Property,
    "metal": lsp.CompletionItemKind.Color,
    "glass": lsp.CompletionItemKind.Color,
    "texture": lsp.CompletionItemKind.Color,
    "index": lsp.CompletionItemKind.Value,
    "name": lsp.CompletionItemKind.Variable,
    "function": lsp.CompletionItemKind.Function,
}


class Protocol(LanguageServerProtocol):
    """pygls's own, but for the texts of documents: its lines end where Python's do, and not where an editor's do."""

    _server: "SceneServer"

    @lsp_method(lsp.TEXT_DOCUMENT_DID_OPEN)
    def lsp_text_document__did_open(self, params: lsp.DidOpenTextDocumentParams) -> None:
        """Says all that is wrong, also what is seen only when the tree is evaluated."""
        self._server.open(params.text_document)

    @lsp_method(lsp.TEXT_DOCUMENT_DID_CHANGE)
    def lsp_text_document__did_change(self, params: lsp.DidChangeTextDocumentParams) -> None:
        """Says what is wrong with the text."""
        document = self._server.document(params.text_document)
        if document is not None:
            document.change(params)
            self._server.tell_soon(document)

    @lsp_method(lsp.TEXT_DOCUMENT_DID_CLOSE)
    def lsp_text_document__did_close(self, params: lsp.DidCloseTextDocumentParams) -> None:
        """Forgets a document, and what was said of it."""
        self._server.close(params.text_document)


class SceneServer(LanguageServer):
    """A server, and the documents that are open."""

    def __init__(self) -> None:
        super().__init__("prosim", version("mitsuba-prosim"), protocol_cls=Protocol)
        self.documents: dict[str, Opened] = {}

    def document(self, named: lsp.TextDocumentIdentifier | lsp.VersionedTextDocumentIdentifier) -> Opened | None:
        """A document, if it is open."""
        return self.documents.get(unquote(named.uri))

    def open(self, item: lsp.TextDocumentItem) -> None:
        """Takes a document, and says all that is wrong with it."""
        self.forget(item.uri)
        encoding = lsp.PositionEncodingKind(self.workspace.position_encoding or "utf-16").value
        document = self.documents[unquote(item.uri)] = Opened(item, encoding)
        self.tell(document, whole=True)

    def close(self, named: lsp.TextDocumentIdentifier) -> None:
        """Forgets a document; nothing is wrong with it any more."""
        if self.forget(named.uri):
            self.text_document_publish_diagnostics(lsp.PublishDiagnosticsParams(named.uri, []))

    def forget(self, uri: str) -> bool:
        """Forgets a document; whether there was one."""
        document = self.documents.pop(unquote(uri), None)
        if document is not None:
            document.rest()
        return document is not None

    def tell_soon(self, document: Opened) -> None:
        """Says what is wrong with a document when all has been taken that has been typed by now."""
        document.rest()
        delay = min(document.took, SOON)
        document.telling = asyncio.get_running_loop().call_later(delay, self.tell, document, False)

    def tell(self, document: Opened, whole: bool) -> None:
        """Says what is wrong with a document; ``whole``: and then what its tree shows when evaluated."""
        document.rest()
        begun = perf_counter()
        with still():
            found, scene = judge(document.reading)
        self.publish(document, found)
        document.took = perf_counter() - begun
        if whole and scene is not None and len(scene.scene.csg) <= LARGEST:
            document.evaluation = asyncio.get_running_loop().create_task(self.evaluate(document, found))

    async def evaluate(self, document: Opened, found: list[Said]) -> None:
        """Says beside what was ``found`` what only the tree shows; it is cancelled when the document changes."""
        more = await apart.evaluated(document.reading.source.text, document.path)
        if more:
            self.publish(document, [*found, *more])

    def publish(self, document: Opened, found: list[Said]) -> None:
        """Says what was found to be wrong."""
        diagnostics = [document.diagnostic(one) for one in found]
        self.text_document_publish_diagnostics(
            lsp.PublishDiagnosticsParams(document.uri, diagnostics, document.version)
        )


server = SceneServer()


def serve() -> None:
    """Speaks with an editor by standard input and output, until that says it is the end."""
    server.start_io()
    gc.freeze()  # Python would look at all that there is for garbage before it ends: seconds, after a long scene


@server.feature(lsp.TEXT_DOCUMENT_DID_SAVE)
def saved(ls: SceneServer, params: lsp.DidSaveTextDocumentParams) -> None:
    """Says all that is wrong, also what is seen only when the tree is evaluated."""
    document = ls.document(params.text_document)
    if document is not None:
        ls.tell(document, whole=True)


@server.feature(lsp.TEXT_DOCUMENT_COMPLETION, lsp.CompletionOptions(trigger_characters=["$", "-"]))
def complete(ls: SceneServer, params: lsp.CompletionParams) -> lsp.CompletionList:
    """The words that fit; of very many those that have what is typed already, and the editor asks again with more."""
    document = ls.document(params.text_document)
    if document is None:
        return lsp.CompletionList(False, [])
    offset = document.offset(params.position)
    found = completing.completions(document.reading, offset)
    incomplete = len(found) > WORDS
    if incomplete:
        typed = document.reading.source.text[found[0].start : offset].casefold()
        found = [one for one in found if typed in one.label.casefold()][:WORDS]
    place = document.range(found[0].start, offset) if found else None
    return lsp.CompletionList(incomplete, [_completion(one, place) for one in found if place is not None])


def _completion(one: completing.Completion, place: lsp.Range) -> lsp.CompletionItem:
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
    if document is None or (found := completing.hover(document.reading, document.offset(params.position))) is None:
        return None
    start, end, text = found
    return lsp.Hover(lsp.MarkupContent(lsp.MarkupKind.Markdown, text), document.range(start, end))


def symbol(
    ls: SceneServer, named: lsp.TextDocumentIdentifier, position: lsp.Position
) -> tuple[Opened, places.Occurrence] | None:
    """The index, texture or name at a place."""
    document = ls.document(named)
    if document is None or (here := places.at(document.reading, document.offset(position))) is None:
        return None
    return document, here


@server.feature(lsp.TEXT_DOCUMENT_DEFINITION)
def definition(ls: SceneServer, params: lsp.DefinitionParams) -> list[lsp.Location]:
    """SURFACE and TRANSFORM of an index, TEXTURE of a texture, DEFAULT of a name."""
    if (found := symbol(ls, params.text_document, params.position)) is None:
        return []
    document, here = found
    return document.locations(places.definitions(document.reading, here.symbol))


@server.feature(lsp.TEXT_DOCUMENT_REFERENCES)
def references(ls: SceneServer, params: lsp.ReferenceParams) -> list[lsp.Location]:
    """Where an index, a texture or a name is used."""
    if (found := symbol(ls, params.text_document, params.position)) is None:
        return []
    document, here = found
    return document.locations(list(places.occurrences(document.reading, here.symbol)))


@server.feature(lsp.TEXT_DOCUMENT_PREPARE_RENAME)
def prepare_rename(ls: SceneServer, params: lsp.PrepareRenameParams) -> lsp.Range | None:
    """What would be renamed."""
    if (found := symbol(ls, params.text_document, params.position)) is None:
        return None
    document, here = found
    return document.range(here.start, here.end)


@server.feature(lsp.TEXT_DOCUMENT_RENAME, lsp.RenameOptions(prepare_provider=True))
def rename(ls: SceneServer, params: lsp.RenameParams) -> lsp.WorkspaceEdit | None:
    """Another name for an index, a texture or a name, everywhere; raises JsonRpcException, which says why not."""
    if (found := symbol(ls, params.text_document, params.position)) is None:
        return None
    document, here = found
    try:
        everywhere = places.renamed(document.reading, here.symbol, params.new_name)
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
    text = document.reading.source.text
    lines = text.replace("\r\n", "\n")
    try:
        tidy = format(lines, document.path or document.uri)
    except SceneError:
        return None
    new = tidy.replace("\n", document.buffer.newline)
    return [lsp.TextEdit(document.range(0, len(text)), new)] if tidy != lines else []
