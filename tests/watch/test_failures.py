"""What goes wrong after a scene was opened, and in telling it: the page stays, and the next save is awaited."""

import threading
from contextlib import contextmanager

import numpy as np
import pytest
from little import LITTLE, until
from mitsuba_prosim.compare.scenes import sky
from mitsuba_prosim.scene.scene_file import SceneFile, pick_sensor
from mitsuba_prosim.watch.studio import Studio, SupersededError
from mitsuba_prosim.watch.takes import Take

pytestmark = pytest.mark.slow

XML = """<scene version="3.0.0">INTEGRATOR<sensor type="perspective"><film type="hdrfilm">
<integer name="width" value="8"/><integer name="height" value="6"/></film></sensor>
<shape type="sphere"><point name="center" x="0" y="0" z="5"/></shape><emitter type="constant"/></scene>"""


@contextmanager
def running(path):
    def opener(document):
        file = SceneFile(path, path.parent / "scratch", document=document)
        scene = file.load()
        return file, scene, pick_sensor(scene, 0)

    studio = Studio(path, opener)
    thread = threading.Thread(target=studio.run)
    thread.start()
    try:
        yield studio
        assert thread.is_alive()
    finally:
        studio.desk.leave()
        thread.join(30)


def is_(studio, doing, saves=0):
    until(lambda: studio.board.state.doing == doing and studio.board.state.saves == saves)


def save(studio, path, text):
    path.write_text(text)
    studio.desk.saved()


def test_an_image_that_fails(variant_rgb, tmp_path, monkeypatch):
    """By an integrator that takes no samples from the sensor, and by what nobody has foreseen; whatever is asked for
    then, until there is something that can be rendered.
    """
    path = tmp_path / "scene.xml"
    path.write_text(XML.replace("INTEGRATOR", '<integrator type="ptracer"/>'))

    def asked(words):
        assert words in studio.board.state.error
        studio.desk.compare(True)
        studio.desk.stop()
        studio.desk.stop(False)
        assert studio.desk.errand(lambda subject: subject.seen(4, 3)).result(20).startswith("Sphere")
        studio.desk.compare(False)
        assert studio.board.state.doing == "failed" and words in studio.board.state.error

    with running(path) as studio:
        is_(studio, "failed")
        asked("takes samples from a sensor")
        with monkeypatch.context() as patch:
            patch.setattr(Take, "step", lambda *_: {}["unforeseen"])
            save(studio, path, XML.replace("INTEGRATOR", ""))
            is_(studio, "failed", 1)
            asked("KeyError: 'unforeseen'")
        studio.desk.move(lambda camera: camera.orbited(10, 0))
        is_(studio, "done", 1)
        assert studio.board.state.integrator == "path" and studio.board.state.error is None


def test_a_camera_that_is_moved_and_back_before_it_is_looked_at(variant_rgb, tmp_path, monkeypatch):
    path, step, studios = tmp_path / "little.scn", Take.step, []
    path.write_text(LITTLE)

    def there_and_back(take, between):
        def moved(*said):
            if studios:
                studios.pop().desk.move(lambda camera: camera.orbited(10, 0))
            between(*said)

        try:
            return step(take, moved)
        except SupersededError:
            studio.desk.home()
            raise

    monkeypatch.setattr(Take, "step", there_and_back)
    with running(path) as studio:
        is_(studio, "done")
        before = studio.board.pictures["own"]
        studios.append(studio)
        save(studio, path, LITTLE)
        is_(studio, "done", 1)
        assert not studios and studio.board.state.view is None
        image = studio.board.pictures["own"]
        assert image is not before and np.array_equal(image.layers["final"], before.layers["final"])


def test_a_background_that_path_cannot_be_lit_by(variant_rgb, tmp_path):
    path = tmp_path / "scene.xml"
    squares = '<integrator type="prosim"><texture type="checkerboard" name="background"/></integrator>'
    path.write_text(XML.replace("INTEGRATOR", squares))
    with running(path) as studio:
        is_(studio, "done")
        assert "no bitmap" in studio.board.state.alone
        studio.desk.compare(True)
        is_(studio, "done")
        assert set(studio.board.pictures) == {"own"} and studio.board.state.error is None
        background = studio.desk.errand(lambda subject: subject.scene.integrator().background).result(20)
        with pytest.raises(ValueError, match=r"Checkerboard can't light the scene .* a colour or a bitmap"):
            sky(background)  # as prosim compare has it


def test_the_path_of_another_scene_is_not_compared(variant_rgb, tmp_path, monkeypatch):
    """Where there is a crop window, and so no picture before the first wave; and channels that path's has not."""
    path = tmp_path / "scene.xml"
    window = '<integer name="crop_width" value="4"/><integer name="crop_height" value="3"/></film>'
    maps = '<integrator type="prosim"><string name="aovs" value="samples,sn:sh_normal"/></integrator>'
    path.write_text(XML.replace("INTEGRATOR", maps).replace("</film>", window))
    with running(path) as studio:
        studio.desk.compare(True)
        until(lambda: studio.board.state.doing == "done" and studio.board.state.compared)
        before, say, seen = dict(studio.board.state.pictures), studio.board.say, []

        def heard(*said, **changes):
            say(*said, **changes)
            seen.append(dict(studio.board.state.pictures))

        monkeypatch.setattr(studio.board, "say", heard)
        save(studio, path, path.read_text().replace('z="5"', 'z="6"'))
        is_(studio, "done", 1)
    later = [pictures for pictures in seen if pictures["own"] != before["own"]]
    assert "path" in later[-1] and before["path"] not in [pictures.get("path") for pictures in later]
