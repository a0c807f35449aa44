"""What any thread asks of the one that renders."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from typing import Any

from .camera import Camera
from .loaded_scene import LoadedScene


@dataclass(frozen=True)
class Request:
    """What is to be shown."""

    #: How often the scene's file was saved.
    saves: int = 0
    #: None for the scene's own view.
    camera: Camera | None = None
    #: Whether the image of ``path`` is shown, too; whether rendering pauses.
    compared: bool = False
    stopped: bool = False


class Requests:
    """The newest :class:`Request`, and calls for the thread that renders. Any thread may use it."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._request = Request()
        self._calls: list[tuple[Callable[[LoadedScene | None], Any], Future[Any]]] = []
        #: Whether the thread that renders is to end.
        self.closed = False
        #: The scene's own view; None where there is no scene, or a sensor that can't be moved.
        self.home: Camera | None = None

    def change(self, change: Callable[[Request], Request]) -> None:
        """Changes the request."""
        with self._changed:
            self._request = change(self._request)
            self._changed.notify_all()

    def saved(self) -> None:
        """Opens the scene's file again."""
        self.change(lambda request: replace(request, saves=request.saves + 1, stopped=False))

    def move(self, by: Callable[[Camera], Camera]) -> None:
        """Moves the camera."""
        if (home := self.home) is not None:
            self.change(lambda request: replace(request, camera=by(request.camera or home), stopped=False))

    def go_home(self) -> None:
        """Returns to the scene's own view."""
        self.change(lambda request: replace(request, camera=None, stopped=False))

    def compare(self, compared: bool = True) -> None:
        """Shows the image of ``path`` as well, or no longer."""
        self.change(lambda request: replace(request, compared=compared))

    def stop(self, stopped: bool = True) -> None:
        """Pauses, or continues."""
        self.change(lambda request: replace(request, stopped=stopped))

    def close(self) -> None:
        """Ends the thread that renders."""
        self.closed = True
        self.change(lambda request: request)

    def call(self, work: Callable[[LoadedScene | None], Any]) -> Future[Any]:
        """Has the thread that renders do some short work; with the scene, if one is open."""
        future: Future[Any] = Future()
        with self._changed:
            self._calls.append((work, future))
            self._changed.notify_all()
        return future

    def wait(self, idle: Callable[[Request], bool]) -> Request:
        """Returns the request, as soon as there is a call, or it is not ``idle``."""
        with self._changed:
            self._changed.wait_for(lambda: self.closed or self._calls or not idle(self._request))
            return self._request

    def run_calls(self, scene: LoadedScene | None) -> None:
        """Does the work of all calls."""
        with self._changed:
            calls, self._calls = self._calls, []
        for work, future in calls:
            if not future.set_running_or_notify_cancel():
                continue  # the caller waits no longer, as while a large scene was opened
            try:
                future.set_result(work(scene))
            except Exception as error:  # noqa: BLE001 (the caller is told)
                future.set_exception(error)
