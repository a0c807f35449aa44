"""The view request of any thread to the thread that renders."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from typing import Any

from .loaded_scene import LoadedScene
from .orbit_camera import Camera


@dataclass(frozen=True)
class ViewRequest:
    """The requested image."""

    #: Number of saves of the scene's file.
    saves: int = 0
    #: The moved camera; None for the scene's own view.
    camera: Camera | None = None
    #: Whether the image by ``path`` is shown as well; whether rendering pauses.
    compared: bool = False
    paused: bool = False


class ViewRequests:
    """The latest :class:`ViewRequest`, and calls for the thread that renders. Any thread may use it."""

    def __init__(self) -> None:
        self._changed = threading.Condition(threading.RLock())
        self._request = ViewRequest()
        self._calls: list[tuple[Callable[[LoadedScene | None], Any], Future[Any]]] = []
        #: Whether the thread that renders must end.
        self.closed = False
        #: The own view of the scene that was opened last; None if its sensor cannot be moved.
        self.home: Camera | None = None

    def change(self, **changes: Any) -> None:
        """Changes the request."""
        with self._changed:
            self._request = replace(self._request, **changes)
            self._changed.notify_all()

    def save(self) -> None:
        """Requests that the scene's file is opened again."""
        with self._changed:
            self.change(saves=self._request.saves + 1, paused=False)

    def move(self, by: Callable[[Camera], Camera]) -> None:
        """Moves the camera, if the scene's camera can be moved."""
        with self._changed:
            if self.home is not None:
                self.change(camera=by(self._request.camera or self.home), paused=False)

    def close(self) -> None:
        """Ends the thread that renders."""
        self.closed = True
        self.change()

    def call(self, work: Callable[[LoadedScene | None], Any]) -> Future[Any]:
        """Runs some short work in the thread that renders, with the open scene or None."""
        future: Future[Any] = Future()
        with self._changed:
            self._calls.append((work, future))
            self._changed.notify_all()
        return future

    def wait(self, idle: Callable[[ViewRequest], bool]) -> ViewRequest:
        """Waits for a call, or for a request that is not ``idle``; returns the request."""
        with self._changed:
            self._changed.wait_for(lambda: self.closed or self._calls or not idle(self._request))
            return self._request

    def run_calls(self, scene: LoadedScene | None) -> None:
        """Runs the work of all calls."""
        with self._changed:
            calls, self._calls = self._calls, []
        for work, future in calls:
            if not future.set_running_or_notify_cancel():
                continue  # the caller stopped waiting, for example while a large scene was opened
            try:
                future.set_result(work(scene))
            except Exception as error:  # noqa: BLE001 (the caller receives it)
                future.set_exception(error)
