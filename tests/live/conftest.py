"""One process of ``prosim watch``, and one browser, for the tests of a module."""

import itertools

import pytest
from little import BROWSER, LITTLE, watching
from mitsuba_prosim.engine.work import Step


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    path = tmp_path_factory.mktemp("watched") / "little.scn"
    path.write_text(LITTLE)
    return path


@pytest.fixture(scope="module")
def address(scene):
    with watching(scene) as (_, address):
        yield address


@pytest.fixture
def estimates_that_fall(variant_rgb, monkeypatch):
    """Renders that take back half of what they tell, as one does that finds that there is more to do."""
    from mitsuba_prosim.engine import render

    shares = itertools.cycle((1, 0.5))
    monkeypatch.setattr(render, "Step", lambda done, complete: Step(done * next(shares), complete))


@pytest.fixture(scope="module")
def browser():
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        yield browser
        browser.close()
