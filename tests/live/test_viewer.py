"""What the viewer shows after which request."""

import itertools
import os
import threading
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from little import LITTLE, is_, move, running, save, surface_at
from mitsuba_prosim import denoising
from mitsuba_prosim.engine.work import Executor
from mitsuba_prosim.live import progressive_image
from mitsuba_prosim.live.progressive_image import ProgressiveImage
from mitsuba_prosim.live.viewer import Viewer
from mitsuba_prosim.scene.scene_file import SceneFile
from waiting import PATIENCE, until

pytestmark = pytest.mark.slow

RED, BLUE = LITTLE, LITTLE.replace("kd = 0.6 0.2 0.1", "kd = 0.1 0.2 0.6")
LONG = LITTLE.replace("NSAMPLES: 2", "NSAMPLES: 100")


def final(viewer):
    return viewer.picture.layers["final"]


def seen(viewer):
    """The layers of all pictures, by their numbers."""
    return {picture.number: picture.layers for picture in viewer.said if picture is not None}


@pytest.fixture
def all_portions_seen(monkeypatch):
    """However small and quick they are."""
    monkeypatch.setattr(progressive_image, "DRAW_INTERVAL", 0)
    monkeypatch.setattr(progressive_image, "DRAW_FRACTION", 1e9)
    return lambda samples: monkeypatch.setattr(Executor, "limit", lambda *_: samples)


def test_viewer_names_what_makes_the_image_black_as_the_scene_does(variant_rgb, path):
    path.write_text(
        "LIGHTS POINT position 0 0 .5 Intensity 3 3 3 VIEW RESOLUTION 8 6 WINDOW -4 -3 4 3 EYE 0 0 10 VRP 0 0 0\n"
        "CSG-TREE + SPHERE 0\nCUBE 1 SURFACE 0 TRANSFORM 0 SURFACE 1 TRANSFORM 1 TRANSLATE (2 -1 -5) END"
    )
    with running(path) as viewer:
        is_(viewer, "done")
        assert "such as that of SPHERE 0 (line 2), CUBE 1 (line 3): " in viewer.state.black


def test_viewer_shows_a_coarse_image_first_and_the_rendered_image_last(
    variant_rgb, path, tmp_path, monkeypatch, all_portions_seen
):
    """Within a pass each pixel is that of its end, or that of before. An explanation on the way changes nothing."""
    all_portions_seen(12000)
    path.write_text(RED.replace("64 48", "200 150"))
    with running(path) as viewer:
        until(lambda: viewer.picture is not None)
        assert '"pixel": [90, 75]' in viewer.call(lambda viewer: viewer.explanation(90, 75)).result(PATIENCE)
        is_(viewer, "done")
        image = final(viewer)
        coarse, *shown = seen(viewer).values()
    first = [layers["final"] for layers in shown if set(layers) == {"final"}]
    begun, *later, last = shown[len(first) :]
    assert set(coarse) == {"final"} and len(first) > 2 and later
    old = coarse["final"].repeat(2, axis=0).repeat(2, axis=1)
    second = [layers["final"] for layers in later]
    for pictures, before, after in (first, old, begun["final"]), (second, begun["final"], last["final"]):
        news = [np.all(picture == after, axis=2) for picture in pictures]
        assert all(np.all(new | np.all(picture == before, axis=2)) for new, picture in zip(news, pictures))
        parts = [new.mean() for new in news]
        assert parts == sorted(set(parts)) and parts[0] > 0 and parts[-1] < 1
    scene = SceneFile(path, tmp_path / "again").load()
    assert np.array_equal(np.array(mi.render(scene)), image)


def test_coarse_image_has_the_colours_of_dispersion(variant_rgb, path, tmp_path):
    """And not one of them in each pixel."""
    path.write_text(RED.replace("kd = 0.6 0.2 0.1 ks = .3 .3 .3 n = 20", "material dieletrico bk7"))
    scene = SceneFile(path, tmp_path / "again").load()
    image = ProgressiveImage(scene.integrator(), scene, scene.sensors()[0], 0, 0)
    image.begin_coarse()
    coarse = image.layers()["final"]
    assert np.mean(coarse.min(axis=2) < 0.2 * coarse.max(axis=2)) < 0.1  # by one sample of each pixel 0.2


def test_viewer_shows_what_was_saved_last(variant_rgb, path):
    """Of many versions in the midst of a wave."""
    path.write_text(LONG)
    with running(path) as viewer:
        until(lambda: viewer.state.status == "rendering" and viewer.state.layers != ("final",))
        for text in [RED, LONG] * 25 + [BLUE]:
            path.write_text(text)
        until(lambda: viewer.state.status == "done" and final(viewer)[20, 30, 2] > final(viewer)[20, 30, 0])
        assert viewer.state.error is None


def test_watcher_waits_for_a_missing_file(variant_rgb, path, tmp_path, monkeypatch):
    """And one that is not whole yet, and is not caught by a pipe in the place of the scene."""
    path.write_text(LITTLE.replace("64 48", "8 6").replace("10000 NULL", '10000 "pictures/of/wood.png"'))
    wood, stream = tmp_path / "pictures" / "of" / "wood.png", mi.MemoryStream()
    mi.Bitmap(np.full((8, 8, 3), 128, np.uint8)).write(stream, mi.Bitmap.FileFormat.PNG)
    with running(path) as viewer:
        until(lambda: "'pictures/of/wood.png' does not exist" in (viewer.state.error or ""))
        wood.parent.mkdir(parents=True)
        wood.write_bytes(stream.raw_buffer()[:40])
        is_(viewer, "failed", 2)
        wood.write_bytes(stream.raw_buffer())
        is_(viewer, "done")
        assert {path, wood} <= viewer.watcher.stamps.keys()
        path.unlink()
        if hasattr(os, "mkfifo"):
            os.mkfifo(path)
            until(lambda: "a device or a pipe" in (viewer.state.error or ""))


