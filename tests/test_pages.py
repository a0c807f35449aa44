"""What the pages name exists: options, modules and files; their examples work, their tables and pictures are right."""

import importlib
import re
import sys
import warnings
from pathlib import Path

import click
import mitsuba as mi
import numpy as np
import prosim_scene
import pytest
from prosim_scene.language.words import WORDS, normalise
from prosim_scene.mitsuba import textures
from prosim_start.group import COMMANDS, prosim
from scenes import slow

ROOT = Path(__file__).parents[1]
PAGES = [*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("docs/*/*.md"), *ROOT.glob("docs/*/*.rst")]
PAGES = [page for page in PAGES if page.name != "CHANGELOG.md" and page.parent.name not in ("_build", "notebooks")]
#: Options of other programs.
OTHERS = {"--append", "--host", "--nthreads", "--only", "--size", "--keep-going"}


@pytest.fixture(scope="module")
def options():
    """Command -> its options."""
    commands = {name: prosim.get_command(click.Context(prosim), name) for name in COMMANDS}
    return {
        name: {"-h", "--help", *(opt for option in command.params for opt in (*option.opts, *option.secondary_opts))}
        for name, command in commands.items()
    }


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_options_exist(page, options):
    text = page.read_text("utf-8")
    for command, rest in re.findall(r"\bprosim ([a-z-]+)\b([^`\n|]*)", text):
        if command in options:
            assert set(re.findall(r"(?<!\S)--?[a-zA-Z][\w.-]*", rest)) <= options[command], (command, rest)
    known = set().union(OTHERS, *options.values())
    assert set(re.findall(r"`(--[a-z][\w.-]*)", text)) <= known


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_modules_and_files_exist(page):
    text = page.read_text("utf-8")
    assert not re.search("^(<{7}|>{7}) ", text, re.MULTILINE)
    for name in set(re.findall(r"\b((?:mitsuba_prosim|prosim_scene)(?:\.\w+)+)\b(?!/)", text)):
        module, _, last = name.rpartition(".")
        try:
            importlib.import_module(name)
        except ModuleNotFoundError:
            found = importlib.import_module(module)
            assert hasattr(found, last) or last in ("scn", "png"), name
    for name in set(re.findall(r"`((?:plugins|scene_translator|tests|benchmarks|docs|examples)/[\w./-]+)", text)):
        assert (ROOT / name).exists() or name == "docs/_build", name
    for name in set(re.findall(r"\b(?:python|bash) ((?:benchmarks|docs|tests|examples)/[\w./-]+)", text)):
        assert (ROOT / name).exists(), name


# ---- The language, and its functions in Python

LANGUAGE, COMING_FROM, PYTHON = (
    (ROOT / "docs" / f"{name}.md").read_text() for name in ("language", "coming_from", "python")
)
EXAMPLES = re.findall(r"```scn\n(.*?)```", LANGUAGE + COMING_FROM, re.DOTALL)


def test_every_statement_and_parameter_has_an_example():
    words = {normalise(w) for example in EXAMPLES for w in re.findall(r"[\w-]+", example)}
    missing = [row for row in WORDS if not words & {normalise(s) for s in row.spellings}]
    # The plain ones among the parameters of textures and transforms are in the tables.
    assert {normalise(row.canonical) for row in missing} <= {normalise(w) for w in re.findall(r"[\w-]+", LANGUAGE)}


def test_language_page_has_the_defaults_of_textures():
    for kind, values in textures.DEFAULTS.items():
        (row,) = re.findall(rf"^\| `{kind}` \| (.*) \|$", LANGUAGE, re.MULTILINE)
        for name, value in values.items():
            numbers = re.search(rf"`{name.replace('_', '-')}` ([\d. ]+)", row)[1].split()
            expected = value if isinstance(value, tuple) else (value,)
            assert [float(n) for n in numbers] == pytest.approx(expected, abs=1e-4), name


@pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")
@pytest.mark.parametrize(
    "page", ["docs/python.md", *slow("README.md", "docs/five_minutes.md", "docs/inverse_rendering.md")]
)
def test_python_examples_run(page, tmp_path, monkeypatch):
    """Two steps of an optimisation instead of its many."""
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"^```python\n(.*?)^```$", (ROOT / page).read_text("utf-8"), re.MULTILINE | re.DOTALL)
    for code in blocks:
        exec(re.sub(r"range\(\d+\)", "range(2)", code.replace("examples/", f"{ROOT}/examples/")), {})
    assert blocks


def test_everything_public_is_on_the_page_and_documented():
    assert not [name for name in prosim_scene.__all__ if not re.search(rf"\b{name}\b", PYTHON)]
    functions = [getattr(prosim_scene, name) for name in prosim_scene.__all__]
    assert all(one.__doc__ for one in functions if callable(one))


# ---- Each step of docs/walkthrough.md gives a scene, and its picture is of that scene

sys.path.append(str(ROOT / "docs" / "extensions"))
from walkthrough import steps

STEPS = list(steps())


def test_walkthrough_ends_with_the_whole_scene():
    assert len(STEPS) == 10
    assert sorted(STEPS[-1][0].splitlines()) == sorted((ROOT / "docs" / "mug.scn").read_text("utf-8").splitlines())


@pytest.mark.parametrize("number", range(len(STEPS)))
def test_walkthrough_scenes_cause_no_warning(number):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        document = prosim_scene.document_of(STEPS[number][0], f"{number}.scn")
        prosim_scene.load(document, resolution=(8, 6))
    assert not caught


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")
@pytest.mark.parametrize("number", range(len(STEPS)))
def test_walkthrough_pictures_show_the_scenes_of_the_steps(variant_rgb, number):
    text, picture = STEPS[number]
    size = (32, 24) if "RESOLUTION" in text else (24, 24)
    scene = prosim_scene.load(prosim_scene.document_of(text, f"{number}.scn"), resolution=size, samples=3)
    image = np.clip(np.array(mi.render(mi.load_dict(scene))), 0, 1)[..., :3]
    shown = mi.Bitmap(str(ROOT / "docs" / picture)).convert(
        mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, srgb_gamma=False
    )
    blocks = np.array(shown).reshape(size[1], 20, size[0], 20, 3).mean(axis=(1, 3))
    assert np.sqrt(np.mean((image - blocks) ** 2)) < 0.05  # outlines, and grain


def test_each_promise_has_a_test():
    """Each row of the tables names a test, which exists."""
    text = (ROOT / "docs" / "promises.md").read_text("utf-8")
    rows = re.findall(r"^\| (?!---)(.*) \|$", text, re.MULTILINE)
    named = [re.search(r"`(\S+\.py)::(test_\w+)`$", row) for row in rows if not row.endswith("test")]
    assert len(named) > 30 and all(named)
    for test in named:
        assert re.search(rf"^def {test[2]}\(", (ROOT / test[1]).read_text("utf-8"), re.MULTILINE), test[0]
