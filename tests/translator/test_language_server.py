"""The language server, as an editor speaks with it."""

import asyncio
import itertools
import pickle
import subprocess
import sys

import prosim_scene
import psutil
import pytest
import pytest_asyncio
import pytest_lsp
from lsprotocol import types as lsp
from pygls.exceptions import JsonRpcException
from pygls.protocol import default_converter
from pytest_lsp.client import DEFAULT_CLIENT_FEATURES, register_lsp_features
from test_editor import SCENE
from waiting import PATIENCE

URI = "file:///nowhere/scene.scn"
DOCUMENT = lsp.TextDocumentIdentifier(URI)
SERVER = [sys.executable, "-c", "from prosim_scene.editor.language_server import language_server; language_server()"]

pytestmark = pytest.mark.asyncio(loop_scope="module")


def client():
    """One that keeps all that is published, because a text has diagnostics a second time when its tree is evaluated."""
    made = pytest_lsp.LanguageClient(converter_factory=default_converter)
    made.published, made.versions = [], itertools.count(1)

    def publish(params):
        made.published.append(params)

    register_lsp_features(made, DEFAULT_CLIENT_FEATURES | {lsp.TEXT_DOCUMENT_PUBLISH_DIAGNOSTICS: publish})
    return made


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def editor():
    made = client()
    await made.start_io(*SERVER)
    capabilities = pytest_lsp.client_capabilities("visual-studio-code")
    await made.initialize_session(lsp.InitializeParams(capabilities=capabilities, root_uri="file:///nowhere"))
    yield made
    await made.shutdown_session()
    await made.stop()


async def opened(editor, text, uri=URI):
    """The diagnostics of a text that has been opened."""
    editor.text_document_did_close(lsp.DidCloseTextDocumentParams(lsp.TextDocumentIdentifier(uri)))
    document = lsp.TextDocumentItem(uri, "scn", next(editor.versions), text)
    editor.text_document_did_open(lsp.DidOpenTextDocumentParams(document))
    return await told(editor, document.version)


async def told(editor, version, times=1):
    """What is published for a version of a text, once or several times."""
    found = await reached(lambda: [one for one in editor.published if one.version == version][times - 1 :])
    return found[0].diagnostics


async def reached(condition):
    """What the condition returns as soon as it is true."""
    for _ in range(200 * PATIENCE):
        if found := condition():
            return found
        await asyncio.sleep(0.005)
    raise TimeoutError


async def typed(editor, *texts):
    """The diagnostics after one or more changes of the text."""
    for text in texts:
        version = change(editor, text)
    return await told(editor, version)


def change(editor, text, uri=URI):
    document = lsp.VersionedTextDocumentIdentifier(next(editor.versions), uri)
    whole = [lsp.TextDocumentContentChangeWholeDocument(text)]
    editor.text_document_did_change(lsp.DidChangeTextDocumentParams(document, whole))
    return document.version


def position(text, word, shift=0):
    before = text[: text.index(word) + shift]
    return lsp.Position(before.count("\n"), len(before) - before.rfind("\n") - 1)


@pytest.mark.slow
async def test_errors_come_and_go_with_the_text(editor):
    scene = SCENE.replace("NAME: a", "NAME: a (esfera é 🎈) NSAMPLES 3")
    assert not await opened(editor, scene)
    (wrong,) = await typed(editor, scene.replace("NSAMPLES 3", "NSAMPLES 3.5"))
    at = position(scene, "3\nLIGHTS")
    at.character += 1  # of UTF-16, in which the balloon takes two
    assert (wrong.severity, wrong.source, wrong.code) == (lsp.DiagnosticSeverity.Error, "prosim", "range")
    assert wrong.range == lsp.Range(at, lsp.Position(at.line, at.character + 3))
    assert not await typed(editor, scene)
    (doubt,) = await typed(editor, scene.replace("NSAMPLES", "SURFACE 9 NSAMPLES"))
    assert (doubt.severity, doubt.code) == (lsp.DiagnosticSeverity.Warning, "unused")


@pytest.mark.slow
async def test_diagnostics_of_the_tree_follow_when_a_scene_is_opened(editor):
    hidden = SCENE.replace("- SPHERE 1 CYLINDER 1", "SPHERE 1").replace("2 2 2", ".1 .1 .1 TRANSLATE .5 .5 .5")
    assert not await opened(editor, hidden)
    assert [one.code for one in await told(editor, editor.published[-1].version, 2)] == ["csg"]


def crowded():
    """As many spheres at one place take minutes."""
    names = " ".join(f"SPHERE {i}" for i in range(300))
    tables = "\n".join(f"SURFACE {i}\nTRANSFORM {i} TRANSLATE (0 {i / 1e4} {(i * i) % 97 / 1e3})" for i in range(300))
    return f"LIGHTS AREA position 9 9 9 raio 2\nCSG-TREE {'+ ' * 299}{names}\n{tables}\nEND\n"


