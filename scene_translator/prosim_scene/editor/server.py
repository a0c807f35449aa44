"""The Language Server Protocol: what the other files know, told to an editor."""

import gc
from importlib.metadata import version
from pathlib import Path
from typing import Any

from lsprotocol import types as lsp
from pygls.lsp.server import LanguageServer
from pygls.uris import to_fs_path
from pygls.workspace import TextDocument

from ..collector import still
from ..language.formatter import format
from ..language.judging import judge
from ..language.messages import Said, SceneError
from ..language.reading import Reading
from . import completing, places
from .evaluating import evaluate

#: Larger trees are evaluated by ``prosim translate --check`` alone: an editor would wait.
LARGEST = 1000

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


class SceneServer(LanguageServer):
    """A server, and what it has read of each document that is open."""

    def __init__(self) -> None:
        super().__init__("prosim", version("mitsuba-prosim"))
        self.readings: dict[str, Reading] = {}

    def document(self, uri: str) -> TextDocument:
        """A document as it is now."""
        return self.workspace.get_text_document(uri)

    def reading(self, uri: str) -> Reading:
        """A document, read as it is now."""
        text = self.document(uri).source
        if uri not in self.readings:
            self.readings[uri] = Reading(text, to_fs_path(uri) or uri)
        elif self.readings[uri].source.text != text:
            self.readings[uri].change(text)
        return self.readings[uri]

    def tell(self, uri: str, whole: bool) -> None:
        """Tells what is wrong with a document; ``whole``: the tree is evaluated as well."""
        with still():
            found, scene = judge(self.reading(uri))
        path = to_fs_path(uri)
        if whole and scene is not None and len(scene.scene.csg) <= LARGEST:
            found = [*found, *evaluate(scene, Path(path).parent if path else None)]
        self.text_document_publish_diagnostics(
            lsp.PublishDiagnosticsParams(
                uri=uri, version=self.document(uri).version, diagnostics=[self.diagnostic(uri, one) for one in found]
            )
        )

    def diagnostic(self, uri: str, one: Said) -> lsp.Diagnostic:
        """An error or a warning."""
        severity = lsp.DiagnosticSeverity.Error if one.error else lsp.DiagnosticSeverity.Warning
        place = self.range(uri, one.start, max(one.end, one.start + 1))
        return lsp.Diagnostic(place, one.reason, severity=severity, source="prosim")

    def range(self, uri: str, start: int, end: int) -> lsp.Range:
        """Offsets as the protocol has them."""
        return lsp.Range(self.position(uri, start), self.position(uri, end))

    def position(self, uri: str, offset: int) -> lsp.Position:
        """An offset as the protocol has it."""
        source = self.readings[uri].source
        line, column = source.line_column(offset)
        before = source.text[offset - column + 1 : offset]
        return lsp.Position(line - 1, self.workspace.position_codec.client_num_units(before))

    def offset(self, uri: str, position: lsp.Position) -> int:
        """A position of the protocol as an offset."""
        return self.document(uri).offset_at_position(position)


server = SceneServer()


def serve() -> None:
    """Speaks with an editor by standard input and output, until that says it is the end."""
    server.start_io()
    gc.freeze()  # Python would look at all that there is for garbage before it ends: seconds, after a long scene


@server.feature(lsp.TEXT_DOCUMENT_DID_OPEN)
@server.feature(lsp.TEXT_DOCUMENT_DID_SAVE)
def opened(ls: SceneServer, params: Any) -> None:
    """Says all that is wrong, also what is seen only when the tree is evaluated."""
    ls.tell(params.text_document.uri, whole=True)


@server.feature(lsp.TEXT_DOCUMENT_DID_CHANGE)
def changed(ls: SceneServer, params: lsp.DidChangeTextDocumentParams) -> None:
    """Says what is wrong with the text."""
    ls.tell(params.text_document.uri, whole=False)


@server.feature(lsp.TEXT_DOCUMENT_DID_CLOSE)
def closed(ls: SceneServer, params: lsp.DidCloseTextDocumentParams) -> None:
    """Forgets a document."""
    ls.readings.pop(params.text_document.uri, None)


