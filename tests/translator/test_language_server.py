"""The language server, as an editor speaks with it."""

import asyncio
import gc
import json
import subprocess
import sys
import time

import prosim_scene
import pytest
import pytest_lsp
from lsprotocol import types as lsp
from prosim_scene import language_server as server
from prosim_scene.language_server import Opened
from pygls.exceptions import JsonRpcException
from test_editor import SCENE, large

URI = "file:///nowhere/scene.scn"
SERVER = [sys.executable, "-c", "from prosim_scene.language_server import language_server; language_server()"]

pytestmark = pytest.mark.asyncio(loop_scope="module")


@pytest_lsp.fixture(config=pytest_lsp.ClientServerConfig(server_command=SERVER), scope="module", loop_scope="module")
async def editor(lsp_client: pytest_lsp.LanguageClient):
    await lsp_client.initialize_session(
        lsp.InitializeParams(
            capabilities=pytest_lsp.client_capabilities("visual-studio-code"), root_uri="file:///nowhere"
        )
    )
    yield
    await lsp_client.shutdown_session()


async def opened(editor, text, uri=URI):
    """The diagnostics of a text that has been opened."""
    if uri in editor.diagnostics:
        editor.text_document_did_close(lsp.DidCloseTextDocumentParams(lsp.TextDocumentIdentifier(uri)))
        assert not await told(editor, uri)
    editor.diagnostics.pop(uri, None)
    editor.text_document_did_open(lsp.DidOpenTextDocumentParams(lsp.TextDocumentItem(uri, "scn", 1, text)))
    return await told(editor, uri)


async def told(editor, uri=URI):
    """What is published next."""
    editor.diagnostics.pop(uri, None)
    for _ in range(6000):
        if uri in editor.diagnostics:
            return editor.diagnostics[uri]
        await asyncio.sleep(0.005)
    raise TimeoutError(uri)


async def typed(editor, version, line, column, text, end=None):
    """The diagnostics after some text has taken the place of what is between two columns of a line."""
    place = lsp.Range(lsp.Position(line, column), lsp.Position(line, column if end is None else end))
    change = lsp.TextDocumentContentChangePartial(place, text)
    editor.text_document_did_change(
        lsp.DidChangeTextDocumentParams(lsp.VersionedTextDocumentIdentifier(version, URI), [change])
    )
    return await told(editor)


def position(text, word, shift=0):
    before = text[: text.index(word) + shift]
    return lsp.Position(before.count("\n"), len(before) - before.rfind("\n") - 1)


async def test_errors_come_and_go_as_one_types(editor):
    scene = SCENE.replace("NAME: a", "NAME: a (esfera é 🎈) NSAMPLES 3")
    assert not await opened(editor, scene)
    at = position(scene, "NSAMPLES 3")
    column = at.character + 1  # of UTF-16, in which the balloon takes two
    (wrong,) = await typed(editor, 2, at.line, column + 9, "3.5", column + 10)
    assert wrong.severity == lsp.DiagnosticSeverity.Error and wrong.source == "prosim"
    assert wrong.message.startswith("found '3.5' after NSAMPLES; expected a whole number")
    assert wrong.range == lsp.Range(lsp.Position(at.line, column + 9), lsp.Position(at.line, column + 12))
    assert not await typed(editor, 3, at.line, column + 9, "4", column + 12)
    (doubt,) = await typed(editor, 4, at.line, column - 1, " SURFACE 9 ")
    assert doubt.severity == lsp.DiagnosticSeverity.Warning and "no primitive has this index" in doubt.message


async def test_what_the_tree_comes_to_is_told_when_it_is_opened(editor):
    hidden = SCENE.replace("- SPHERE 1 CYLINDER 1", "SPHERE 1").replace(
        "SCALE 2 2 2", "SCALE .1 .1 .1 TRANSLATE .5 .5 .5"
    )
    assert not await opened(editor, hidden)
    assert [one.message for one in await told(editor)] == [
        "nothing is seen of SPHERE 1 (line 5): no face of it is left in the result"
    ]


def crowded():
    """As many spheres at one place take minutes."""
    names = " ".join(f"SPHERE {i}" for i in range(300))
    tables = "\n".join(f"SURFACE {i}\nTRANSFORM {i} TRANSLATE (0 {i / 1e4} {(i * i) % 97 / 1e3})" for i in range(300))
    return f"LIGHTS AREA position 9 9 9 raio 2\nCSG-TREE {'+ ' * 299}{names}\n{tables}\nEND\n"


