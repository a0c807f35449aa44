"""Where the studio says what there is, and every page reads it."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from .picture import Picture


@dataclass(frozen=True)
class State:
    """What a page is told."""

    #: The name of the scene's file.
    scene: str
    #: ``opening``, ``rendering``, ``stopped``, ``done``, ``missing`` where there is no file, or ``failed`` with an
    #: ``error``.
    doing: str = "opening"
    #: How often the file had been saved before it was opened last.
    saves: int = 0
    error: str | None = None
    warnings: tuple[str, ...] = ()
    #: Why the picture may be black, where it is.
    black: str | None = None
    #: Width and height that the picture comes to.
    size: tuple[int, int] = (0, 0)
    #: The numbers of the newest pictures, by the name of the take.
    pictures: Mapping[str, int] = field(default_factory=dict)
    layers: tuple[str, ...] = ()
    #: The part of all images that is done, 0 to 1; of the scene's own the samples of a pixel in the mean, and the
    #: noise, where it is measured; and seconds.
    part: float = 0.0
    samples: float | None = None
    noise: float | None = None
    seconds: float = 0.0
    #: What the scene is rendered by, and why that can't be compared with ``path``, if it can't.
    integrator: str = ""
    compared: bool = False
    alone: str | None = None
    #: The view as it was moved, in the scene's language; None as long as it is the scene's own, or can't be moved.
    view: str | None = None
    movable: bool = False


class Board:
    """The newest state and pictures, to be put by one thread and read by others."""

    def __init__(self, state: State) -> None:
        self._lock = threading.Lock()
        self._state = state
        self._pictures: Mapping[str, Picture] = {}
        self._waiting: set[tuple[asyncio.AbstractEventLoop, asyncio.Event]] = set()
        self._closed = False

    @property
    def state(self) -> State:
        """The newest."""
        return self._state

    @property
    def pictures(self) -> Mapping[str, Picture]:
        """The newest, by the name of the take."""
        return self._pictures

    @property
    def followed(self) -> bool:
        """Whether anybody reads it."""
        return bool(self._waiting)

    def say(self, pictures: Mapping[str, Picture] | None = None, **changes: Any) -> None:
        """Changes the state, and the pictures."""
        with self._lock:
            if pictures is not None:
                self._pictures = dict(pictures)
                changes["pictures"] = {name: picture.number for name, picture in pictures.items()}
            self._state = replace(self._state, **changes)
            self._wake()

    def put_back(self, state: State, pictures: Mapping[str, Picture]) -> None:
        """A state and its pictures that there were before."""
        with self._lock:
            self._state, self._pictures = state, pictures
            self._wake()

    def close(self) -> None:
        """Ends what follows it."""
        with self._lock:
            self._closed = True
            self._wake()

    def _wake(self) -> None:
        for loop, event in self._waiting:
            loop.call_soon_threadsafe(event.set)

    async def follow(self) -> AsyncIterator[State]:
        """The state now, and each newer one; of several at once the last."""
        one = (asyncio.get_running_loop(), asyncio.Event())
        with self._lock:
            self._waiting.add(one)
        try:
            told = None
            while not self._closed:
                one[1].clear()
                if self._state is not told:
                    told = self._state
                    yield told
                await one[1].wait()
        finally:
            with self._lock:
                self._waiting.discard(one)
