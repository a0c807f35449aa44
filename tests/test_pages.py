"""What the pages name exists: options, modules and files."""

import importlib
import re
from pathlib import Path

import click
import pytest
from prosim_start.group import COMMANDS, prosim

ROOT = Path(__file__).parents[1]
PAGES = [*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("docs/*/*.md"), *ROOT.glob("docs/*/*.rst")]
PAGES = [page for page in PAGES if page.name != "CHANGELOG.md" and page.parent.name not in ("_build", "notebooks")]
#: Options of other programs.
OTHERS = {"--append", "--host", "--nthreads", "--only", "--size", "--vector-width", "--keep-going"}


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
