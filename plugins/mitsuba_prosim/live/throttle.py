"""Limits how much of the time goes into drawing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter as clock

#: Seconds from one picture to the next, at least; and the share of the time that pictures may take.
EVERY, SHARE = 0.1, 0.03


class Throttle:
    """True when another picture is due: the longer it takes to draw one, the less often."""

    def __init__(self) -> None:
        self._next = 0.0

    def __bool__(self) -> bool:
        return clock() >= self._next

    @contextmanager
    def drawing(self) -> Iterator[None]:
        """Surrounds what draws a picture, whether it was due or not."""
        begun = clock()
        yield
        now = clock()
        self._next = now + max(EVERY, (now - begun) / SHARE)
