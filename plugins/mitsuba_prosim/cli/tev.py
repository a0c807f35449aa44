"""``prosim render --view tev``: the image so far, sent to the viewer tev while it is rendered."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import click
import mitsuba as mi
from prosim_scene import extras

from ..live.throttle import Throttle
from ..scene import images
from .job import Job
from .progress import warn

#: Seconds after which a tev that takes nothing counts as gone: it hears when it draws, many times a second.
PATIENCE = 10.0


@contextmanager
def viewer(job: Job, film: mi.Film) -> Iterator[Viewer | None]:
    """The viewer that a job asks for, if it does. Raises ClickException where there is no tev, or no tevclient."""
    if job.view is None:
        yield None
        return
    with closing(Viewer(*job.view, Path(job.scene).stem, film)) as shown:
        yield shown


class Viewer:
    """The image ``name`` in tev, which is what ``film`` holds."""

    def __init__(self, host: str, port: int, name: str, film: mi.Film) -> None:
        if extras.missing("tev"):
            raise click.ClickException(extras.needs("--view tev (Python 3.11 or later)", "tev"))
        import tevclient

        self._name, self._film, self._throttle = name, film, Throttle()
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

    def update(self, render: Any) -> None:
        """Shows what there is of a render, if it is time for it."""
        if self._throttle:
            with self._throttle.drawing():
                render.put()
                self.show()

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
            warn(f"tev has gone ({error.strerror or error}); the render continues")

    def close(self) -> None:
        """Leaves tev, which continues to show what it has."""
        tev, self._tev = self._tev, None
        if tev is not None:
            tev.__exit__(None, None, None)
