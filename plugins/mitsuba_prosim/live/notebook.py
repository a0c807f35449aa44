"""A progressive image in a notebook."""

from __future__ import annotations

import asyncio
import base64
import signal
import threading
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from weakref import WeakSet

import mitsuba as mi
import numpy as np
import prosim_scene
from prosim_scene import extras

from ..scene import session
from ..scene.images import compress, png
from .image import ProgressiveImage, progressive
from .picture import HUES, LAYERS, Picture, coloured, palest
from .throttle import Throttle

#: Seconds that other tasks of the notebook get after each work item.
BREATH = 0.005

#: Effort of zlib for an image that is replaced soon.
PASSING = 1

#: Map -> its title next to the scale.
MAPS = {"error": "Standard error of the luminance", "samples": "Samples of a pixel"}


#: Cell of a notebook -> its last run, and the views of this run. Running the cell again removes them from the screen,
#: so they are stopped then.
_made: dict[str, tuple[str, WeakSet[View]]] = {}


def show(
    scene: mi.Scene | str | Path,
    sensor: int | mi.Sensor = 0,
    integrator: mi.Integrator | None = None,
    seed: int = 0,
    spp: int = 0,
    exposure: float = 0.0,
) -> View:
    """Shows in a notebook how the image of ``scene`` converges, with its error, its samples and a button to stop.

    ``scene``
        A scene of Mitsuba's, or the path of a file in the thesis's language or XML.
    ``sensor``, ``integrator``, ``seed``, ``spp``
        As for ``mi.render``; an integrator that renders as a whole is put within ``prosim_adaptive``.
    ``exposure``
        Exposure of the shown image, in stops.

    Returns at once: the image is rendered while the notebook is idle. ``await view`` waits for the end, and so does
    ``view.wait()``, which keeps the notebook busy; interrupting the kernel stops the image. Without a notebook the
    function returns at the end. Then an image, or an error, replaces the buttons, and the notebook saves it.
    ``view.image`` is the linear image, ``view.layers`` also has the maps ``error`` and ``samples``. Running the cell
    again stops the image.

    Raises ImportError where ipywidgets is not installed, RuntimeError in scalar variants and where no variant is set,
    and the errors of the function that makes the scene.
    """
    if mi.variant() is None:
        raise RuntimeError("show: no variant is set; set one before, such as mi.set_variant('llvm_ad_rgb').")
    if str(mi.variant()).startswith("scalar"):
        raise RuntimeError("show: scalar variants do not render progressively; use an llvm or cuda variant.")
    if isinstance(scene, (str, Path)):
        xml = Path(scene).suffix.lower() == ".xml"
        scene = mi.load_file(str(scene)) if xml else mi.load_dict(prosim_scene.load(scene))
    if isinstance(sensor, int):
        sensor = scene.sensors()[sensor]
    chosen, spp = progressive(integrator or scene.integrator(), sensor, spp)
    view = View(ProgressiveImage(chosen, scene, sensor, spp, seed), exposure)
    stop_earlier(view)
    try:
        loop = asyncio.get_running_loop()
    except RuntimeError:
        view.wait()
    else:
        view.task = loop.create_task(view.converge())
    return view


def stop_earlier(view: View) -> None:
    """Stops the views of earlier runs of this cell, if the notebook identifies its cells."""
    from IPython import get_ipython

    request: dict[str, Any] = getattr(get_ipython(), "get_parent", dict)()
    cell, run = request.get("metadata", {}).get("cellId"), request.get("header", {}).get("msg_id")
    if cell is None or run is None:
        return
    last, views = _made.get(cell, (None, WeakSet[View]()))
    if last != run:
        for earlier in views:
            earlier.stop()
        views = WeakSet()
        _made[cell] = run, views
    views.add(view)


