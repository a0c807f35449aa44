"""Requests of any thread to the one that renders."""

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
    """The image that is requested."""

    #: Number of saves of the scene's file.
    saves: int = 0
    #: The moved camera; None for the scene's own view.
    camera: Camera | None = None
    #: Whether the image of ``path`` is shown as well; whether rendering pauses.
    compared: bool = False
    stopped: bool = False


class Requests:
    """The newest :class:`Request`, and calls for the thread that renders. Any thread may use it."""

    def __init__(self) -> None:
        self._changed = threading.Condition(threading.RLock())
        self._request = Request()
        self._calls: list[tuple[Callable[[LoadedScene | None], Any], Future[Any]]] = []
        #: Whether the thread that renders has to end.
        self.closed = False
        #: The scene's own view; None where there is no scene, or a sensor that can't be moved.
        self.home: Camera | None = None

    def change(self, **changes: Any) -> None:
        """Changes the request."""
        with self._changed:
            self._request = replace(self._request, **changes)
            self._changed.notify_all()

    def save(self) -> None:
        """Opens the scene's file again."""
        with self._changed:
            self.change(saves=self._request.saves + 1, stopped=False)

    def move(self, by: Callable[[Camera], Camera]) -> None:
        """Moves the camera, if the scene has one that moves."""
        with self._changed:
            if self.home is not None:
                self.change(camera=by(self._request.camera or self.home), stopped=False)

    def close(self) -> None:
        """Ends the thread that renders."""
        self.closed = True
        self.change()

    def call(self, work: Callable[[LoadedScene | None], Any]) -> Future[Any]:
        """Lets the thread that renders do some short work, with the open scene or None."""
        future: Future[Any] = Future()
        with self._changed:
            self._calls.append((work, future))
            self._changed.notify_all()
        return future

    def wait(self, idle: Callable[[Request], bool]) -> Request:
        """Waits for a call, or a request that is not ``idle``; returns the request."""
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
            except Exception as error:  # noqa: BLE001 (the caller receives it)
                future.set_exception(error)
