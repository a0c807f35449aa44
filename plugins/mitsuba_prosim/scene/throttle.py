"""Limits how often the pictures of an unfinished image are drawn."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter as clock

#: Minimum number of seconds between two pictures, and the maximum fraction of the time for drawing pictures.
DRAW_INTERVAL, DRAW_FRACTION = 0.1, 0.03


class Throttle:
    """Limits how often pictures are drawn, to a small fraction of the rendering time."""

    def __init__(self) -> None:
        self._next = 0.0

    @property
    def due(self) -> bool:
        """Whether enough time has passed since the latest picture, so that the next picture may be drawn."""
        return clock() >= self._next

    @contextmanager
    def drawing(self) -> Iterator[None]:
        """Measures the ``with`` block, which draws a picture, and sets the earliest time of the next one."""
        started = clock()
        yield
        now = clock()
        self._next = now + max(DRAW_INTERVAL, (now - started) / DRAW_FRACTION)
