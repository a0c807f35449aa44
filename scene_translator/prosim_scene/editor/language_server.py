"""The command ``prosim language-server``, which connects the module ``symbols`` to an editor by the Language Server
Protocol (LSP).
"""

import asyncio
import gc
import re
from collections.abc import Callable
from functools import cached_property
from importlib.metadata import version
from typing import Any, TypeVar
from urllib.parse import unquote

import click

from .. import extras

try:
    from lsprotocol import types as lsp
    from pygls.exceptions import JsonRpcInvalidParams
    from pygls.lsp.server import LanguageServer
    from pygls.uris import to_fs_path
    from pygls.workspace import TextDocument
except ModuleNotFoundError:
    raise click.ClickException(extras.needs("the language server", "editors")) from None

from ..language.diagnostics import Problem, SceneError
from ..language.formatter import format
from .evaluation import evaluate_in_process
from .symbols import Symbols

#: The largest number of nodes of a CSG tree that the server evaluates; ``prosim translate --check`` has no limit.
LARGEST = 1000
#: The delay in seconds between the last keystroke and the next analysis of the text.
DELAY = 0.01
#: The number of new objects after which Python searches for garbage. The objects of a text have no reference cycles, so
#: Python frees them without a search, which would take a quarter of the time of a keystroke.
COLLECTION = 1_000_000


class OpenDocument:
    """A version of an open document; ``pending`` is the task or timer that will publish more diagnostics."""

    def __init__(self, document: TextDocument) -> None:
        self.uri, self.version, self.text = document.uri, document.version, document.source
        self.filename, self.codec = to_fs_path(document.uri) or document.uri, document.position_codec
        # The text is changed as in a file that is read, but all offsets stay the same: a lone CR becomes LF, CR LF is
        # kept, and a byte order mark becomes a space that has as many code units.
        self.scene_text = re.sub(r"\r(?!\n)", "\n", re.sub("^\ufeff", "\u2003", self.text))
        self.pending: asyncio.Task[None] | asyncio.TimerHandle | None = None

    @cached_property
    def symbols(self) -> Symbols:
        """The symbols of the document. The first use of this property analyses the text of the document."""
        return Symbols(self.scene_text, self.filename)

    @cached_property
    def lines(self) -> list[str]:
        """The lines of the text. The codec clamps a position to the line end, so the last line gets one, too."""
        return [f"{line}\n" for line in self.symbols.text.split("\n")]

    def offset(self, position: lsp.Position) -> int:
        """Converts an LSP position to an offset; beyond the end of its line or text, that end."""
        at, source = self.codec.position_from_client_units(self.lines, position), self.symbols.reader.source
        return min(source.line_starts[at.line] + at.character, len(source.text))

    def range(self, start: int, end: int) -> lsp.Range:
        """Converts the text offsets ``start`` and ``end`` to an LSP range."""
        numbers = map(self.symbols.reader.source.line_column, (start, end))  # of lines and columns, from 1
        positions = [lsp.Position(line - 1, column - 1) for line, column in numbers]
        return lsp.Range(*(self.codec.position_to_client_units(self.lines, position) for position in positions))

    def diagnostic(self, problem: Problem) -> lsp.Diagnostic:
        """Converts a problem to an LSP diagnostic of at least one character; without a position, at the beginning."""
        severity = lsp.DiagnosticSeverity.Error if isinstance(problem, SceneError) else lsp.DiagnosticSeverity.Warning
        start, end = problem.span or (0, 1)
        range_ = self.range(start, max(end, start + 1))
        return lsp.Diagnostic(range_, problem.reason, severity=severity, code=problem.code or None, source="prosim")


