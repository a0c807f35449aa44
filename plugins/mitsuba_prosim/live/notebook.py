"""Shows a progressive image in a notebook."""

from __future__ import annotations

import asyncio
import base64
import signal
import threading
import time
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager
from typing import Any
from weakref import WeakKeyDictionary

import mitsuba as mi
import numpy as np
from prosim_scene import extras

from ..explaining.verdict import verdict
from ..scene import session
from ..scene.images import compress, png
from ..scene.scene_file import pick_sensor
from .picture import LAYERS, as_png, white_of
from .progressive_image import ProgressiveImage
from .result import AnyScene, load

#: Seconds after each work item in which the notebook can run other tasks.
PAUSE = 0.005

#: Compression level of zlib for an image that is replaced soon.
FAST = 1

#: View -> (id of the notebook's cell, id of the execution of this cell) that made the view. If the cell runs again, the
#: view disappears from the screen.
_made: WeakKeyDictionary[View, tuple[str | None, str | None]] = WeakKeyDictionary()


def show(
    scene: AnyScene,
    sensor: int | mi.Sensor = 0,
    integrator: mi.Integrator | None = None,
    seed: int = 0,
    spp: int = 0,
    exposure: float = 0.0,
) -> View:
    """Renders ``scene`` progressively in a notebook, and shows the image, maps of its error and of its sample counts,
    and a button that stops the render.

    ``scene``
        A Mitsuba scene, the dictionary of one, or the path of a scene file in the thesis's scene language or in XML.
    ``sensor``, ``integrator``, ``seed``, ``spp``
        As in ``mi.render``; an integrator that is not progressive is nested in ``prosim_adaptive``.
    ``exposure``
        Exposure of the shown image, in stops.

    In a notebook, this function returns a ``view`` at once, and the image is rendered while the notebook is idle.
    ``await view`` waits for the end of the render; ``view.wait()`` does so, too, but blocks the notebook. The render
    stops if you interrupt the kernel or run the cell again. Outside a notebook, this function returns at the end of the
    render.

    At the end, a still image or an error message replaces the widgets, and is stored in the notebook file.
    ``view.image`` is the image in linear colours, and the dictionary ``view.layers`` has also the maps.

    Raises ImportError if ipywidgets is not installed, RuntimeError if the variant is scalar or not set, and the errors
    of loading the scene.
    """
    scene = load("show", scene)
    sensor = pick_sensor(scene, sensor) if isinstance(sensor, int) else sensor
    view = View(ProgressiveImage(integrator or scene.integrator(), scene, sensor, spp, seed), exposure)
    stop_earlier(view)
    try:
        loop = asyncio.get_running_loop()
    except RuntimeError:
        view.wait()
    else:
        view.task = loop.create_task(view.converge())
    return view


def stop_earlier(view: View) -> None:
    """Stops the views that earlier executions of the cell of ``view`` made, if the notebook program tells its cells;
    stores the cell of ``view`` in :data:`_made`.
    """
    cell, run = executed_cell()
    for earlier, (its_cell, its_run) in _made.items():
        if cell is not None and its_cell == cell and its_run != run:
            earlier.stop()
    _made[view] = cell, run


def executed_cell() -> tuple[str | None, str | None]:
    """Returns the id of the notebook's cell that is executed, and the id of this execution; None where unknown."""
    from IPython import get_ipython

    request: dict[str, Any] = getattr(get_ipython(), "get_parent", dict)()
    return request.get("metadata", {}).get("cellId"), request.get("header", {}).get("msg_id")


