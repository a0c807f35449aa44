"""The examples in docs/language.md and docs/cheat_sheet.md."""

import re
from pathlib import Path

import prosim_scene
import pytest
from prosim_scene.language.words import WORDS, normalise
from prosim_scene.mitsuba import textures

DOCS = Path(__file__).parents[2] / "docs"
TEXT = (DOCS / "language.md").read_text(encoding="utf-8")
CHEAT_SHEET = (DOCS / "cheat_sheet.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```scn\n(.*?)```", TEXT + CHEAT_SHEET, re.DOTALL)


@pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")
@pytest.mark.parametrize("text", EXAMPLES, ids=range(len(EXAMPLES)))
def test_examples_parse(text):
    assert prosim_scene.parse(prosim_scene.format(text)) == prosim_scene.parse(text)


def test_every_statement_and_parameter_has_an_example():
    words = {normalise(w) for example in EXAMPLES for w in re.findall(r"[\w-]+", example)}
    missing = [row for row in WORDS if not words & {normalise(s) for s in row.spellings}]
    # The plain ones among the parameters of textures and transforms are in the tables.
    assert {normalise(row.canonical) for row in missing} <= {normalise(w) for w in re.findall(r"[\w-]+", TEXT)}


def test_the_tables_of_defaults_are_right():
    for kind, values in textures.DEFAULTS.items():
        (row,) = re.findall(rf"^\| `{kind}` \| (.*) \|$", TEXT, re.MULTILINE)
        for name, value in values.items():
            numbers = re.search(rf"`{name.replace('_', '-')}` ([\d. ]+)", row)[1].split()
            expected = value if isinstance(value, tuple) else (value,)
            assert [float(n) for n in numbers] == pytest.approx(expected, abs=1e-4), name
