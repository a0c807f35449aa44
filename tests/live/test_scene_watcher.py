"""When files that a scene is made of are written, removed or made, in whichever folder; which ones it may name."""

import time

import mitsuba as mi
import pytest
from click.testing import CliRunner
from mitsuba_prosim.live import viewer
from mitsuba_prosim.live.scene_watcher import SceneWatcher
from mitsuba_prosim.scene.confinement import OutsideError
from prosim_start import group
from waiting import PATIENCE, until


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene" / "little.scn"
    path.parent.mkdir()
    path.write_text("little")
    return path


@pytest.mark.slow
def test_watcher_notices_changes_of_the_scenes_files_only(scene):
    picture = scene.parent / "pictures" / "wood.png"
    files = SceneWatcher(scene)
    files.opened([scene.parent / ("é" * 200) / "wood.png"])  # the name of that folder is too long

    def noticed(act, seconds=PATIENCE):
        """Whether it is noticed after ``act()``."""
        act()
        end = time.monotonic() + seconds
        while not (changed := files.changed()) and time.monotonic() < end:
            time.sleep(0.005)
        return changed

    assert not noticed(lambda: scene.with_name("other.scn").write_text("other"), 0.3)
    assert noticed(lambda: scene.write_text("changed"))
    scene.with_name("new").write_text("new")
    assert noticed(lambda: scene.with_name("new").rename(scene))
    picture.parent.mkdir()
    picture.write_bytes(b"wood")
    assert not noticed(lambda: files.opened([picture]), 0.3)
    assert noticed(lambda: picture.write_bytes(b"oak"))
    assert noticed(lambda: scene.write_text("the folder of the scene is watched as before"))
    assert noticed(picture.unlink)
    assert noticed(lambda: picture.write_bytes(b"wood"))
    # The whole folder goes and comes again.
    assert noticed(lambda: picture.parent.rename(scene.parent / "gone"))
    assert noticed(lambda: (scene.parent / "gone").rename(picture.parent))
    assert noticed(lambda: picture.write_bytes(b"beech"))


def test_watcher_waits_until_a_file_is_written(scene, monkeypatch):
    """Between two looks nothing has changed."""
    stamps = iter([(1,), (2,), (3,), (3,), (4,)])
    monkeypatch.setattr("mitsuba_prosim.live.scene_watcher.stamp", lambda path: next(stamps, (4,)))
    files = SceneWatcher(scene)
    until(files.changed)
    assert next(stamps, None) is None
    time.sleep(0.1)
    assert not files.changed()


# ---- What ``prosim watch`` lets a scene read


@pytest.mark.parametrize("options", [[], ["--allow-outside"]])
def test_watched_scene_uses_files_of_its_folder_only(variant_rgb, tmp_path, monkeypatch, options):
    """Unless it is said that it may name others; the command's scene is opened as the page's is."""
    scene = tmp_path / "scene" / "scene.xml"
    scene.parent.mkdir()
    (tmp_path / "part.xml").write_text('<scene version="3.0.0"><sensor type="perspective"/></scene>')
    scene.write_text('<scene version="3.0.0"><include filename="../part.xml"/></scene>')
    opened = []

    monkeypatch.setattr(viewer, "Viewer", lambda path, open_scene, *_: opened.append(open_scene().scene))
    done = CliRunner().invoke(group.prosim, ["watch", str(scene), "--no-browser", "-m", mi.variant(), *options])
    if options:
        assert isinstance(opened[0], mi.Scene), done.output
    else:
        assert not opened
        assert isinstance(done.exception, OutsideError) and "--allow-outside" in str(done.exception)
