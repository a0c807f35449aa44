"""``mitsuba_prosim.show``: an image that converges in a notebook."""

import base64
import signal

import mitsuba as mi
import mitsuba_prosim
import nbformat
import numpy as np
import prosim_scene
import pytest
from mitsuba_prosim.live.progressive_image import ProgressiveImage
from mitsuba_prosim.live.result import interrupting
from nbclient import NotebookClient


def test_show_without_a_variant_says_what_to_do(path, monkeypatch):
    monkeypatch.setattr(mi, "variant", lambda: None)
    with pytest.raises(RuntimeError, match=r"^show: no variant is set"):
        mitsuba_prosim.show(path)


def test_interrupt_stops_the_render_after_the_work_item(monkeypatch):
    """And stops the image then."""
    stopped = []
    # Mitsuba's scalar integrators, in other tests of this process, leave a handler that ends it.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with interrupting(lambda: stopped.append(True)):
        signal.raise_signal(signal.SIGINT)
    assert stopped == [True]
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


@pytest.mark.slow
def test_show_has_the_image_of_the_scene(variant_rgb, path, monkeypatch):
    """Also if the kernel is interrupted, in the first pass or later."""
    scene = mi.load_dict(prosim_scene.load(path))
    assert np.array_equal(mitsuba_prosim.show(scene), np.array(mi.render(scene)))
    step = ProgressiveImage.step

    def interrupted(image):
        due = step(image)
        if image.render.counts().max() > most:
            signal.raise_signal(signal.SIGINT)
        return due

    monkeypatch.setattr(ProgressiveImage, "step", interrupted)
    for most in 0, 100:
        result = mitsuba_prosim.show(scene, spp=2**16)
        assert most < result.samples.max() < 2**16 and result.error.shape == (48, 64)


@pytest.mark.notebook
def test_notebook_stores_the_last_image(path):
    cells = [
        "import mitsuba as mi, mitsuba_prosim, numpy as np; mi.set_variant('llvm_ad_rgb')",
        f"result = mitsuba_prosim.show({str(path)!r})",
        "np.array(result).shape",
    ]
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
    NotebookClient(notebook, timeout=200).execute()
    (output,) = notebook.cells[1].outputs
    assert output.data["text/plain"].startswith("error ")
    assert base64.b64decode(output.data["image/png"]).startswith(b"\x89PNG")
    assert notebook.cells[2].outputs[0].data["text/plain"] == "(48, 64, 3)"
