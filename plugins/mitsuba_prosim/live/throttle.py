"""Limits the share of the time that drawing takes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter as clock

#: Minimum number of seconds between two pictures, and the maximum share of the time that they take.
INTERVAL, SHARE = 0.1, 0.03


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
        self._next = now + max(INTERVAL, (now - started) / SHARE)
