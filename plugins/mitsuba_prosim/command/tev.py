"""``prosim render --view tev``: the image so far, sent to the viewer tev while it is rendered."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager
from pathlib import Path
from typing import Any

import click
import mitsuba as mi
from prosim_scene import extras

from ..live.throttle import Throttle
from ..scene import images, rendering

#: Where tev listens, if nothing else was said when it was started.
HOST, PORT = "127.0.0.1", 14158

#: Seconds after which a tev that takes nothing counts as gone: it hears when it draws, many times a second.
PATIENCE = 10.0

#: What shows the progress of a render, and yields what is to be told of it; as :func:`.making.progress_bar`.
Bar = Callable[[Any, str], AbstractContextManager[rendering.Tell | None]]


@contextmanager
def beside(
    bar: Bar, place: tuple[str, int] | None, scene: str, film: mi.Film, warn: Callable[[str], None]
) -> Iterator[Bar]:
    """``bar``, and beside it the image in the tev at ``place``, from time to time and in the end; ``bar`` alone where
    that is None. ``warn``: says that tev has gone. Raises ClickException where there is no tev, or no tevclient.
    """
    if place is None:
        yield bar
        return
    viewer = Viewer(*place, Path(scene).stem, film, warn)

    @contextmanager
    def both(integrator: mi.Integrator, variant: str) -> Iterator[rendering.Tell | None]:
        due = Throttle()
        with bar(integrator, variant) as tell:

            def told(part: float, render: Any) -> None:
                if tell is not None:
                    tell(part, render)
                if due:
                    with due.drawing():
                        render.put()
                        viewer.show()

            yield told
            viewer.show()

    with closing(viewer):
        yield both


class Viewer:
    """The image ``name`` in tev, which is what ``film`` holds."""

    def __init__(self, host: str, port: int, name: str, film: mi.Film, warn: Callable[[str], None]) -> None:
        try:
            import tevclient
        except ImportError:
            raise click.ClickException(extras.needs("--view tev (Python 3.11 or later)", "tev")) from None
        self._name, self._film, self._warn = name, film, warn
        self._begun = False
        self._tev: Any = tevclient.Ipc(host, port)
        before = socket.getdefaulttimeout()
        socket.setdefaulttimeout(PATIENCE)  # of the socket that is made now
        try:
            self._tev.__enter__()
        except OSError as error:
            raise click.ClickException(
                f"there is no tev at {host}:{port} ({error.strerror or error}); start it first, or say where it is: "
                "--view tev=HOST:PORT"
            ) from None
        finally:
            socket.setdefaulttimeout(before)

    def show(self) -> None:
        """Sends what the film holds. Where tev has gone, that is said once, and no more is sent."""
        colours = None if self._tev is None else images.colours(self._film.bitmap())
        if colours is None:
            return
        try:
            if not self._begun:
                self._tev.create_image(self._name, colours.shape[1], colours.shape[0], ["R", "G", "B"])
                self._begun = True
            self._tev.update_image(self._name, colours, ["R", "G", "B"])
        except OSError as error:
            self.close()
            self._warn(f"tev has gone ({error.strerror or error}); the render goes on")

    def close(self) -> None:
        """Leaves tev, which goes on to show what it has."""
        tev, self._tev = self._tev, None
        if tev is not None:
            tev.__exit__(None, None, None)
