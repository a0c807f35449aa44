"""Scene files."""

import pytest


@pytest.fixture
def write_scene(tmp_path):
    """Writes a text into a scene file; its path."""

    def write(text):
        path = tmp_path / "s.scn"
        path.write_text(text, encoding="utf-8")
        return path

    return write