class SceneServer(LanguageServer):
    """The language server, which stores the documents that are open in the editor."""

    def __init__(self) -> None:
        # The editor sends the whole text after each change, because the reader needs the whole text.
        super().__init__("prosim", version("mitsuba-prosim"), text_document_sync_kind=lsp.TextDocumentSyncKind.Full)
        self.documents: dict[str, OpenDocument] = {}

    def update(self, uri: str) -> OpenDocument | None:
        """Returns the editor's current version of ``uri``, or None if it is not open; what is pending for the stored
        version is cancelled.
        """
        self.close(uri)
        if {uri, unquote(uri)}.isdisjoint(self.workspace.text_documents):
            return None
        self.documents[uri] = OpenDocument(self.workspace.get_text_document(uri))
        return self.documents[uri]

    def close(self, uri: str) -> None:
        """Removes a document, and cancels its pending task or timer."""
        document = self.documents.pop(uri, None)
        if document and document.pending:
            document.pending.cancel()

    async def evaluate(self, document: OpenDocument) -> None:
        """Evaluates the CSG tree in a process, and publishes all problems; none if that fails or takes too long."""
        problems = await evaluate_in_process(document.scene_text, document.filename)
        if problems is not None:
            self.publish(document, problems)

    def publish(self, document: OpenDocument, problems: list[Problem]) -> None:
        """Sends the errors and warnings about a document to the editor, where they replace earlier ones."""
        diagnostics = [document.diagnostic(problem) for problem in problems]
        params = lsp.PublishDiagnosticsParams(document.uri, diagnostics, document.version)
        self.text_document_publish_diagnostics(params)


server = SceneServer()
#: A function that answers a request about an open document.
Answer = TypeVar("Answer", bound=Callable[[OpenDocument, Any], Any])
#: Matches the suggestion at the end of an error: the text that should replace the wrong one.
SUGGESTION = re.compile(r"did you mean '([^']+)'|(?:write|written) ([A-Z]+|[\d.e-]+)$")


@click.command("language-server")
def language_server() -> None:
    """Help an editor with scenes: show errors while you type, complete and explain words, format the text.

    An editor starts this command, and communicates with it through standard input and output.
    """
    gc.freeze()  # modules stay until the end
    gc.set_threshold(COLLECTION)
    server.start_io()
    gc.freeze()  # avoids the garbage collection at exit, which takes seconds after a large scene


@server.feature(lsp.TEXT_DOCUMENT_DID_OPEN)
@server.feature(lsp.TEXT_DOCUMENT_DID_SAVE)
def opened(ls: SceneServer, params: lsp.DidOpenTextDocumentParams | lsp.DidSaveTextDocumentParams) -> None:
    """Publishes the diagnostics of an opened or saved document; those of its CSG tree follow, if it has no error and at
    most :data:`LARGEST` nodes.
    """
    if (document := ls.update(params.text_document.uri)) is None:
        return
    ls.publish(document, document.symbols.diagnostics)
    if document.symbols.document is not None and len(document.symbols.document.scene.csg) <= LARGEST:
        document.pending = asyncio.get_running_loop().create_task(ls.evaluate(document))


@server.feature(lsp.TEXT_DOCUMENT_DID_CHANGE)
def changed(ls: SceneServer, params: lsp.DidChangeTextDocumentParams) -> None:
    """Publishes the diagnostics when the user has stopped typing for :data:`DELAY` seconds."""
    if document := ls.update(params.text_document.uri):
        loop = asyncio.get_running_loop()
        document.pending = loop.call_later(DELAY, lambda: ls.publish(document, document.symbols.diagnostics))


@server.feature(lsp.TEXT_DOCUMENT_DID_CLOSE)
def closed(ls: SceneServer, params: lsp.DidCloseTextDocumentParams) -> None:
    """Handles a closed document: removes the document, and its diagnostics in the editor."""
    ls.close(params.text_document.uri)
    ls.text_document_publish_diagnostics(lsp.PublishDiagnosticsParams(params.text_document.uri, []))


def answers(method: str, options: object = None) -> Callable[[Answer], Answer]:
    """Registers a function that answers the request ``method`` about an open document, from this document and the
    parameters of the request. The answer about any other document is null.
    """

    def register(function: Answer) -> Answer:
        @server.feature(method, options)
        def answer(ls: SceneServer, params: Any) -> Any:
            document = ls.documents.get(params.text_document.uri)
            return None if document is None else function(document, params)

        return function

    return register


@answers(lsp.TEXT_DOCUMENT_COMPLETION, lsp.CompletionOptions(trigger_characters=["$", "-"]))
def complete(document: OpenDocument, params: lsp.CompletionParams) -> list[lsp.CompletionItem]:
    """Returns the completions at a position in a document: the words that the scene language allows there."""
    offset = document.offset(params.position)
    start, items = document.symbols.completions(offset)
    replaced = document.range(start, offset)
    for item in items:
        item.text_edit = lsp.TextEdit(replaced, item.label)
    return items


