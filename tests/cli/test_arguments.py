"""What is said of a file that is not there, or of another kind than a command wants."""

import pytest
from running import names, prosim

#: What files of other kinds begin with.
PNG, EXR = b"\x89PNG\r\n\x1a\n" + bytes(40), b"\x76\x2f\x31\x01" + bytes(40)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Current folder, with a scene and images, no state and no part."""
    monkeypatch.chdir(tmp_path)
    for name, content in [("mug.scn", b"SCENE"), ("mug.png", PNG), ("mug.0007.exr", EXR), ("night.exr", EXR)]:
        (tmp_path / name).write_bytes(content)
    (tmp_path / "scenes").mkdir()
    (tmp_path / "scenes" / "jug.xml").write_text("<scene/>")
    (tmp_path / "scenes" / "pole.scn").write_text("SCENE")
    return tmp_path


@pytest.mark.parametrize(
    "command, path, says",
    [
        *[(name, "mug", "File 'mug' does not exist. Did you mean mug.scn?") for name in ("render", "compare", "watch")],
        ("translate", "mug.png", "'mug.png' is a PNG image, not a scene. Did you mean mug.scn?"),
        ("render", "mug.0007.exr", "'mug.0007.exr' is an EXR image, not a scene. Did you mean mug.scn?"),
        ("render", "night.exr", "'night.exr' is an EXR image, not a scene.\n"),
        ("format", "mgu.scn", "File 'mgu.scn' does not exist. Did you mean mug.scn?"),
        ("render", "scenes", "'scenes' is a folder. Did you mean scenes/pole.scn?"),
        ("render", "pole", "File 'pole' does not exist. Did you mean scenes/pole.scn?"),
        ("render", "scenes/jug.scn", "does not exist. Did you mean scenes/jug.xml?"),
        ("render", "scense/jug.scn", "does not exist (nor does the folder 'scense').\n"),
        ("translate", "scenes/jug.xml", "a scene of Mitsuba's already. To render it: prosim render scenes/jug.xml\n"),
        ("format", "scenes/jug.xml", "is a scene of Mitsuba's already."),
        ("render", "-", "File '-' does not exist.\n"),
        ("resume", "mug.png", "a PNG image, not the state of a render. prosim render --keep writes one.\n"),
        ("resume", "mug.scn", "'mug.scn' is a scene, not the state of a render. prosim render --keep writes one.\n"),
        ("resume", "night.exr", "is an EXR image, not the state of a render. prosim render --keep writes one.\n"),
        ("merge", "mug.scn", "'mug.scn' is a scene, not a part of an image. prosim render --part 1/4 writes one.\n"),
        ("merge", "night.*-of-4.npz", "File 'night.*-of-4.npz' does not exist.\n"),
    ],
)
def test_a_file_that_was_not_meant(folder, command, path, says):
    before = names(folder)
    done = prosim(command, path)
    assert done.exit_code == 2 and says in done.stderr, done.output
    assert names(folder) == before and "Traceback" not in done.output
