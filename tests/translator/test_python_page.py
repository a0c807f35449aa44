"""The page docs/python.md: its examples."""

import html
import re
from pathlib import Path

import prosim_scene
import pytest

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")


@pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")
def test_examples_work(monkeypatch):
    monkeypatch.chdir(ROOT / "examples")
    for block in re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL):
        exec(block, {})


def test_everything_public_is_on_the_page_and_documented():
    assert not [name for name in prosim_scene.__all__ if not re.search(rf"\b{name}\b", TEXT)]
    functions = [getattr(prosim_scene, name) for name in prosim_scene.__all__]
    assert all(one.__doc__ for one in functions if callable(one))


def test_a_scene_shows_itself_in_its_own_language():
    scene = prosim_scene.parse(prosim_scene.read(ROOT / "examples/palito.scn"), "palito.scn")
    shown = scene._repr_html_()
    text = html.unescape(shown.removeprefix("<pre>").removesuffix("</pre>"))
    assert shown.startswith("<pre>NAME: palito") and prosim_scene.parse(text, "shown") == scene
