"""The state of the live view, which one thread publishes and every page reads."""

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
    #: Final width and height of the picture.
    size: tuple[int, int] = (0, 0)
    #: Numbers of the newest pictures, by the name of the image.
    pictures: Mapping[str, int] = field(default_factory=dict)
    layers: tuple[str, ...] = ()
    #: Progress of all images, 0 to 1; of the scene's own the mean number of samples of a pixel, and the noise where it
    #: is measured; seconds of rendering.
    part: float = 0.0
    samples: float | None = None
    noise: float | None = None
    seconds: float = 0.0
    #: Name of the scene's integrator, and why it can't be compared with ``path``, if so.
    integrator: str = ""
    compared: bool = False
    alone: str | None = None
    #: The view as it was moved, in the scene's language; None for the scene's own, or where it can't be moved.
    view: str | None = None
    movable: bool = False


class Publisher:
    """The newest state and pictures."""

    def __init__(self, state: State) -> None:
        self._lock = threading.Lock()
        self.state, self.pictures = state, dict[str, Picture]()
        self._waiting: set[tuple[asyncio.AbstractEventLoop, asyncio.Event]] = set()
        self._closed = False

    @property
    def followed(self) -> bool:
        """Whether anybody reads it."""
        return bool(self._waiting)

    def publish(self, pictures: Mapping[str, Picture] | None = None, **changes: Any) -> None:
        """Changes the state, and the pictures."""
        if pictures is not None:
            changes["pictures"] = {name: picture.number for name, picture in pictures.items()}
        self.restore(replace(self.state, **changes), self.pictures if pictures is None else pictures)

    def restore(self, state: State, pictures: Mapping[str, Picture]) -> None:
        """Publishes a state and its pictures."""
        with self._lock:
            self.state, self.pictures = state, dict(pictures)
            self._wake()

    def close(self) -> None:
        """Ends :meth:`follow`."""
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
                if self.state is not told:
                    told = self.state
                    yield told
                await one[1].wait()
        finally:
            with self._lock:
                self._waiting.discard(one)