async def test_server_answers_while_a_tree_is_evaluated(editor):
    """Errors are published at once, and questions are answered, while it is evaluated by another process."""
    text, server = crowded(), [one for one in psutil.Process().children() if one.cmdline()[-1:] == SERVER[-1:]]
    assert not await opened(editor, text)
    evaluating = await reached(lambda: [child for one in server for child in one.children()])
    hover = await editor.text_document_hover_async(lsp.HoverParams(DOCUMENT, position(text, "raio", 1)))
    assert "the radius" in hover.contents.value
    assert evaluating[0].is_running()
    assert len(await typed(editor, "x " + text)) == 1
    psutil.wait_procs(evaluating, PATIENCE)  # it ends, because its text has changed
    assert not evaluating[0].is_running()


@pytest.mark.slow
async def test_an_evaluation_ends_without_its_parent():
    scene = pickle.dumps((crowded(), "s.scn", 0.5))
    command = [sys.executable, "-c", "from prosim_scene.editor.evaluation import main; main()"]
    done = subprocess.run(command, check=False, input=scene, capture_output=True, timeout=PATIENCE)
    assert done.returncode == 1 and not done.stdout and not done.stderr


@pytest.mark.parametrize("mark", ["\r\n", "\r"])
async def test_formatting_keeps_line_ends(editor, mark):
    """At a form feed and the like Python ends a line, and an editor does not; a lone CR ends one for both."""
    text = ("\ufeff" + SCENE.replace("a remark", "a \f \u2028 \x85 remark 🎈")).replace("\n", mark)
    assert not await opened(editor, text)
    asked = lsp.DocumentFormattingParams(DOCUMENT, lsp.FormattingOptions(4, True))
    (tidy,) = await editor.text_document_formatting_async(asked)
    assert tidy.new_text == prosim_scene.format(text[1:].replace(mark, "\n")).replace("\n", mark)
    assert tidy.range == lsp.Range(lsp.Position(0, 0), lsp.Position(text.count(mark), 0))


async def test_an_editor_completes_explains_and_finds(editor):
    await opened(editor, SCENE)
    found = await editor.text_document_completion_async(lsp.CompletionParams(DOCUMENT, position(SCENE, "ouro", 2)))
    (gold,) = [one for one in found if one.label == "ouro"]
    assert gold.detail == "Au" and gold.text_edit.range.start == position(SCENE, "ouro")
    hover = await editor.text_document_hover_async(lsp.HoverParams(DOCUMENT, position(SCENE, "raio", 1)))
    assert "the radius" in hover.contents.value and hover.range.start == position(SCENE, "raio")
    at = position(SCENE, "SPHERE 1", 7)
    definitions = await editor.text_document_definition_async(lsp.DefinitionParams(DOCUMENT, at))
    assert [one.range.start.line for one in definitions] == [7, 9]
    everywhere = lsp.ReferenceParams(lsp.ReferenceContext(include_declaration=True), DOCUMENT, at)
    assert len(await editor.text_document_references_async(everywhere)) == 4


async def test_of_many_keystrokes_the_last_is_published(editor):
    await opened(editor, SCENE)
    (wrong,) = await typed(editor, *("x" * key + "\n" + SCENE for key in range(2, 12)))
    assert wrong.range.end.character == 11


async def test_a_document_that_is_not_open_has_no_answers(editor):
    """As editors ask during a start, after a crash of the server, or about files that no longer exist."""
    await opened(editor, SCENE)
    other = lsp.TextDocumentIdentifier("file:///nowhere/other.scn")
    at, all_text = lsp.Position(0, 0), lsp.Range(lsp.Position(0, 0), lsp.Position(9, 0))
    for ask, params in (
        (editor.text_document_completion_async, lsp.CompletionParams(other, at)),
        (editor.text_document_hover_async, lsp.HoverParams(other, at)),
        (editor.text_document_definition_async, lsp.DefinitionParams(other, at)),
        (editor.text_document_references_async, lsp.ReferenceParams(lsp.ReferenceContext(True), other, at)),
        (editor.text_document_formatting_async, lsp.DocumentFormattingParams(other, lsp.FormattingOptions(4, True))),
        (editor.text_document_document_symbol_async, lsp.DocumentSymbolParams(other)),
        (editor.text_document_rename_async, lsp.RenameParams(other, at, "x")),
        (editor.text_document_code_action_async, lsp.CodeActionParams(other, all_text, lsp.CodeActionContext([]))),
    ):
        assert await ask(params) is None
    editor.text_document_did_save(lsp.DidSaveTextDocumentParams(other))
    change(editor, "x", other.uri)
    editor.text_document_did_close(lsp.DidCloseTextDocumentParams(other))
    assert await editor.text_document_hover_async(lsp.HoverParams(DOCUMENT, position(SCENE, "raio", 1)))
    assert not any(one.diagnostics for one in editor.published if one.uri == other.uri)


