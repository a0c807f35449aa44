"""``prosim render --view tev``: sends intermediate images to the viewer tev during a render."""

from __future__ import annotations

import socket
import warnings
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import click
import mitsuba as mi

from ..scene import images
from ..scene.throttle import Throttle
from .job import Job
from .option_types import require_extra

#: Timeout in seconds for sending to tev, which normally reads its connection many times a second.
SOCKET_TIMEOUT = 10.0

#: Names of the channels of the image in tev.
CHANNELS = ["R", "G", "B"]


class TevClient(ExitStack):
    """Shows the image on ``film`` in the viewer tev, if the job has the option ``--view``.

    The constructor raises ClickException if tev cannot be reached, or if the package tevclient is missing.
    """

    def __init__(self, job: Job, film: mi.Film) -> None:
        super().__init__()
        self._name, self._film, self._throttle = Path(job.scene).stem, film, Throttle()
        self._tev: Any = None
        if job.view is None:
            return
        require_extra("tev", "--view tev (Python 3.11 or later)")
        import tevclient

        timeout, (host, port) = socket.getdefaulttimeout(), job.view
        socket.setdefaulttimeout(SOCKET_TIMEOUT)  # the timeout of the new connection
        try:
            # ``push`` instead of ``enter_context``: the socket must be closed, too, if ``__enter__`` cannot connect.
            self._tev = self.push(tevclient.Ipc(host, port))
            self._tev.__enter__().create_image(self._name, *map(int, film.crop_size()), CHANNELS)
        except OSError as error:
            self.close()
            raise click.ClickException(
                f"no tev at {host}:{port} ({error.strerror or error}); start it, or give its address: "
                "--view tev=HOST:PORT"
            ) from None
        finally:
            socket.setdefaulttimeout(timeout)

    def update(self, render: Any) -> None:
        """Shows the current image of ``render`` in tev, if enough time has passed since the last image."""
        if self._tev is not None and self._throttle.due:
            with self._throttle.drawing():
                render.update_film()
                self.show()

    def show(self) -> None:
        """Sends the image on the film to tev, if it has colours. If tev has ended, warns once, and later calls do
        nothing.
        """
        colours = None if self._tev is None else images.colours(self._film.bitmap())
        if colours is None:
            return
        try:
            self._tev.update_image(self._name, colours, CHANNELS)
        except OSError as error:
            self.close()
            self._tev = None
            warnings.warn(f"tev has ended ({error.strerror or error}); the render continues", stacklevel=2)
