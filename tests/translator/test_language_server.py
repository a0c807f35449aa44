"""The language server, as an editor speaks with it."""

import asyncio
import pickle
import subprocess
import sys
import time

import prosim_scene
import pytest
import pytest_lsp
from lsprotocol import types as lsp
from test_editor import SCENE

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


async def typed(editor, version, *texts):
    """The diagnostics after one or more changes of the text."""
    for number, text in enumerate(texts, version):
        change = lsp.TextDocumentContentChangeWholeDocument(text)
        document = lsp.VersionedTextDocumentIdentifier(number, URI)
        editor.text_document_did_change(lsp.DidChangeTextDocumentParams(document, [change]))
    return await told(editor)


def position(text, word, shift=0):
    before = text[: text.index(word) + shift]
    return lsp.Position(before.count("\n"), len(before) - before.rfind("\n") - 1)


async def test_errors_come_and_go_with_the_text(editor):
    scene = SCENE.replace("NAME: a", "NAME: a (esfera é 🎈) NSAMPLES 3")
    assert not await opened(editor, scene)
    (wrong,) = await typed(editor, 2, scene.replace("NSAMPLES 3", "NSAMPLES 3.5"))
    at = position(scene, "3\nLIGHTS")
    at.character += 1  # of UTF-16, in which the balloon takes two
    assert (wrong.severity, wrong.source, wrong.code) == (lsp.DiagnosticSeverity.Error, "prosim", "range")
    assert wrong.range == lsp.Range(at, lsp.Position(at.line, at.character + 3))
    assert not await typed(editor, 3, scene)
    (doubt,) = await typed(editor, 4, scene.replace("NSAMPLES", "SURFACE 9 NSAMPLES"))
    assert (doubt.severity, doubt.code) == (lsp.DiagnosticSeverity.Warning, "unused")


async def test_diagnostics_of_the_tree_follow_when_a_scene_is_opened(editor):
    hidden = SCENE.replace("- SPHERE 1 CYLINDER 1", "SPHERE 1").replace(
        "SCALE 2 2 2", "SCALE .1 .1 .1 TRANSLATE .5 .5 .5"
    )
    assert not await opened(editor, hidden)
    assert [one.code for one in await told(editor)] == ["csg"]


def crowded():
    """As many spheres at one place take minutes."""
    names = " ".join(f"SPHERE {i}" for i in range(300))
    tables = "\n".join(f"SURFACE {i}\nTRANSFORM {i} TRANSLATE (0 {i / 1e4} {(i * i) % 97 / 1e3})" for i in range(300))
    return f"LIGHTS AREA position 9 9 9 raio 2\nCSG-TREE {'+ ' * 299}{names}\n{tables}\nEND\n"


async def test_nothing_waits_for_a_tree(editor):
    """Errors are published at once, and questions are answered, while it is evaluated."""
    text, begun = crowded(), time.perf_counter()
    assert not await opened(editor, text)
    await asyncio.sleep(0.2)  # the tree is being evaluated
    document = lsp.TextDocumentIdentifier(URI)
    hover = await editor.text_document_hover_async(lsp.HoverParams(document, position(text, "raio", 1)))
    assert "the radius" in hover.contents.value
    assert len(await typed(editor, 2, "x " + text)) == 1
    assert time.perf_counter() - begun < 20


@pytest.mark.slow
async def test_an_evaluation_ends_without_its_parent():
    scene = pickle.dumps((crowded(), "s.scn", 0.5))
    command = [sys.executable, "-c", "from prosim_scene.evaluation import main; main()"]
    done = subprocess.run(command, check=False, input=scene, capture_output=True, timeout=40)
    assert done.returncode == 1 and not done.stdout and not done.stderr


@pytest.mark.parametrize("mark", ["\r\n", "\r"])
async def test_formatting_keeps_line_ends(editor, mark):
    """At a form feed and the like Python ends a line, and an editor does not; a lone CR ends one for both."""
    text = ("\ufeff" + SCENE.replace("a remark", "a \f \u2028 \x85 remark 🎈")).replace("\n", mark)
    assert not await opened(editor, text)
    asked = lsp.DocumentFormattingParams(lsp.TextDocumentIdentifier(URI), lsp.FormattingOptions(4, True))
    (tidy,) = await editor.text_document_formatting_async(asked)
    assert tidy.new_text == prosim_scene.format(text[1:].replace(mark, "\n")).replace("\n", mark)
    assert tidy.range == lsp.Range(lsp.Position(0, 0), lsp.Position(text.count(mark), 0))


async def test_an_editor_completes_explains_and_finds(editor):
    await opened(editor, SCENE)
    document = lsp.TextDocumentIdentifier(URI)
    found = await editor.text_document_completion_async(lsp.CompletionParams(document, position(SCENE, "ouro", 2)))
    (gold,) = [one for one in found if one.label == "ouro"]
    assert gold.detail == "Au" and gold.text_edit.range.start == position(SCENE, "ouro")
    hover = await editor.text_document_hover_async(lsp.HoverParams(document, position(SCENE, "raio", 1)))
    assert "the radius" in hover.contents.value and hover.range.start == position(SCENE, "raio")
    at = position(SCENE, "SPHERE 1", 7)
    definitions = await editor.text_document_definition_async(lsp.DefinitionParams(document, at))
    assert [one.range.start.line for one in definitions] == [7, 9]
    everywhere = await editor.text_document_references_async(
        lsp.ReferenceParams(lsp.ReferenceContext(include_declaration=True), document, at)
    )
    assert len(everywhere) == 4


async def test_of_many_keystrokes_the_last_is_published(editor):
    await opened(editor, SCENE)
    (wrong,) = await typed(editor, 2, *("x" * key + "\n" + SCENE for key in range(2, 12)))
    assert wrong.range.end.character == 11