async def test_too_large_document_is_reported_and_has_no_answers(editor):
    text = SCENE + "#" * 2**22
    (error,) = await opened(editor, text)
    assert error.message.startswith("the file is larger than 4 MiB") and error.range.start == lsp.Position(0, 0)
    assert await editor.text_document_hover_async(lsp.HoverParams(DOCUMENT, position(text, "raio", 1))) is None
    assert await editor.text_document_document_symbol_async(lsp.DocumentSymbolParams(DOCUMENT)) == []


async def test_uris_may_have_escapes(editor):
    uri = "file:///nowhere/um%20copo%20d%27%C3%A1gua%2525.scn"
    (error,) = await opened(editor, SCENE.replace("ks 0", "ks 2"), uri)
    params = lsp.CodeActionParams(lsp.TextDocumentIdentifier(uri), error.range, lsp.CodeActionContext([error]))
    assert len(await editor.text_document_code_action_async(params)) == 1


async def test_outline_lists_statements(editor):
    await opened(editor, SCENE)
    found = await editor.text_document_document_symbol_async(lsp.DocumentSymbolParams(DOCUMENT))
    assert [one.name for one in found] == [
        *("DEFAULT $turn", "NAME", "LIGHTS", "CSG-TREE", "SURFACE 0", "SURFACE 1"),
        *("TRANSFORM 0", "TRANSFORM 1", "TEXTURE t-mine", "END"),
    ]
    csg = found[3].range
    assert (csg.start, csg.end) == (position(SCENE, "CSG"), position(SCENE, "\n(another"))


def applied(text, edit):
    """The text after an edit of the workspace."""
    (changes,) = edit.changes.values()
    starts = [0, *(i + 1 for i, c in enumerate(text) if c == "\n")]
    for change in reversed(changes):
        start, end = (starts[at.line] + at.character for at in (change.range.start, change.range.end))
        text = text[:start] + change.new_text + text[end:]
    return text


SOLIDS = SCENE.replace("+ CUBE 0", "+ + other 0 CUBE 0 t-mine").replace(
    "CSG-TREE", "SOLID legs CUBE 0\nSOLID other LEGS 0\nCSG-TREE"
)


def renaming(word, shift, name):
    return lsp.RenameParams(DOCUMENT, position(SOLIDS, word, shift), name)


@pytest.mark.parametrize(
    "word, shift, name, renamed",
    [
        ("$turn", 1, "$angle", {"$turn": "$angle"}),
        ("$turn / 3", 2, "ângulo", {"$turn": "$ângulo"}),
        ("t-mine", 2, "t-other", {"t-mine": "t-other"}),
        ("legs", 0, "feet", {"legs": "feet", "LEGS": "feet"}),
        ("SPHERE 1", 7, "77", {f"{x} 1": f"{x} 77" for x in ("SPHERE", "CYLINDER", "SURFACE", "TRANSFORM")}),
    ],
)
async def test_symbols_are_renamed_everywhere(editor, word, shift, name, renamed):
    assert not await opened(editor, SOLIDS)
    expected = SOLIDS
    for old, new in renamed.items():
        expected = expected.replace(old, new)
    assert applied(SOLIDS, await editor.text_document_rename_async(renaming(word, shift, name))) == expected


async def test_wrong_names_rename_nothing(editor):
    """A name may be in use, a word of the language, or not valid."""
    assert not await opened(editor, SOLIDS)
    assert await editor.text_document_rename_async(renaming("kd", 0, "ks")) is None  # no symbol
    for word, shift, *names in [
        ("t-mine", 2, "mine", "t-brick"),
        ("t-listra", 2, "t-other"),
        ("$turn", 1, "$a b", "$frame"),
        ("legs", 0, "CUBE", "other"),
        ("SPHERE 1", 7, "0", "-7"),
    ]:
        for name in names:
            with pytest.raises(JsonRpcException, match="in use, or is not valid"):
                await editor.text_document_rename_async(renaming(word, shift, name))


@pytest.mark.parametrize(
    "wrong, right",
    [
        (("CYLINDER", "CILYNDER"), None),
        (("t-listra", "t-listrra"), None),
        (("condutor ouro", "ouro"), ("ouro", "conductor ouro")),
        (("{$turn / 3}", "{$trun / 3}"), None),
        (("NAME: a", "NAME: a CAUSTICS ON"), ("ON", "TRUE")),
        (("ks 0", "ks 60%"), ("60%", "0.6")),
        (("ks 0", "ks 51 0 0"), ("51", "0.2")),
    ],
)
async def test_a_quick_fix_writes_what_an_error_suggests(editor, wrong, right):
    text = SCENE.replace(*wrong)
    (error,) = await opened(editor, text)
    params = lsp.CodeActionParams(DOCUMENT, error.range, lsp.CodeActionContext([error]))
    (fix,) = await editor.text_document_code_action_async(params)
    assert applied(text, fix.edit) == (text.replace(*right) if right else SCENE)
    params.range = lsp.Range(lsp.Position(0, 0), lsp.Position(0, 1))
    assert not await editor.text_document_code_action_async(params)
