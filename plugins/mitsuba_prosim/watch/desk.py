"""Where wishes and errands are left, by any thread, for the one that renders."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from typing import Any

from .camera import Camera
from .subject import Subject
from .wish import Wish


class Desk:
    """What is wished, and what is to be done beside it. Any thread may wish, and send errands; the rest is for the one
    that renders.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._wish = Wish()
        self._errands: list[tuple[Callable[[Subject | None], Any], Future[Any]]] = []
        #: Whether somebody has said :meth:`leave`.
        self.left = False
        #: What of it all is shown, or being rendered.
        self.shown = Wish(text=-1)
        #: The scene, if one is open.
        self.subject: Subject | None = None

    # ---------------------------------------------------------------- any thread

    def saved(self) -> None:
        """The scene's file has changed."""
        self.ask(lambda wish: replace(wish, text=wish.text + 1, stopped=False))

    def move(self, by: Callable[[Camera], Camera]) -> None:
        """Moves the camera."""
        subject = self.subject
        home = subject.home if subject is not None else None
        if home is not None:
            self.ask(lambda wish: replace(wish, camera=by(wish.camera or home), stopped=False))

    def home(self) -> None:
        """Goes back to the scene's own view."""
        self.ask(lambda wish: replace(wish, camera=None, stopped=False))

    def compare(self, compared: bool) -> None:
        """Whether the image of ``path`` is rendered, too."""
        self.ask(lambda wish: replace(wish, compared=compared))

    def stop(self, stopped: bool = True) -> None:
        """Stops, or goes on."""
        self.ask(lambda wish: replace(wish, stopped=stopped))

    def leave(self) -> None:
        """Ends :meth:`.Studio.run`."""
        self.left = True
        self.ask(lambda wish: wish)

    def ask(self, change: Callable[[Wish], Wish]) -> None:
        """Changes what is wished."""
        with self._changed:
            self._wish = change(self._wish)
            self._changed.notify_all()

    def errand(self, work: Callable[[Subject | None], Any]) -> Future[Any]:
        """Has the thread that renders do some short work as soon as it can; with the scene, if one is open."""
        future: Future[Any] = Future()
        with self._changed:
            self._errands.append((work, future))
            self._changed.notify_all()
        return future

    # ---------------------------------------------------------------- the thread that renders

    def wait(self, done: bool) -> Wish:
        """Waits until there is something to do, and returns what is wished. ``done``: all that is shown is done."""
        with self._changed:
            self._changed.wait_for(lambda: self._has_work(done))
            return self._wish

    def pause(self) -> None:
        """Does errands alone, as long as it is :attr:`halted`."""
        while self.halted:
            with self._changed:
                self._changed.wait_for(lambda: not self.halted or bool(self._errands))
            self.run_errands()

    def run_errands(self) -> None:
        """Does those that there are."""
        with self._changed:
            errands, self._errands = self._errands, []
        for work, future in errands:
            if not future.set_running_or_notify_cancel():
                continue  # who has sent it has not waited so long, as while a large scene was opened
            try:
                future.set_result(work(self.subject))
            except Exception as error:  # noqa: BLE001 (whoever has sent it is told)
                future.set_exception(error)

    @property
    def halted(self) -> bool:
        """Whether what is being rendered is to be stopped."""
        return self._wish.stopped and not self.superseded

    @property
    def compared(self) -> bool:
        """Whether the image of ``path`` is wished, too."""
        return self._wish.compared

    @property
    def superseded(self) -> bool:
        """Whether something else is wished than what is being rendered."""
        wish, shown = self._wish, self.shown
        return self.left or wish.text != shown.text or wish.camera is not shown.camera

    def _has_work(self, done: bool) -> bool:
        wish, shown = self._wish, self.shown
        if self.left or self._errands or wish.text != shown.text:
            return True
        if self.subject is None:
            return False
        return (
            wish.camera is not shown.camera
            or wish.compared != shown.compared
            or wish.stopped != shown.stopped
            or (not wish.stopped and not done)
        )