async def test_nothing_waits_for_a_tree(editor):
    """What is wrong is told at once, and questions are answered, while it is evaluated."""
    text, begun = crowded(), time.perf_counter()
    assert not await opened(editor, text)
    await asyncio.sleep(0.2)  # the tree is being evaluated
    document = lsp.TextDocumentIdentifier(URI)
    hover = await editor.text_document_hover_async(lsp.HoverParams(document, position(text, "raio", 1)))
    assert "the radius" in hover.contents.value
    assert len(await typed(editor, 2, 0, 0, "x ")) == 1
    assert time.perf_counter() - begun < 20


async def test_a_tree_is_left_though_nobody_is_there_any_more():
    """A server that is killed ends no evaluation: that ends by itself."""
    scene = json.dumps({"text": crowded(), "path": None, "seconds": 0.5})
    command = [sys.executable, "-c", "from prosim_scene.evaluation import main; main()"]
    done = subprocess.run(command, check=False, input=scene, capture_output=True, text=True, timeout=40)
    assert done.returncode == 1 and not done.stdout and not done.stderr


async def test_what_is_closed_is_forgotten(editor):
    wrong = SCENE.replace("raio 2", "raio x")
    assert await opened(editor, wrong)
    document = lsp.TextDocumentIdentifier(URI)
    editor.text_document_did_close(lsp.DidCloseTextDocumentParams(document))
    assert not await told(editor)
    messages = len(editor.messages)
    editor.text_document_did_save(lsp.DidSaveTextDocumentParams(document))
    editor.text_document_did_change(
        lsp.DidChangeTextDocumentParams(
            lsp.VersionedTextDocumentIdentifier(3, URI), [lsp.TextDocumentContentChangeWholeDocument("x")]
        )
    )
    at = lsp.Position(0, 0)
    assert await editor.text_document_hover_async(lsp.HoverParams(document, at)) is None
    assert not (await editor.text_document_completion_async(lsp.CompletionParams(document, at))).items
    assert await editor.text_document_definition_async(lsp.DefinitionParams(document, at)) == []
    assert await editor.text_document_rename_async(lsp.RenameParams(document, at, "7")) is None
    options = lsp.FormattingOptions(4, True)
    assert await editor.text_document_formatting_async(lsp.DocumentFormattingParams(document, options)) is None
    assert len(editor.messages) == messages and not editor.diagnostics.pop(URI)


async def test_lines_end_where_an_editor_ends_them(editor):
    """At a form feed and the like Python ends a line, and an editor does not; a lone CR ends one for both."""
    for mark in ("\n", "\r\n", "\r"):
        text = ("\ufeff" + SCENE.replace("a remark", "a \f \u2028 \x85 remark 🎈")).replace("\n", mark)
        assert not await opened(editor, text)
        line = text.split(mark).index("TRANSFORM 0")
        (wrong,) = await typed(editor, 2, line, 0, "x", 1)
        assert "xRANSFORM" in wrong.message and wrong.range.start == lsp.Position(line, 0)
        assert not await typed(editor, 3, line, 0, "T", 1)
        options = lsp.FormattingOptions(4, True)
        (tidy,) = await editor.text_document_formatting_async(
            lsp.DocumentFormattingParams(lsp.TextDocumentIdentifier(URI), options)
        )
        expected = prosim_scene.format(text[1:].replace(mark, "\n"))
        assert tidy.new_text == expected.replace("\n", mark)
        assert tidy.range == lsp.Range(lsp.Position(0, 0), lsp.Position(text.count(mark), 0))


async def test_an_editor_completes_explains_and_finds(editor):
    await opened(editor, SCENE)
    document = lsp.TextDocumentIdentifier(URI)
    found = await editor.text_document_completion_async(lsp.CompletionParams(document, position(SCENE, "ouro", 2)))
    (gold,) = [one for one in found.items if one.label == "ouro"]
    assert gold.detail == "Au" and gold.text_edit.range.start == position(SCENE, "ouro")
    hover = await editor.text_document_hover_async(lsp.HoverParams(document, position(SCENE, "raio", 1)))
    assert "the radius" in hover.contents.value and hover.range.start == position(SCENE, "raio")
    at = position(SCENE, "SPHERE 1", 7)
    lines = [
        one.range.start.line for one in await editor.text_document_definition_async(lsp.DefinitionParams(document, at))
    ]
    assert lines == [7, 9]
    everywhere = await editor.text_document_references_async(
        lsp.ReferenceParams(lsp.ReferenceContext(include_declaration=True), document, at)
    )
    assert len(everywhere) == 4


