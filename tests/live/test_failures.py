"""What goes wrong after a scene was opened, and in telling it: the page stays, and the next save is awaited."""

import pytest
from little import change, is_, move, running, save, surface_at
from mitsuba_prosim.live.progressive_image import ProgressiveImage
from waiting import PATIENCE

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
        change(viewer, paused=True)
        change(viewer, paused=False)
        assert surface_at(viewer, 4, 3).startswith("Sphere")
        with pytest.raises(ValueError, match="no image"):
            viewer.call(lambda viewer: viewer.result()).result(PATIENCE)
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
        assert viewer.publisher.state.error is None
