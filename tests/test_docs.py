"""The documentation's site builds without a warning, and shows every plugin."""

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest
from mitsuba_prosim import registry
from mitsuba_prosim.registry import FOLDERS

DOCS = Path(__file__).parents[1] / "docs"

pytestmark = pytest.mark.docs


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    out = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", DOCS, out, "-d", out / ".doctrees"]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return out


def test_every_plugin_has_a_section_a_table_and_examples(site, variant_rgb):
    pages = "".join((site / "plugins" / f"{folder}.html").read_text("utf-8") for folder in FOLDERS)
    sections = dict(re.findall(r'<h2>[^<]*\(<span class="monosp">(\w+)</span>\)(.*?)(?=<h2>|$)', pages, re.DOTALL))
    assert set(sections) == set(registry.PLUGINS)
    for name, text in sections.items():
        assert '<table class="plugin-parameters' in text, name
        assert 'class="highlight-xml' in text and 'class="highlight-python' in text, name


def test_site_has_no_dead_link_and_fetches_nothing(site):
    """Formulas included; links to other sites are for readers."""
    for page in site.rglob("*.html"):
        text = page.read_text("utf-8")
        for link in re.findall(r'(?:href|src)="([^"#?:]+)[^":]*"', text):
            assert (page.parent / link).exists(), f"{page.name} -> {link}"
        fetched = re.findall(r'<(?:script|img|source|iframe)[^>]*\bsrc="([^"]*)"', text)
        fetched += re.findall(r'<link[^>]*\brel="(?:stylesheet|preload|icon)"[^>]*\bhref="([^"]*)"', text)
        assert fetched and not [link for link in fetched if re.match("(https?:)?//", link)], page.name
    page = (site / "plugins" / "bsdfs.html").read_text("utf-8")
    assert "<math" in page
    assert 'href="https://mitsuba.readthedocs.io/en/stable/src/generated/plugins_bsdfs.html#bsdf-conductor"' in page


def test_every_notebook_has_a_page(site):
    index = (site / "notebooks.html").read_text("utf-8")
    for notebook in DOCS.parent.glob("examples/*.ipynb"):
        assert f'href="notebooks/{notebook.stem}.html"' in index
        assert 'download="" href="../_downloads' in (site / "notebooks" / f"{notebook.stem}.html").read_text("utf-8")


def test_the_api_is_up_to_date(variant_rgb, monkeypatch):
    """``python docs/api.py`` writes it."""
    monkeypatch.syspath_prepend(DOCS)
    assert importlib.import_module("api").page() == (DOCS / "api.rst").read_text("utf-8")


def test_api_lists_numbers_only_of_words_that_have_some():
    """The cells of a word without numbers, such as METHOD, are empty."""
    row = (DOCS / "api.rst").read_text("utf-8").partition("   * - ``METHOD``\n")[2].splitlines()[:3]
    assert [cell.strip() for cell in row] == ["- ``METODO``", "-", "-"]


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md", "CHANGELOG.md"])
def test_pages_outside_the_site_have_no_dead_link(name):
    text = (DOCS.parent / name).read_text("utf-8")
    for link in re.findall(r"\]\(([^)\s]+)\)", text) + re.findall(r'src="([^"]+)"', text):
        assert link.startswith("http") or (DOCS.parent / link.partition("#")[0]).exists(), link