async def test_of_very_many_indices_those_that_are_meant_are_offered(editor):
    text = "CSG-TREE CUBE 12\n" + "".join(f"SURFACE {i}\n" for i in range(1200)) + "END\n"
    await opened(editor, text)
    asked = lsp.CompletionParams(lsp.TextDocumentIdentifier(URI), lsp.Position(0, 16))
    found = await editor.text_document_completion_async(asked)
    assert found.is_incomplete and all("12" in one.label for one in found.items)
    in_order = [one.label for one in sorted(found.items, key=lambda one: one.sort_text)]
    assert in_order[:3] == ["12", "112", "120"] and len(in_order) == 32


async def test_an_editor_renames_and_lays_out(editor):
    await opened(editor, SCENE)
    document = lsp.TextDocumentIdentifier(URI)
    at = position(SCENE, "SPHERE 1", 7)
    assert await editor.text_document_prepare_rename_async(lsp.PrepareRenameParams(document, at)) is not None
    changed = await editor.text_document_rename_async(lsp.RenameParams(document, at, "12"))
    lines = SCENE.splitlines(keepends=True)
    for edit in reversed(changed.changes[URI]):
        start, end = edit.range.start, edit.range.end
        lines[start.line] = lines[start.line][: start.character] + edit.new_text + lines[start.line][end.character :]
    assert "".join(lines) == SCENE.replace("SPHERE 1 CYLINDER 1", "SPHERE 12 CYLINDER 12").replace(
        "SURFACE 1", "SURFACE 12"
    ).replace("TRANSFORM 1", "TRANSFORM 12")
    for new, why in ("0", "there already"), ("x y", "'x y' is no index"):
        with pytest.raises(JsonRpcException, match=why) as refused:
            await editor.text_document_rename_async(lsp.RenameParams(document, at, new))
        assert refused.value.code == lsp.LSPErrorCodes.RequestFailed
    options = lsp.FormattingOptions(4, True)
    (tidy,) = await editor.text_document_formatting_async(lsp.DocumentFormattingParams(document, options))
    assert tidy.new_text == prosim_scene.format(SCENE)


async def test_of_many_keystrokes_the_last_is_told(monkeypatch):
    ls, published = server.SceneServer(), []
    monkeypatch.setattr(ls, "publish", lambda document, found: published.append((document.version, len(found))))
    document = Opened(lsp.TextDocumentItem(URI, "scn", 1, SCENE), "utf-16")
    place = lsp.Range(lsp.Position(3, 0), lsp.Position(3, 0))
    for key in range(2, 12):
        change = lsp.TextDocumentContentChangePartial(place, "x")
        document.change(lsp.DidChangeTextDocumentParams(lsp.VersionedTextDocumentIdentifier(key, URI), [change]))
        ls.diagnose_soon(document)
    assert document.symbols.text.count("x" * 10) == 1  # questions are answered of the text as it is
    await asyncio.sleep(4 * server.DELAY)
    assert published == [(11, 1)]


async def test_no_garbage_is_looked_for_at_the_end(monkeypatch):
    """It took half a second after a session in which nothing was opened, and two after a long scene."""
    monkeypatch.setattr(server.server, "start_io", lambda: None)
    try:
        server.language_server.callback()
        assert gc.get_freeze_count() > 0
    finally:
        gc.unfreeze()


@pytest.mark.slow
async def test_a_long_scene_is_followed(editor):
    """10,000 lines. What a keystroke takes, there and back, is bounded generously: the machine may be busy."""
    text = large(1250)
    assert not await opened(editor, text)
    line = text[: text.index("kd", len(text) // 2)].count("\n")
    times = []
    for i, (new, end) in enumerate([("7", None), ("5", 8), ("6", 8), (".5", 8)]):
        begun = time.perf_counter()
        await typed(editor, i + 2, line, 7, new, end)
        times.append(time.perf_counter() - begun)
    assert min(times) < 0.5