def test_viewer_notices_a_change_while_it_opens_the_scene(variant_rgb, path, tmp_path, monkeypatch):
    """Also where the view is another one; and a mistake takes no view away that was moved."""
    texts = [BLUE]
    with running(path, lambda: texts and path.write_text(texts.pop())) as viewer:
        is_(viewer, "done", 2)
        assert final(viewer)[20, 30, 2] > final(viewer)[20, 30, 0]
        move(viewer, lambda camera: camera.orbited(40, 10))
        view = viewer.state.view
        save(viewer, path, BLUE.replace("kd", "kkd"))
        save(viewer, path, RED)
        is_(viewer, "done")
        assert viewer.state.view == view


def test_cancelled_call_does_not_stop_the_viewer(path):
    """As of a page that has asked for a pixel while a large scene was opened; they are no end of the viewer."""
    viewer, opened, done = Viewer(path, lambda: None), threading.Event(), []
    viewer.call(lambda _: opened.wait(PATIENCE))
    assert viewer.call(done.append).cancel()
    failed, last = viewer.call(lambda _: 1 / 0), viewer.call(lambda viewer: viewer.scene)
    opened.set()
    assert last.result(PATIENCE) is None and not done and isinstance(failed.exception(0), ZeroDivisionError)


def test_viewer_renders_other_integrators_and_sensors(variant_rgb, tmp_path, monkeypatch):
    """XML: ``path`` is put within ``prosim_adaptive``, all of its samples are taken; a crop window, a window sensor."""
    xml = """<scene version="3.0.0"><integrator type="path"/>
        <sensor type="SENSOR"><film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="12"/>
        <integer name="crop_width" value="8"/><integer name="crop_height" value="6"/><rfilter type="box"/></film>
        <sampler type="independent"><integer name="sample_count" value="9"/></sampler></sensor>
        <shape type="sphere" id="ball"><point name="center" x="0" y="0" z="5"/>
        <bsdf type="diffuse"><texture type="bitmap" name="reflectance">
        <string name="filename" value="pictures/wood.png"/></texture></bsdf></shape>
        <emitter type="constant"/></scene>"""
    path = Path(tmp_path / "scene.xml")
    wood = tmp_path / "pictures" / "wood.png"
    wood.parent.mkdir()
    mi.util.write_bitmap(str(wood), np.full((2, 2, 3), 0.5), write_async=False)
    for sensor in ("prosim_window", "perspective"):
        path.write_text(xml.replace("SENSOR", sensor))
        with running(path) as viewer:
            is_(viewer, "done")
            state = viewer.state
            assert state.size == (8, 6) and state.samples == 9
            assert {path, wood} <= viewer.watcher.stamps.keys()
            before = final(viewer)
            assert surface_at(viewer, 7, 5) == "scene.xml, line 5 (ball)"
            move(viewer, lambda camera: camera.panned(0.3, 0))
            assert "<matrix" in viewer.state.view
            assert not np.array_equal(final(viewer), before)
    path.write_text(xml)  # there is no sensor of this name
    with running(path) as viewer:
        until(lambda: viewer.state.error)
        quoted, caret = viewer.state.error.splitlines()[-2:]
        assert quoted[caret.index("^") :].startswith('sensor type="SENSOR"')


def test_viewer_denoises_the_final_image(variant_rgb, denoiser, path, tmp_path, monkeypatch, all_portions_seen):
    """As ``prosim render --denoise`` does it, to the bit; and on the way there is a whole image, of more and more."""
    all_portions_seen(1500)
    with running(path, denoise=True) as viewer:
        is_(viewer, "done")
        whole = [layers["samples"] for layers in seen(viewer).values() if set(layers) == {"final", "error", "samples"}]
        assert len(whole) > 3 and all(np.all(a <= b) and np.any(a < b) for a, b in itertools.pairwise(whole))
        layers = viewer.picture.layers
    expected = denoising.render(SceneFile(path, tmp_path / "again").load())
    for name in ("final", "raw", "denoised"):
        assert np.array_equal(layers[name], getattr(expected, name)), name
    assert np.array_equal(layers["error"], expected.final_error)


# ---- What goes wrong after a scene was opened: the page stays, and the next save is awaited


XML = """<scene version="3.0.0">INTEGRATOR<sensor type="perspective"><film type="hdrfilm">
<integer name="width" value="8"/><integer name="height" value="6"/></film></sensor>
<shape type="sphere"><point name="center" x="0" y="0" z="5"/></shape><emitter type="constant"/></scene>"""


def test_viewer_survives_an_image_that_fails(variant_rgb, write_scene, monkeypatch):
    """By an integrator that takes no samples from the sensor, and by what nobody has foreseen; whatever is asked for
    then, until there is something that can be rendered.
    """
    path = write_scene(XML.replace("INTEGRATOR", '<integrator type="ptracer"/>'), "scene.xml")

    def asked(words):
        assert words in viewer.state.error
        assert surface_at(viewer, 4, 3).startswith("Sphere") and surface_at(viewer, 0, 0) == "background"
        with pytest.raises(ValueError, match="no image"):
            viewer.call(lambda viewer: viewer.result()).result(PATIENCE)
        assert viewer.state.status == "failed" and words in viewer.state.error

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
        assert viewer.state.error is None
