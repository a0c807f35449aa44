"""``mitsuba_prosim.show``: an image that converges in a notebook."""

import asyncio
import base64
import re
import signal
from types import SimpleNamespace
from unittest.mock import Mock

import mitsuba as mi
import mitsuba_prosim
import nbformat
import numpy as np
import prosim_scene
import pytest
from mitsuba_prosim.live import notebook
from mitsuba_prosim.live.progressive_image import ProgressiveImage
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
    with notebook.interrupting(lambda: stopped.append(True)):
        signal.raise_signal(signal.SIGINT)
    assert stopped == [True]
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_cell_that_runs_again_stops_its_view(monkeypatch):
    def made(cell, run):
        request = {"header": {"msg_id": run}, "metadata": {"cellId": cell}}
        monkeypatch.setattr("IPython.get_ipython", lambda: SimpleNamespace(get_parent=lambda: request))
        view = Mock()
        notebook.stop_earlier(view)
        return view

    one, other, elsewhere = made("a", "1"), made("a", "1"), made("b", "2")
    assert not (one.stop.called or other.stop.called)
    again = made("a", "3")
    assert one.stop.called and other.stop.called and not (again.stop.called or elsewhere.stop.called)
    monkeypatch.setattr("IPython.get_ipython", lambda: None)
    notebook.stop_earlier(Mock())


@pytest.mark.slow
def test_view_converges_while_the_notebook_runs_other_code(variant_rgb, path, monkeypatch):
    scene = mi.load_dict(prosim_scene.load(path))
    before = dict(vars(scene.integrator()))

    async def notebook():
        view = mitsuba_prosim.show(scene)
        turns = 0
        while not view.task.done():
            turns += 1
            await asyncio.sleep(0)
        return await view, turns

    view, turns = asyncio.run(notebook())
    assert turns > 2 and vars(scene.integrator()) == before
    assert np.array_equal(view.image, np.array(mi.render(scene)))
    assert view.layers["samples"].max() == 4 and view.layers["error"].shape == (48, 64)

    async def stopped(stop):
        view = mitsuba_prosim.show(path, spp=2**16)
        while "samples" not in view.layers:  # the first of several passes
            assert not view.task.done()
            await asyncio.sleep(0)
        stop(view)
        return await view

    for stop in (lambda view: view.stop(), lambda view: view.task.cancel()):  # as when the kernel is interrupted
        view = asyncio.run(stopped(stop))
        assert view.layers["samples"].min() < 2**16 and repr(view).startswith("<stopped: ")

    async def wrong():
        view = mitsuba_prosim.show(scene)
        with pytest.raises(RuntimeError, match="too much"):
            await view
        return view

    def step(*_):
        raise RuntimeError("too much")

    monkeypatch.setattr(ProgressiveImage, "step", step)
    assert repr(asyncio.run(wrong())) == "<not rendered: too much>"


@pytest.mark.notebook
def test_notebook_stores_a_still_image(path):
    cells = [
        "import mitsuba as mi, mitsuba_prosim; mi.set_variant('llvm_ad_rgb')",
        f"view = mitsuba_prosim.show({str(path)!r})\nview",
        "await view; view.image.shape",
        f"mitsuba_prosim.show({str(path)!r}, integrator=mi.load_dict({{'type': 'path'}})).wait(); None",
    ]
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
    NotebookClient(notebook, timeout=200).execute()
    for cell in (notebook.cells[1], notebook.cells[3]):
        (output,) = cell.outputs
        assert re.fullmatch(
            r"error (unknown|at most about [\d.]+) \(.*\), [\d.]+ samples a pixel, [\d.]+ s", output.data["text/plain"]
        )
        assert base64.b64decode(output.data["image/png"]).startswith(b"\x89PNG")
        assert "application/vnd.jupyter.widget-view+json" not in output.data
    assert notebook.cells[2].outputs[0].data["text/plain"] == "(48, 64, 3)"
