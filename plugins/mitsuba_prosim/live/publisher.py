"""The state of the live view, which one thread publishes and every page reads."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass, field, replace
from time import perf_counter as clock
from typing import Any

from .picture import Picture

#: Seconds between two looks at the state, and of silence after which a page gets an empty event: so each side notices
#: that the other one has gone.
LOOK, SILENCE = 0.02, 15.0


@dataclass(frozen=True)
class State:
    """The state that a page shows."""

    #: The name of the scene's file.
    scene: str
    #: ``opening``, ``rendering``, ``stopped``, ``done``, ``missing`` where there is no file, or ``failed`` with an
    #: ``error``.
    doing: str = "opening"
    #: Number of saves before the file was opened last.
    saves: int = 0
    error: str | None = None
    warnings: tuple[str, ...] = ()
    #: Why the picture is black, if it is.
    black: str | None = None
    #: Final width and height of the picture.
    size: tuple[int, int] = (0, 0)
    #: Numbers of the newest pictures, by the name of the image.
    pictures: Mapping[str, int] = field(default_factory=dict)
    layers: tuple[str, ...] = ()
    #: Progress of all images, 0 to 1; mean number of samples of a pixel, and noise, of the scene's own; seconds.
    part: float = 0.0
    samples: float | None = None
    noise: float | None = None
    seconds: float = 0.0
    #: Name of the scene's integrator, and why it can't be compared with ``path``, if so.
    integrator: str = ""
    compared: bool = False
    alone: str | None = None
    #: The text of the moved view; None for the scene's own.
    view: str | None = None
    movable: bool = False


class Publisher:
    """The newest state and pictures. One thread publishes them, any other reads them."""

    def __init__(self, state: State) -> None:
        self.state, self.pictures = state, dict[str, Picture]()
        #: How many pages read it.
        self.readers, self.closed = 0, False

    def publish(self, pictures: Mapping[str, Picture] | None = None, **changes: Any) -> None:
        """Changes the state, and the pictures."""
        if pictures is not None:
            self.pictures = dict(pictures)
            changes["pictures"] = {name: picture.number for name, picture in pictures.items()}
        self.state = replace(self.state, **changes)

    async def follow(self) -> AsyncIterator[State | None]:
        """The state, and each newer one; of several at once the last. None after a silence."""
        published, since = None, 0.0
        self.readers += 1
        try:
            while not self.closed:
                state = self.state
                if state is not published or clock() - since > SILENCE:
                    yield None if state is published else state
                    published, since = state, clock()
                await asyncio.sleep(LOOK)
        finally:
            self.readers -= 1
