"""The state and the pictures of the live view, which the thread that renders publishes, and the web server sends."""

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
    #: ``opening``, ``rendering``, ``paused``, ``done``, ``missing`` if the file does not exist, or ``failed``.
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
    #: Name of the image -> number of its newest picture. The scene's integrator renders the image "own", and Mitsuba's
    #: path tracer the image "path".
    pictures: Mapping[str, int] = field(default_factory=dict)
    #: Names of the layers of the image "own".
    layers: tuple[str, ...] = ()
    #: Ids of shapes and emitters -> their names and lines in the scene file.
    names: Mapping[str, str] = field(default_factory=dict)
    #: Mean progress of the images, 0 to 1.
    progress: float = 0.0
    #: Samples per pixel and noise (RMS error, white = 1) of the image "own"; None if they are not known.
    samples: float | None = None
    noise: float | None = None
    #: Seconds of rendering.
    seconds: float = 0.0
    #: Name of the scene's integrator.
    integrator: str = ""
    #: Whether the page also shows the image "path".
    compared: bool = False
    #: Why the image "path" cannot be shown; None if it can.
    not_compared: str | None = None
    #: The text of the moved view for the scene file; None if the camera was not moved.
    view: str | None = None
    #: Whether the camera can be moved.
    movable: bool = False


class Publisher:
    """Holds the latest state and pictures. Only one thread may call :meth:`publish`; any thread may read."""

    def __init__(self, state: State) -> None:
        self.state, self.pictures, self.closed = state, dict[str, Picture](), False

    def publish(self, pictures: Mapping[str, Picture] | None = None, **changes: Any) -> None:
        """Changes fields of the state, and replaces the ``pictures``, if there are any: "own", and perhaps "path"."""
        if pictures:
            self.pictures = dict(pictures)
            changes["pictures"] = {name: picture.number for name, picture in pictures.items()}
            changes["layers"] = tuple(pictures["own"].layers)
        self.state = replace(self.state, **changes)

    async def follow(self) -> AsyncIterator[State]:
        """Yields the current state, and the latest state after each change, until the publisher is closed."""
        last = None
        while not self.closed:
            if self.state is not last:
                yield (last := self.state)
            await asyncio.sleep(INTERVAL)