class View:
    """A progressive image in a notebook; the function :func:`show` makes and returns this object."""

    def __init__(self, image: ProgressiveImage, exposure: float) -> None:
        try:
            import ipywidgets as widgets
        except ImportError as error:
            raise ImportError(extras.needs("show", "notebooks")) from error
        from IPython.display import display

        #: In a notebook, the task that renders in the background.
        self.task: asyncio.Task[None] | None = None
        self._image, self._factor = image, np.float32(2**exposure)
        self._layers: Mapping[str, np.ndarray] = {}
        self._stopped, self._started = False, time.perf_counter()
        self._steps = self._render()
        self._shown = widgets.Image(format="png", layout=widgets.Layout(max_width="100%"))
        self._layer = widgets.ToggleButtons(options=[(name.capitalize(), name) for name in LAYERS], value="final")
        self._layer.observe(lambda _: self._draw(), names="value")
        self._progress = widgets.FloatProgress(min=0, max=1, layout=widgets.Layout(width="12em"))
        self._label = widgets.Label("compiling kernels")
        stop = widgets.Button(description="Stop", icon="stop")
        stop.on_click(lambda _: self.stop())
        # The controls are above the image, so the height of the image does not move them. They wrap in a narrow cell.
        controls = widgets.HBox([stop, self._progress, self._label, self._layer], layout={"flex_flow": "row wrap"})
        self._box = widgets.VBox([controls, self._shown], layout={"align_items": "flex-start"})
        self._place = display(self._box, display_id=True)

    def __repr__(self) -> str:
        return f"<{self._label.value}>"

    def _ipython_display_(self) -> None:
        """Shows the image so far if a cell ends with this view; in the cell that made the view, it is already shown."""
        if _made[self] != executed_cell():
            from IPython.display import display

            display(self._still(), raw=True)

    @property
    def layers(self) -> dict[str, np.ndarray]:
        """The layers of the image so far: name -> array.

        ``final`` is the linear image, shape (height, width, 3); ``error`` the standard error of each pixel's luminance,
        and ``samples`` its number of samples, shape (height, width). There are also the layers that the integrator's
        parameter ``layers`` requests. The maps are missing during the first pass, in which pixels without a sample are
        black. The dictionary is empty before an image is available, and after an error.
        """
        return dict(self._layers)

    @property
    def image(self) -> np.ndarray:
        """The layer ``final`` of :attr:`layers`. Raises ValueError if there is no image."""
        if not self._layers:
            raise ValueError("show: there is no image yet; wait for it with view.wait()")
        return self._layers["final"]

    def stop(self) -> None:
        """Ends the render after the current work item; the image so far stays on the screen."""
        self._stopped = True

    def wait(self) -> View:
        """Renders until the image is finished or stopped, also by Ctrl-C, and returns the view; the notebook cannot run
        other code during this call.
        """
        for _ in self._steps:
            pass
        return self

    def __await__(self) -> Generator[Any, None, View]:
        """Waits for the end of the render, while the notebook runs other tasks. Outside a notebook, :func:`show` has
        waited.
        """
        if self.task is not None:
            yield from self.task.__await__()
            self._replace()  # some programs that run notebooks receive only the output of the waiting cell
        return self

    async def converge(self) -> None:
        """Renders until the image is finished, and lets the notebook run other tasks after each work item. If the task
        is cancelled, the render stops, and the image so far stays on the screen.
        """
        try:
            for _ in self._steps:
                await asyncio.sleep(PAUSE)
        except (KeyboardInterrupt, asyncio.CancelledError):
            self.stop()
            self.wait()  # executes the last step, which replaces the widgets by the image

    def _render(self) -> Iterator[None]:
        """Renders a work item before each ``yield``. At the end, a still image or the error message replaces the
        widgets.
        """
        try:
            while not self._image.done and not self._stopped:
                with interrupting(self.stop):
                    due = self._image.step()
                    self._progress.value = self._image.progress
                    if self._stopped or due:
                        with self._image.throttle.drawing():
                            self._layers = self._image.layers()
                            self._draw()
                yield
            self._label.value = ("stopped: " if self._stopped else "") + self._status()
        except Exception as error:
            self._layers, self._label.value = {}, f"not rendered: {session.message(error)}"
            raise
        finally:
            self._box.close()
            self._replace()

    def _draw(self) -> None:
        """Shows the selected layer, if it exists; a map as a grey image, in which its 99th percentile is white."""
        values = self._layers.get(self._layer.value)
        if values is None:
            return
        self._label.value = self._status()
        if values.ndim == 2:
            self._label.value += f"; white: {white_of(values):.2g} or more"
        self._shown.value = as_png(values, self._factor, FAST)

    def _status(self) -> str:
        samples, seconds = self._layers.get("samples"), f"{time.perf_counter() - self._started:.1f} s"
        if samples is None:
            return f"the first pass, {seconds}"
        words = verdict(self._image.render, interrupted=not self._image.done)
        return f"{words}, {samples.mean():.1f} samples a pixel, {seconds}"

    def _replace(self) -> None:
        """Replaces the widgets, which work only while the kernel is running, by a text and, if there is one, a still
        image.
        """
        if self._place is None:  # IPython is not running
            return
        self._place.update(self._still(), metadata={"image/png": {"alt": self._label.value}}, raw=True)

    def _still(self) -> dict[str, str]:
        still = {"text/plain": self._label.value}
        if self._layers:
            still["image/png"] = base64.b64encode(png(compress(self.image * self._factor))).decode()
        return still


@contextmanager
def interrupting(stop: Callable[[], None]) -> Iterator[None]:
    """Inside the ``with`` block, an interruption of the notebook's kernel calls ``stop`` and raises no exception, which
    would leave an unfinished trace in Dr.Jit. Only the main thread is interrupted.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous_handler = signal.signal(signal.SIGINT, lambda *_: stop())
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous_handler)