@answers(lsp.TEXT_DOCUMENT_HOVER)
def hover(document: OpenDocument, params: lsp.HoverParams) -> lsp.Hover | None:
    """Returns the meaning of the word at a position, or None if nothing is known about the word."""
    if (found := document.symbols.hover(document.offset(params.position))) is None:
        return None
    start, end, text = found
    return lsp.Hover(lsp.MarkupContent(lsp.MarkupKind.Markdown, text), document.range(start, end))


@answers(lsp.TEXT_DOCUMENT_DEFINITION)
@answers(lsp.TEXT_DOCUMENT_REFERENCES)
def locations(document: OpenDocument, params: lsp.DefinitionParams | lsp.ReferenceParams) -> list[lsp.Location]:
    """Returns the locations of a symbol's occurrences, or of its definitions: by SURFACE, TRANSFORM, TEXTURE, SOLID or
    DEFAULT. Empty without a symbol at the position.
    """
    all_occurrences = isinstance(params, lsp.ReferenceParams)
    if (at_position := document.symbols.occurrence_at(document.offset(params.position))) is None:
        return []
    occurrences = (one for one in document.symbols.table[at_position.symbol] if all_occurrences or one.defines)
    return [lsp.Location(document.uri, document.range(one.start, one.end)) for one in occurrences]


@answers(lsp.TEXT_DOCUMENT_FORMATTING)
def formatting(document: OpenDocument, params: lsp.DocumentFormattingParams) -> list[lsp.TextEdit] | None:
    """Returns an edit of the whole text to the canonical layout, with its line ends; empty if it has that already, None
    if :func:`.format` raises an error.
    """
    lines = document.scene_text.replace("\r\n", "\n")
    try:
        formatted = format(lines, document.filename)
    except SceneError:
        return None
    newline = re.search(r"\r\n?|\n", document.text)
    new = formatted.replace("\n", newline[0] if newline else "\n")
    return [lsp.TextEdit(document.range(0, len(document.text)), new)] if formatted != lines else []


@answers(lsp.TEXT_DOCUMENT_DOCUMENT_SYMBOL)
def outline(document: OpenDocument, _: lsp.DocumentSymbolParams) -> list[lsp.DocumentSymbol]:
    """Returns the statements of a document, for an outline."""
    kinds = {"DEFAULT": lsp.SymbolKind.Variable, "SOLID": lsp.SymbolKind.Class}
    return [
        lsp.DocumentSymbol(one.text, kinds.get(one.role, lsp.SymbolKind.Property), range_, range_)
        for one in document.symbols.statements
        for range_ in [document.range(one.start, one.end)]
    ]


@answers(lsp.TEXT_DOCUMENT_RENAME)
def rename(document: OpenDocument, params: lsp.RenameParams) -> lsp.WorkspaceEdit | None:
    """Returns the edits that rename the symbol at a position, or None; an invalid name is an error."""
    if (at_position := document.symbols.occurrence_at(document.offset(params.position))) is None:
        return None
    if (new_texts := document.symbols.renamed(at_position.symbol, params.new_name)) is None:
        raise JsonRpcInvalidParams(f"{params.new_name!r} is in use, or is not valid as the name of this symbol")
    edits = [lsp.TextEdit(document.range(start, end), text) for start, end, text in new_texts]
    return lsp.WorkspaceEdit(changes={document.uri: edits})


@answers(lsp.TEXT_DOCUMENT_CODE_ACTION)
def quick_fixes(document: OpenDocument, params: lsp.CodeActionParams) -> list[lsp.CodeAction]:
    """Returns an edit for each error in a range of a document whose message suggests another text."""
    start, end = document.offset(params.range.start), document.offset(params.range.end)
    actions = []
    for problem in document.symbols.diagnostics:
        suggestion = SUGGESTION.search(problem.reason)
        if suggestion and problem.span and problem.span.start <= end and problem.span.end >= start:
            text = suggestion[1] or suggestion[2]
            edit = lsp.WorkspaceEdit(changes={document.uri: [lsp.TextEdit(document.range(*problem.span), text)]})
            title, shown = f"Replace by {text}", [document.diagnostic(problem)]
            actions.append(lsp.CodeAction(title, lsp.CodeActionKind.QuickFix, shown, is_preferred=True, edit=edit))
    return actions
