"""Scene files for the commands, and the renders that they begin."""

import shutil
import sys

import pytest
from mitsuba_prosim.engine.render import Render
from mitsuba_prosim.scene import rendering
from mitsuba_prosim.stock_command import link
from running import PALITO, XML, done


@pytest.fixture
def scene(write_scene):
    return write_scene(XML, "scene.xml")


@pytest.fixture
def palito(write_scene):
    return write_scene(PALITO.read_text("utf-8"), "listing.scn")


@pytest.fixture
def linked(tmp_path_factory, monkeypatch):
    """A copy of the script ``mitsuba`` after ``prosim link``."""
    if sys.platform == "win32":
        pytest.skip("the command is no script on Windows")
    path = shutil.copy(link.script(), tmp_path_factory.mktemp("bin") / "mitsuba")
    monkeypatch.setattr(link, "script", lambda: path)
    done("link")
    return path


@pytest.fixture
def counts(monkeypatch):
    """The sample counts of the first render that begins."""
    renders = []
    for kind in Render, rendering.Blocking:
        begin = kind.__init__
        monkeypatch.setattr(kind, "__init__", lambda self, *how, to=begin: renders.append(self) or to(self, *how))
    return lambda: renders.pop(0).counts()
