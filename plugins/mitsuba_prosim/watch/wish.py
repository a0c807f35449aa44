"""What the studio is wished to show."""

from __future__ import annotations

from dataclasses import dataclass

from .camera import Camera


@dataclass(frozen=True)
class Wish:
    """What is to be seen; of several wishes the newest counts."""

    #: How often the scene's file was saved.
    text: int = 0
    #: None for the scene's own view.
    camera: Camera | None = None
    compared: bool = False
    stopped: bool = False
