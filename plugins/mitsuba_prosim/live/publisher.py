"""The state and the picture of the live view, which the thread that renders publishes, and the web server sends."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from .picture import Picture

#: Seconds between two checks for a new state.
INTERVAL = 0.02


@dataclass(frozen=True)
class State:
    """The state that a page shows."""

    #: The name of the scene's file.
    scene: str
    #: ``opening``, ``rendering``, ``done``, ``missing`` if the file does not exist, or ``failed``.
    status: str = "opening"
    #: How often the viewer has tried to open the file.
    opened: int = 0
    #: The message of the error, if the status is ``failed``.
    error: str | None = None
    #: The translator's warnings about the scene.
    warnings: tuple[str, ...] = ()
    #: Why the picture is black, or None if it is not black.
    black: str | None = None
    #: Final width and height of the picture.
    size: tuple[int, int] = (0, 0)
    #: Number of the newest picture; None before the first.
    picture: int | None = None
    #: Names of the layers of the picture.
    layers: tuple[str, ...] = ()
    #: Ids of shapes and emitters -> their names and lines in the scene file.
    names: Mapping[str, str] = field(default_factory=dict)
    #: Progress of the image, 0 to 1.
    progress: float = 0.0
    #: Samples per pixel and noise (RMS error, white = 1) of the image; None if they are not known.
    samples: float | None = None
    noise: float | None = None
    #: Seconds of rendering.
    seconds: float = 0.0
    #: The text of the moved view for the scene file; None if the camera was not moved.
    view: str | None = None
    #: Whether the camera can be moved.
    movable: bool = False


class Publisher:
    """Holds the latest state and picture. Only one thread may call :meth:`publish`; any thread may read."""

    def __init__(self, state: State) -> None:
        self.state, self.closed = state, False
        self.picture: Picture | None = None

    def publish(self, picture: Picture | None = None, **changes: Any) -> None:
        """Changes fields of the state, and replaces the picture unless ``picture`` is None."""
        if picture is not None:
            self.picture = picture
            changes |= {"picture": picture.number, "layers": tuple(picture.layers)}
        self.state = replace(self.state, **changes)

    async def follow(self) -> AsyncIterator[State]:
        """Yields the current state, and the latest state after each change, until the publisher is closed."""
        last = None
        while not self.closed:
            if self.state is not last:
                yield (last := self.state)
            await asyncio.sleep(INTERVAL)
