"""The state and the pictures of the live view: one thread publishes them, and every page reads them."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from time import perf_counter as clock
from typing import Any

from .picture import Picture

#: Seconds between two checks for a new state.
INTERVAL = 0.02


@dataclass(frozen=True)
class State:
    """The state that a page shows."""

    #: The name of the scene's file.
    scene: str
    #: ``opening``, ``rendering``, ``paused``, ``done``, ``missing`` if the file does not exist, or ``failed``.
    status: str = "opening"
    #: Number of times that the file was opened, or tried.
    opened: int = 0
    #: Why it failed.
    error: str | None = None
    warnings: tuple[str, ...] = ()
    #: Why the picture is black, if it is.
    black: str | None = None
    #: Final width and height of the picture.
    size: tuple[int, int] = (0, 0)
    #: Numbers of the newest pictures, by the name of the image; the layers of that of the scene's integrator.
    pictures: Mapping[str, int] = field(default_factory=dict)
    layers: tuple[str, ...] = ()
    #: Progress of all images, 0 to 1; samples per pixel and noise of that of the scene's integrator; seconds.
    progress: float = 0.0
    samples: float | None = None
    noise: float | None = None
    seconds: float = 0.0
    #: Name of the scene's integrator; whether the image by ``path`` is beside it, and why it cannot be.
    integrator: str = ""
    compared: bool = False
    not_compared: str | None = None
    #: The text of the moved view; None for the scene's own.
    view: str | None = None
    movable: bool = False


class Publisher:
    """The latest state and pictures. One thread publishes them; any thread may read them."""

    def __init__(self, state: State) -> None:
        self.state, self.pictures, self.closed = state, dict[str, Picture](), False

    def publish(self, pictures: Mapping[str, Picture] | None = None, **changes: Any) -> None:
        """Changes the state, and the pictures: ``own`` by the scene's integrator, and maybe ``path``."""
        if pictures:
            self.pictures = dict(pictures)
            changes["pictures"] = {name: picture.number for name, picture in pictures.items()}
            changes["layers"] = tuple(pictures["own"].layers)
        self.state = replace(self.state, **changes)

    async def follow(self) -> AsyncIterator[State]:
        """Yields the state, and the latest one after changes."""
        last = None
        while not self.closed:
            if self.state is not last:
                yield (last := self.state)
            await asyncio.sleep(INTERVAL)


#: Minimum number of seconds between two pictures, and the maximum share of the time that they take.
DRAW_INTERVAL, DRAW_SHARE = 0.1, 0.03


class Throttle:
    """Tells whether the next picture is due. Pictures that take longer to draw are drawn less often."""

    def __init__(self) -> None:
        self._next = 0.0

    @property
    def due(self) -> bool:
        """Whether it is time for the next picture."""
        return clock() >= self._next

    @contextmanager
    def drawing(self) -> Iterator[None]:
        """Surrounds the drawing of a picture, due or not."""
        started = clock()
        yield
        now = clock()
        self._next = now + max(DRAW_INTERVAL, (now - started) / DRAW_SHARE)
