"""Where images that grow are drawn, for the board."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from .board import Board
from .due import Due
from .picture import Picture
from .takes import Take

#: Seconds between two reports of the part that is done.
REPORT = 0.1


class Easel:
    """Draws the images that grow, after each wave and within one, and puts the pictures on ``board``."""

    def __init__(self, board: Board) -> None:
        self._board = board
        #: The images by name: ``own``, that of the scene's integrator, and maybe ``path``.
        self.takes: dict[str, Take] = {}
        self._due = Due()
        self._number, self._reported, self._begun = 0, 0.0, 0.0
        self._said = 0.0  # seconds
        self._newest = False  # whether all that was taken is to be seen

    @property
    def done(self) -> bool:
        """Whether all images are."""
        return all(take.done for take in self.takes.values())

    @property
    def part(self) -> float:
        """The part of all images that is done, 0 to 1."""
        return sum(take.part for take in self.takes.values()) / len(self.takes)

    def begin(self, **takes: Take) -> None:
        """Has these images from now on, from when the seconds count."""
        self._begun, self._said = time.perf_counter(), 0.0
        self.takes = takes

    def go_on(self, **takes: Take) -> None:
        """Has these images from now on; the seconds count on from those that were said last."""
        self._begun = time.perf_counter() - self._said
        self.takes = takes

    def pictures(self) -> Mapping[str, Picture]:
        """Those on the board that are of these images."""
        return {name: picture for name, picture in self._board.pictures.items() if name in self.takes}

    def reached(self) -> dict[str, Any]:
        """What the board says of how far the scene's own image has come."""
        samples, noise = self.takes["own"].reached()
        return {"samples": samples, "noise": noise}

    def first(self, take: Take, **said: Any) -> None:
        """Shows the picture that comes before the first wave; ``said``: what else the board says then."""
        picture = Picture(self._next_number(), {"final": take.coarse()})
        with self._due.drawing():
            self._board.say({"own": picture}, layers=("final",), seconds=self._seconds(), **said)

    def step(self, name: str, between: Callable[[str], None]) -> bool:
        """Another wave of an image, if it is not done, and its picture; returns whether there was one. ``between``:
        called between portions with the name; what it raises ends the image.
        """
        take = self.takes[name]
        self.more()
        if take.done or not take.step(partial(between, name)):
            return False
        if not self._newest:
            self.show(name)
        return True

    def more(self) -> None:
        """More has been taken than was shown."""
        self._newest = False

    def show(self, name: str) -> None:
        """Shows an image as it is now, after a wave or between two portions of one."""
        with self._due.drawing():
            layers = self.takes[name].layers()
            if layers is None:
                return
            pictures = {**self.pictures(), name: Picture(self._next_number(), layers)}
            said = self.reached()
            self._board.say(pictures, layers=tuple(pictures["own"].layers), seconds=self._seconds(), **said)
        self._newest = True

    def report(self, name: str) -> None:
        """Says the part that is done, and shows the image, as often as there is time for it."""
        now = time.perf_counter()
        if now - self._reported > REPORT:
            self._reported = now
            self._board.say(part=self.part, seconds=self._seconds())
        if self._due and not self._newest and self._board.followed:
            self.show(name)

    def _seconds(self) -> float:
        self._said = time.perf_counter() - self._begun
        return self._said

    def _next_number(self) -> int:
        self._number += 1
        return self._number