class View:
    """A progressive image in a notebook; :func:`show` makes it."""

    def __init__(self, image: ProgressiveImage, exposure: float) -> None:
        try:
            import ipywidgets as widgets
        except ImportError as error:
            raise ImportError(extras.needs("show", "notebooks")) from error
        from IPython.display import display

        #: The task that renders in the background, in a notebook.
        self.task: asyncio.Task[None] | None = None
        self._image, self._factor = image, np.float32(2**exposure)
        self._picture: Picture | None = None
        self._stopped, self._throttle = False, Throttle()
        self._final_text: str | None = None
        self._error: str | None = None
        self._begun = time.perf_counter()
        self._steps = self._render()
        self._shown = widgets.Image(format="png", layout=widgets.Layout(max_width="100%"))
        self._layer = widgets.ToggleButtons(options=[(name.capitalize(), name) for name in LAYERS], value="final")
        self._layer.observe(lambda _: self._draw(), names="value")
        self._part = widgets.FloatProgress(min=0, max=1, layout=widgets.Layout(width="12em"))
        self._label = widgets.Label("compiling kernels")
        stop = widgets.Button(description="Stop", icon="stop")
        stop.on_click(lambda _: self.stop())
        # Above the picture, however high it is; a line that is too long for the cell becomes two.
        controls = widgets.HBox([stop, self._part, self._label, self._layer], layout={"flex_flow": "row wrap"})
        self._scale = widgets.HTML()
        self._box = widgets.VBox([controls, self._scale, self._shown], layout={"align_items": "flex-start"})
        self._place = display(self._box, display_id=True)

    def __repr__(self) -> str:
        return f"<{self._final_text or self._label.value}>"

    @property
    def layers(self) -> dict[str, np.ndarray]:
        """The image that was drawn last: ``final`` (height, width, 3), linear, and the maps ``error``, the standard
        error of its luminance, and ``samples`` (height, width). Empty before the first pass is complete.
        """
        return dict(self._picture.layers) if self._picture is not None else {}

    @property
    def image(self) -> np.ndarray:
        """The linear image, shape (height, width, 3). Raises ValueError before the first pass is complete."""
        if self._picture is None:
            raise ValueError("show: there is no image yet; wait for it with view.wait()")
        return self._picture.layers["final"]

    def stop(self) -> None:
        """Ends the render and keeps the image, if the first pass is complete."""
        self._stopped = True

    def wait(self) -> View:
        """Renders to the end. Ctrl-C, or interrupting the kernel, stops the image."""
        with self._ended():
            for _ in self._steps:
                pass
        return self

    def __await__(self) -> Generator[Any, None, View]:
        """Waits for the end, while the notebook runs other tasks. Interrupting the kernel stops the image."""
        if self.task is not None:
            yield from self.task.__await__()
            self._finish()  # again, from the cell that waits: some programs that run notebooks receive no other output
        return self

    async def converge(self) -> None:
        """Renders work item by work item; cancelling the task stops the image."""
        with self._ended():
            try:
                for _ in self._steps:
                    await asyncio.sleep(BREATH)
            except (KeyboardInterrupt, asyncio.CancelledError):
                self.stop()

    @contextmanager
    def _ended(self) -> Iterator[None]:
        """Shows the final image at the end, or the error."""
        try:
            yield
        except Exception as error:
            self._error = session.message(error)
            raise
        finally:
            self._finish()

    def _render(self) -> Iterator[None]:
        while not self._image.done and not self._stopped:
            with interrupting(self.stop):
                complete = self._image.step()
                self._part.value = self._image.part
                if self._stopped or (self._image.new and (complete or self._throttle)):
                    self._look()
            yield

    def _look(self) -> None:
        """Draws the image so far; during the first pass a preview, black where there are no samples."""
        with self._throttle.drawing():
            layers = self._image.layers() or {}
            if set(LAYERS) <= set(layers):
                self._picture = Picture(0, layers)
                self._draw()
            elif layers:
                self._shown.value = self._png(layers["final"], PASSING)
                self._label.value = f"the first pass, {time.perf_counter() - self._begun:.1f} s"

    def _png(self, values: np.ndarray, effort: int = -1) -> bytes:
        if values.ndim == 2:
            # The tone curve of png.
            return png(coloured(values).astype(np.float32) ** np.float32(2.2), effort=effort)
        return png(compress(values * self._factor), effort=effort)

    def _draw(self) -> None:
        if self._picture is None:
            return
        layer = self._layer.value
        values = self._picture.layers[layer]
        self._shown.value = self._png(values, PASSING)
        self._scale.value = scale(MAPS[layer], values) if layer in MAPS else ""
        self._label.value = self._text()

    def _text(self) -> str:
        assert self._picture is not None
        mean = float(self._picture.layers["samples"].mean())
        return f"{mean:.1f} samples a pixel, {time.perf_counter() - self._begun:.1f} s"

    def _end_text(self) -> str:
        if self._error is not None:
            return f"not rendered: {self._error}"
        if self._picture is None:
            return "stopped before the first pass"
        return ("stopped: " if self._stopped else "") + self._text()

    def _finish(self) -> None:
        """Replaces the widgets, which need the kernel, by a still image."""
        if self._final_text is None:
            self._final_text = self._end_text()
            self._box.close()
        if self._place is None:  # there is no IPython that runs
            return
        still = {"text/plain": self._final_text}
        if self._picture is not None and self._error is None:
            still["image/png"] = base64.b64encode(self._png(self._picture.layers["final"])).decode()
        self._place.update(still, metadata={"image/png": {"alt": self._final_text}}, raw=True)


@contextmanager
def interrupting(stop: Callable[[], None]) -> Iterator[None]:
    """Calls ``stop`` if the kernel is interrupted, and lets the work item end: an exception would leave an unfinished
    trace in Dr.Jit.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, lambda *_: stop())
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def scale(what: str, values: np.ndarray) -> str:
    """The scale of a map as HTML. The middle is a quarter of the end, as colours follow the square root."""
    hues = ", ".join("rgb({:.0f} {:.0f} {:.0f})".format(*255 * hue) for hue in HUES)
    white = palest(values)
    return (
        f'{what}: 0 <span style="display: inline-block; width: 6em; height: 0.8em; background: '
        f'linear-gradient(to right, {hues})"></span> {white:.2g} or more; in the middle {white / 4:.2g}'
    )
