"""Scene files for the commands."""

import pytest
from running import PALITO, XML


@pytest.fixture
def scene(write_scene):
    return write_scene(XML, "scene.xml")


@pytest.fixture
def palito(write_scene):
    return write_scene(PALITO.read_text("utf-8"), "listing.scn")
