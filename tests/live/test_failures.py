"""What goes wrong after a scene was opened, and in telling it: the page stays, and the next save is awaited."""

import pytest
from little import change, is_, move, running, save, surface_at
from mitsuba_prosim.live.progressive_image import ProgressiveImage
from mitsuba_prosim.scene.background import with_background_emitter
from waiting import PATIENCE, until

pytestmark = pytest.mark.slow

XML = """<scene version="3.0.0">INTEGRATOR<sensor type="perspective"><film type="hdrfilm">
<integer name="width" value="8"/><integer name="height" value="6"/></film></sensor>
<shape type="sphere"><point name="center" x="0" y="0" z="5"/></shape><emitter type="constant"/></scene>"""


def test_viewer_survives_an_image_that_fails(variant_rgb, write_scene, monkeypatch):
    """By an integrator that takes no samples from the sensor, and by what nobody has foreseen; whatever is asked for
    then, until there is something that can be rendered.
    """
    path = write_scene(XML.replace("INTEGRATOR", '<integrator type="ptracer"/>'), "scene.xml")

    def asked(words):
        assert words in viewer.publisher.state.error
        change(viewer, compared=True)
        change(viewer, paused=True)
        change(viewer, paused=False)
        assert surface_at(viewer, 4, 3).startswith("Sphere")
        change(viewer, compared=False)
        assert viewer.publisher.state.status == "failed" and words in viewer.publisher.state.error

    with running(path) as viewer:
        is_(viewer, "failed")
        asked("takes samples from a sensor")
        with monkeypatch.context() as patch:
            patch.setattr(ProgressiveImage, "step", lambda *_: {}["unforeseen"])
            save(viewer, path, XML.replace("INTEGRATOR", ""))
            is_(viewer, "failed", 2)
            asked("KeyError: 'unforeseen'")
        move(viewer, lambda camera: camera.orbited(10, 0))
        is_(viewer, "done", 2)
        assert viewer.publisher.state.integrator == "path" and viewer.publisher.state.error is None


def test_viewer_does_not_compare_a_background_that_path_cannot_use(variant_rgb, write_scene):
    squares = '<integrator type="prosim"><texture type="checkerboard" name="background"/></integrator>'
    path = write_scene(XML.replace("INTEGRATOR", squares), "scene.xml")
    with running(path) as viewer:
        is_(viewer, "done")
        assert "not a bitmap" in viewer.publisher.state.not_compared
        change(viewer, compared=True)
        is_(viewer, "done")
        assert set(viewer.publisher.pictures) == {"own"} and viewer.publisher.state.error is None
        scene = viewer.call(lambda viewer: viewer.scene.scene).result(PATIENCE)
        with pytest.raises(ValueError, match="Checkerboard can't light the scene"):
            with_background_emitter(scene, scene.integrator().background)  # as prosim compare has it


def test_comparison_forgets_the_previous_scene(variant_rgb, write_scene):
    """With a crop window, and with channels that path does not have."""
    window = '<integer name="crop_width" value="4"/><integer name="crop_height" value="3"/></film>'
    maps = '<integrator type="prosim"><string name="aovs" value="samples,sn:sh_normal"/></integrator>'
    path = write_scene(XML.replace("INTEGRATOR", maps).replace("</film>", window), "scene.xml")
    with running(path) as viewer:
        change(viewer, compared=True)
        until(lambda: viewer.publisher.state.status == "done" and viewer.publisher.state.compared)
        before, count = dict(viewer.publisher.state.pictures), len(viewer.publisher.said)
        save(viewer, path, path.read_text().replace('z="5"', 'z="6"'))
        is_(viewer, "done", 2)
        seen = [state.pictures for state, _ in viewer.publisher.said[count:]]
    later = [pictures for pictures in seen if pictures["own"] != before["own"]]
    assert "path" in later[-1] and before["path"] not in [pictures.get("path") for pictures in later]
