"""One process of ``prosim watch``, and one browser, for the tests of a module."""

import pytest
from little import BROWSER, LITTLE, watching


@pytest.fixture
def path(write_scene):
    return write_scene(LITTLE, "little.scn")


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    path = tmp_path_factory.mktemp("watched") / "little.scn"
    path.write_text(LITTLE)
    return path


@pytest.fixture(scope="module")
def address(scene):
    with watching(scene) as (_, address):
        yield address


@pytest.fixture(scope="module")
def browser():
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        yield browser
        browser.close()
