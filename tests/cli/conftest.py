"""Scene files for the commands, and the renders that they begin."""

import pytest
from mitsuba_prosim.engine.render import Render
from mitsuba_prosim.scene import rendering
from running import PALITO, XML


@pytest.fixture
def scene(write_scene):
    return write_scene(XML, "scene.xml")


@pytest.fixture
def palito(write_scene):
    return write_scene(PALITO.read_text("utf-8"), "listing.scn")


@pytest.fixture
def counts(monkeypatch):
    """The sample counts of the first render that begins."""
    renders = []
    for kind in Render, rendering.Blocking:
        begin = kind.__init__
        monkeypatch.setattr(kind, "__init__", lambda self, *how, to=begin: renders.append(self) or to(self, *how))
    return lambda: renders.pop(0).counts()
