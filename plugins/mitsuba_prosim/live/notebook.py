"""An image that converges in a notebook."""

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

#: Seconds that the notebook has for itself after each work item.
BREATH = 0.005

#: Effort of zlib for a picture that will be replaced soon.
PASSING = 1

#: Map -> what it is called beside its scale.
MAPS = {"error": "Standard error of the luminance", "samples": "Samples of a pixel"}


#: Cell of a notebook -> its last run, and the views that this has made. They are stopped when the cell is run again, as
#: nobody can see or stop them any more.
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
        Of what is shown, in stops.

    Returns at once: the image grows while the notebook has nothing else to do. ``await view``, or ``view.wait()``,
    which keeps the notebook busy, wait for its end, and to interrupt the kernel meanwhile is to stop it; where there is
    no notebook, that is done before it returns. In the end a picture, or what has gone wrong, takes the place of the
    buttons, and stays in the saved notebook; ``view.image`` is the linear image, ``view.layers`` has the maps of
    ``error`` and ``samples`` beside it. An image whose cell is run again is stopped.

    Raises ImportError where ipywidgets is not installed, RuntimeError in scalar variants and where no variant is set,
    and what the scene's maker raises.
    """
    if mi.variant() is None:
        raise RuntimeError("show: no variant is set; set one before, as by mi.set_variant('llvm_ad_rgb').")
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
    """Stops the views that earlier runs of this cell have made. Does nothing outside of a notebook, and where it does
    not tell its cells.
    """
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
    """An image in progress in a notebook; :func:`show` makes it."""

    def __init__(self, image: ProgressiveImage, exposure: float) -> None:
        try:
            import ipywidgets as widgets
        except ImportError as error:
            raise ImportError(extras.needs("show", "notebooks")) from error
        from IPython.display import display

        #: What renders it in the background, where there is a notebook.
        self.task: asyncio.Task[None] | None = None
        self._image, self._factor = image, np.float32(2**exposure)
        self._picture: Picture | None = None
        self._stopped, self._throttle = False, Throttle()
        self._words_in_the_end: str | None = None
        self._wrong: str | None = None
        self._begun = time.perf_counter()
        self._steps = self._render()
        self._shown = widgets.Image(format="png", layout=widgets.Layout(max_width="100%"))
        self._layer = widgets.ToggleButtons(options=[(name.capitalize(), name) for name in LAYERS], value="final")
        self._layer.observe(lambda _: self._draw(), names="value")
        self._part = widgets.FloatProgress(min=0, max=1, layout=widgets.Layout(width="12em"))
        self._said = widgets.Label("compiling kernels")
        stop = widgets.Button(description="Stop", icon="stop")
        stop.on_click(lambda _: self.stop())
        # Above the picture, however high it is; a line that is too long for the cell becomes two.
        controls = widgets.HBox([stop, self._part, self._said, self._layer], layout={"flex_flow": "row wrap"})
        self._scale = widgets.HTML()
        self._box = widgets.VBox([controls, self._scale, self._shown], layout={"align_items": "flex-start"})
        self._place = display(self._box, display_id=True)

    def __repr__(self) -> str:
        return f"<{self._words_in_the_end or self._said.value}>"

    @property
    def layers(self) -> dict[str, np.ndarray]:
        """The image as it was drawn last, ``final`` (height, width, 3), linear, and the maps ``error``, the standard
        error of its luminance, and ``samples`` (height, width); empty before the first pass is complete.
        """
        return dict(self._picture.layers) if self._picture is not None else {}

    @property
    def image(self) -> np.ndarray:
        """The linear image, shape (height, width, 3). Raises ValueError before the first pass is complete."""
        if self._picture is None:
            raise ValueError("show: there is no image yet; wait for it with view.wait()")
        return self._picture.layers["final"]

    def stop(self) -> None:
        """Ends it with what there is; before the first pass is complete, with nothing."""
        self._stopped = True

    def wait(self) -> View:
        """Renders to the end, without pause. Ctrl-C, or to interrupt the kernel, stops it."""
        with self._ended():
            for _ in self._steps:
                pass
        return self

    def __await__(self) -> Generator[Any, None, View]:
        """Waits for the end, while the notebook does other things. To interrupt the kernel stops it."""
        if self.task is not None:
            yield from self.task.__await__()
            self._finish()  # once more, from the cell that waits: what runs a notebook may hear no other
        return self

    async def converge(self) -> None:
        """Renders to the end, work item by work item; to cancel it stops it."""
        with self._ended():
            try:
                for _ in self._steps:
                    await asyncio.sleep(BREATH)
            except (KeyboardInterrupt, asyncio.CancelledError):
                self.stop()

    @contextmanager
    def _ended(self) -> Iterator[None]:
        """Says in the end what there is, or what has gone wrong."""
        try:
            yield
        except Exception as error:
            self._wrong = session.message(error)
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
        """Draws the image so far; within the first pass only as a preview, black where there are no samples."""
        with self._throttle.drawing():
            layers = self._image.layers() or {}
            if set(LAYERS) <= set(layers):
                self._picture = Picture(0, layers)
                self._draw()
            elif layers:
                self._shown.value = self._png(layers["final"], PASSING)
                self._said.value = f"the first pass, {time.perf_counter() - self._begun:.1f} s"

    def _png(self, values: np.ndarray, effort: int = -1) -> bytes:
        if values.ndim == 2:
            # As png makes of linear values what a screen shows.
            return png(coloured(values).astype(np.float32) ** np.float32(2.2), effort=effort)
        return png(compress(values * self._factor), effort=effort)

    def _draw(self) -> None:
        if self._picture is None:
            return
        layer = self._layer.value
        values = self._picture.layers[layer]
        self._shown.value = self._png(values, PASSING)
        self._scale.value = scale(MAPS[layer], values) if layer in MAPS else ""
        self._said.value = self._words()

    def _words(self) -> str:
        assert self._picture is not None
        mean = float(self._picture.layers["samples"].mean())
        return f"{mean:.1f} samples a pixel, {time.perf_counter() - self._begun:.1f} s"

    def _last_words(self) -> str:
        if self._wrong is not None:
            return f"not rendered: {self._wrong}"
        if self._picture is None:
            return "stopped before the first pass"
        return ("stopped: " if self._stopped else "") + self._words()

    def _finish(self) -> None:
        """Leaves a still picture, in the place of what needs the kernel."""
        if self._words_in_the_end is None:
            self._words_in_the_end = self._last_words()
            self._box.close()
        if self._place is None:  # there is no IPython that runs
            return
        still = {"text/plain": self._words_in_the_end}
        if self._picture is not None and self._wrong is None:
            still["image/png"] = base64.b64encode(self._png(self._picture.layers["final"])).decode()
        self._place.update(still, metadata={"image/png": {"alt": self._words_in_the_end}}, raw=True)


@contextmanager
def interrupting(stop: Callable[[], None]) -> Iterator[None]:
    """Calls ``stop`` where the kernel is interrupted, and lets the work item come to its end: an exception in the midst
    of what Dr.Jit traces would leave that unfinished.
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
    """What the colours of a map mean, as HTML: its middle is a quarter of its end, by the square root."""
    hues = ", ".join("rgb({:.0f} {:.0f} {:.0f})".format(*255 * hue) for hue in HUES)
    white = palest(values)
    return (
        f'{what}: 0 <span style="display: inline-block; width: 6em; height: 0.8em; background: '
        f'linear-gradient(to right, {hues})"></span> {white:.2g} or more; in the middle {white / 4:.2g}'
    )
