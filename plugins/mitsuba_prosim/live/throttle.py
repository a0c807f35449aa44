"""Limits the share of the time that drawing takes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter as clock

#: Seconds between two pictures, at least, and the share of the time that they may take.
EVERY, SHARE = 0.1, 0.03


class Throttle:
    """Tells whether the next picture is due. Pictures that take longer to draw are drawn less often."""

    def __init__(self) -> None:
        self._next = 0.0

    def __bool__(self) -> bool:
        return clock() >= self._next

    @contextmanager
    def drawing(self) -> Iterator[None]:
        """Surrounds the drawing of a picture, due or not."""
        started = clock()
        yield
        now = clock()
        self._next = now + max(EVERY, (now - started) / SHARE)