@server.feature(lsp.TEXT_DOCUMENT_COMPLETION, lsp.CompletionOptions(trigger_characters=["$", "-"]))
def complete(ls: SceneServer, params: lsp.CompletionParams) -> list[lsp.CompletionItem]:
    """The words that fit."""
    uri = params.text_document.uri
    reading, offset = ls.reading(uri), ls.offset(uri, params.position)
    return [
        lsp.CompletionItem(
            label=one.label,
            kind=KINDS[one.kind],
            detail=one.detail or None,
            documentation=lsp.MarkupContent(lsp.MarkupKind.Markdown, one.documentation) if one.documentation else None,
            sort_text=f"{one.rank}{one.label}",
            text_edit=lsp.TextEdit(ls.range(uri, one.start, offset), one.label),
        )
        for one in completing.completions(reading, offset)
    ]


@server.feature(lsp.TEXT_DOCUMENT_HOVER)
def hover(ls: SceneServer, params: lsp.HoverParams) -> lsp.Hover | None:
    """What a word means."""
    uri = params.text_document.uri
    found = completing.hover(ls.reading(uri), ls.offset(uri, params.position))
    if found is None:
        return None
    start, end, text = found
    return lsp.Hover(lsp.MarkupContent(lsp.MarkupKind.Markdown, text), ls.range(uri, start, end))


def locations(ls: SceneServer, uri: str, found: list[places.Occurrence]) -> list[lsp.Location]:
    """Occurrences as the protocol has them."""
    return [lsp.Location(uri, ls.range(uri, one.start, one.end)) for one in found]


@server.feature(lsp.TEXT_DOCUMENT_DEFINITION)
def definition(ls: SceneServer, params: lsp.DefinitionParams) -> list[lsp.Location]:
    """SURFACE and TRANSFORM of an index, TEXTURE of a texture, DEFAULT of a name."""
    uri = params.text_document.uri
    reading = ls.reading(uri)
    here = places.at(reading, ls.offset(uri, params.position))
    return locations(ls, uri, places.definitions(reading, here.symbol)) if here else []


@server.feature(lsp.TEXT_DOCUMENT_REFERENCES)
def references(ls: SceneServer, params: lsp.ReferenceParams) -> list[lsp.Location]:
    """Where an index, a texture or a name is used."""
    uri = params.text_document.uri
    reading = ls.reading(uri)
    here = places.at(reading, ls.offset(uri, params.position))
    return locations(ls, uri, list(places.occurrences(reading, here.symbol))) if here else []


@server.feature(lsp.TEXT_DOCUMENT_PREPARE_RENAME)
def prepare_rename(ls: SceneServer, params: lsp.PrepareRenameParams) -> lsp.Range | None:
    """What would be renamed."""
    uri = params.text_document.uri
    here = places.at(ls.reading(uri), ls.offset(uri, params.position))
    return ls.range(uri, here.start, here.end) if here else None


@server.feature(lsp.TEXT_DOCUMENT_RENAME, lsp.RenameOptions(prepare_provider=True))
def rename(ls: SceneServer, params: lsp.RenameParams) -> lsp.WorkspaceEdit | None:
    """Another name for an index, a texture or a name, everywhere."""
    uri = params.text_document.uri
    reading = ls.reading(uri)
    here = places.at(reading, ls.offset(uri, params.position))
    if here is None:
        return None
    try:
        found = places.renamed(reading, here.symbol, params.new_name)
    except ValueError as error:
        ls.window_show_message(lsp.ShowMessageParams(lsp.MessageType.Error, str(error)))
        return None
    new = "$" + params.new_name.removeprefix("$") if here.symbol.kind == "name" else params.new_name
    return lsp.WorkspaceEdit({uri: [lsp.TextEdit(ls.range(uri, one.start, one.end), new) for one in found]})


@server.feature(lsp.TEXT_DOCUMENT_FORMATTING)
def formatting(ls: SceneServer, params: lsp.DocumentFormattingParams) -> list[lsp.TextEdit] | None:
    """The canonical layout; nothing where the text is wrong."""
    uri = params.text_document.uri
    text = ls.reading(uri).source.text
    try:
        tidy = format(text, to_fs_path(uri) or uri)
    except SceneError:
        return None
    return [lsp.TextEdit(ls.range(uri, 0, len(text)), tidy)] if tidy != text else []
