"""Shows an image in a notebook while it is rendered."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from prosim_scene import extras

from .picture import as_png
from .progressive_image import ProgressiveImage
from .result import AnyScene, Result, converge


def show(scene: AnyScene, **how: Any) -> Result:
    """Renders as :func:`.render`, shows the image in a notebook meanwhile, and returns the image with its error.

    ``scene``
        A Mitsuba scene, the dictionary of one, or the path of a scene file in the thesis's scene language or in XML.
    ``how``
        Arguments of :func:`.render` but ``progress``.

    If you interrupt the kernel, the render ends after the current work item, and the image so far is the result. The
    last image stays in the notebook file. Raises ImportError without IPython, and the errors of :func:`.render`.
    """
    try:
        from IPython.display import display
    except ImportError as error:
        raise ImportError(extras.needs("show", "notebooks")) from error
    interruptions, place = list[bool](), display({"text/plain": "compiling kernels"}, raw=True, display_id=True)

    def draw(image: ProgressiveImage, due: bool) -> bool:
        if due and place is not None:  # None: IPython is not running
            with image.throttle.drawing():
                shown = {"image/png": as_png(image.layers()["final"]), "text/plain": f"{image.progress:.0%}"}
                place.update(shown, raw=True)
        return bool(interruptions)

    try:
        with interrupting(lambda: interruptions.append(True)):
            result = converge("show", scene, draw, **how)
    except BaseException:
        if place is not None:
            place.update({"text/plain": "not rendered"}, raw=True)
        raise
    if place is not None:
        text, picture = {"text/plain": result.verdict}, as_png(result.colours)
        place.update(text | {"image/png": picture}, metadata={"image/png": {"alt": result.verdict}}, raw=True)
    return result


@contextmanager
def interrupting(stop: Callable[[], object]) -> Iterator[None]:
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
