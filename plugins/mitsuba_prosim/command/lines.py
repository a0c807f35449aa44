"""How far a long work is, in a log: a line now and then, where nobody watches a bar."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

from tqdm.auto import tqdm


class Lines:
    """Says on standard error how far a work is, at intervals that grow with the time that has passed, so that a log
    stays short.
    """

    #: Seconds from one line to the next, at least and at most; and the part of the time that has passed.
    SHORTEST, LONGEST, SHARE = 10.0, 300.0, 0.25

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self.clock = clock
        self.begun = self.last = self.step = clock()
        self.doing: str | None = None

    def __call__(self, doing: str, done: float) -> None:
        """Called as often as one likes. ``doing``: what is being done; ``done``: the part of that, 0 to 1."""
        now = self.clock()
        if doing != self.doing:
            self.doing, self.step = doing, now
        if now - self.last < min(max(self.SHORTEST, self.SHARE * (now - self.begun)), self.LONGEST):
            return
        self.last, passed = now, now - self.step
        said = f"{doing}: {100 * done:.0f} %, {tqdm.format_interval(now - self.begun)} passed"
        if 0.01 < done < 1:  # before, nobody knows
            said += f", {tqdm.format_interval(passed * (1 - done) / done)} left"
        print(said, file=sys.stderr, flush=True)
