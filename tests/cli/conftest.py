"""Scene files for the commands."""

import pytest
from running import PALITO, XML


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(XML)
    return path


@pytest.fixture
def palito(tmp_path):
    path = tmp_path / "listing.scn"
    path.write_bytes(PALITO.read_bytes())
    return path
