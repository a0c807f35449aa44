"""Files that do not exist, or are of another kind than a command needs."""

import pytest
from running import refused

#: What files of other kinds begin with.
PNG, EXR = b"\x89PNG\r\n\x1a\n" + bytes(40), b"\x76\x2f\x31\x01" + bytes(40)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Current folder, with a scene and images, no state and no part."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scenes").mkdir()
    contents = {"mug.scn": b"SCENE", "mug.png": PNG, "mug.0007.exr": EXR, "night.exr": EXR}
    for name, content in (contents | {"scenes/jug.xml": b"<scene/>", "scenes/pole.scn": b"SCENE"}).items():
        (tmp_path / name).write_bytes(content)
    return tmp_path


@pytest.mark.parametrize(
    "command, path, says",
    [
        *[(name, "mug", "does not exist. Did you mean mug.scn?") for name in ("render", "compare", "watch")],
        ("translate", "mug.png", "is a PNG image, not a scene in the thesis's language. Did you mean mug.scn?"),
        ("render", "mug.0007.exr", "is an EXR image, not a scene. Did you mean mug.scn?"),
        ("render", "night.exr", "is an EXR image, not a scene.\n"),
        ("format", "mgu.scn", "Did you mean mug.scn?"),
        ("render", "scenes", "is a directory."),
        ("render", "scenes/jug.scn", "Did you mean scenes/jug.xml?"),
        ("render", "scense/jug.scn", "File 'scense/jug.scn' does not exist.\n"),
        ("translate", "scenes/jug.xml", "is a Mitsuba scene, not"),
        ("format", "scenes/jug.xml", "prosim render scenes/jug.xml\n"),
        ("resume", "mug.scn", "a text file, not the state of a render. prosim render --checkpoint"),
        ("resume", "night.exr", "an EXR image, not the state of a render. prosim render --checkpoint"),
        ("merge", "mug.scn", "a text file, not a part of an image. prosim render --part 1/4"),
        ("merge", "night.*-of-4.npz", "File 'night.*-of-4.npz' does not exist.\n"),
    ],
)
def test_wrong_files_are_refused(folder, command, path, says):
    refused(says, command, path, folder=folder)
