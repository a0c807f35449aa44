"""When files that a scene is made of are written, removed or made, in whichever folder."""

import threading

import pytest
from little import until
from mitsuba_prosim.live.scene_watcher import SceneWatcher


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene" / "little.scn"
    path.parent.mkdir()
    path.write_text("little")
    return path


class Heard:
    def __init__(self):
        self.event = threading.Event()

    def tell(self):
        self.event.set()

    def after(self, act, seconds=20):
        """Whether it is told after ``act()``."""
        self.event.wait(0.03)
        self.event.clear()
        act()
        return self.event.wait(seconds)


def test_each_file_in_its_folder_and_no_other(scene):
    picture = scene.parent / "pictures" / "wood.png"
    files, heard = SceneWatcher(scene), Heard()
    files.opened([scene.parent / ("é" * 200) / "wood.png"])  # the name of that folder is too long
    with files.watching(heard.tell):
        assert not heard.after(lambda: scene.with_name("other.scn").write_text("other"), 0.3)
        assert heard.after(lambda: scene.write_text("changed"))
        scene.with_name("new").write_text("new")
        assert heard.after(lambda: scene.with_name("new").rename(scene))
        picture.parent.mkdir()
        picture.write_bytes(b"wood")
        assert not heard.after(lambda: files.opened([picture]), 0.3)
        assert heard.after(lambda: picture.write_bytes(b"oak"))
        assert heard.after(lambda: scene.write_text("the folder of the scene is watched as before"))
        assert heard.after(picture.unlink)
        assert heard.after(lambda: picture.write_bytes(b"wood"))
        # The whole folder goes and comes again.
        assert heard.after(lambda: picture.parent.rename(scene.parent / "gone"))
        assert heard.after(lambda: (scene.parent / "gone").rename(picture.parent))
        assert heard.after(lambda: picture.write_bytes(b"beech"))


def test_a_file_that_is_being_written_is_told_of_once_it_is_whole(scene, monkeypatch):
    """Between two looks nothing has changed."""
    stamps = iter([(1,), (2,), (3,), *[(4,)] * 9])
    monkeypatch.setattr("mitsuba_prosim.live.scene_watcher.stamp", lambda path: next(stamps, (4,)))
    files, told = SceneWatcher(scene), []
    with files.watching(lambda: told.append(next(stamps, None))):
        until(lambda: told)
    assert told == [(4,)]
