"""How far a command is: a bar where somebody watches, else a line now and then."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any, Protocol

from tqdm.auto import tqdm


def warn(text: str) -> None:
    """Prints a warning beside the bar."""
    tqdm.write(f"warning: {text}", file=sys.stderr)


class Left:
    """The time that a work which begins now has left. What was done of it before, of a render that is continued for
    example, is what it is first told of.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self.clock, self.begun = clock, clock()
        self.before: float | None = None

    def __call__(self, done: float) -> str:
        """``, 0:10 left`` where the part ``done`` is done, 0 to 1; nothing where nobody knows yet, or at the end."""
        if self.before is None:
            self.before = done
        if not 1 > done > self.before + 0.01:
            return ""
        seconds = (self.clock() - self.begun) * (1 - done) / (done - self.before)
        return f", {tqdm.format_interval(seconds)} left"


class Lines:
    """Prints progress to standard error, at intervals that grow with the time that has passed, so that a log stays
    short.
    """

    #: Seconds from one line to the next, at least and at most; and the part of the time that has passed.
    SHORTEST, LONGEST, SHARE = 10.0, 300.0, 0.25

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self.clock = clock
        self.begun = self.last = clock()
        self.doing: str | None = None
        self.most = 0.0  # that has been said to be done of it
        self.left = Left(clock)

    def __call__(self, doing: str, done: float) -> None:
        """Called as often as one likes. ``doing``: what is being done; ``done``: the part of that, 0 to 1."""
        now = self.clock()
        if doing != self.doing:
            self.left = self.left if self.doing is None else Left(self.clock)
            self.doing, self.most = doing, 0.0
        left = self.left(done)
        if now - self.last < min(max(self.SHORTEST, self.SHARE * (now - self.begun)), self.LONGEST):
            return
        self.last = now
        self.most = max(self.most, done)  # an estimate that has become worse is seen in the time left alone
        print(
            f"{doing}: {100 * self.most:.0f} %, {tqdm.format_interval(now - self.begun)} passed{left}",
            file=sys.stderr,
            flush=True,
        )


class Bar(Protocol):
    """Shows how far an image is."""

    def show(self, done: float) -> None:
        """``done``: the part of it, 0 to 1."""


class Progress:
    """The progress of one work after the other, each with a time of its own; ``doing``: what is shown until the first
    step; ``timed``: whether there are steps before the end.
    """

    FORM = "{l_bar}{bar}| {elapsed}"

    def __init__(self, doing: str, timed: bool = True, clock: Callable[[], float] = time.perf_counter) -> None:
        self.form, self.clock = self.FORM if timed else "{desc}", clock
        self.bar = tqdm(desc=doing, total=100, bar_format=self.form, disable=None, file=sys.stderr, leave=False)
        self.lines, self.left = Lines(clock), Left(clock)
        self.doing: str | None = None

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self.bar.close()

    def show(self, done: float, doing: str = "rendering") -> None:
        """``done``: the part of what is being done, 0 to 1."""
        if self.bar.disable:
            self.lines(doing, done)
        if doing != self.doing:
            if self.doing is not None:
                self.bar.reset()
                self.left = Left(self.clock)
            self.doing = doing
        self.bar.set_description_str(doing, refresh=False)
        self.bar.bar_format = self.form + self.left(done)
        self.bar.update(max(100 * done - self.bar.n, 0))  # an estimate that has become worse is not shown


class FilmBar:
    """The progress of the ``frames`` of a film, of which one at a time is shown."""

    def __init__(self, frames: int) -> None:
        form = "{l_bar}{bar}| {elapsed}, {remaining} left"
        self.bar = tqdm(total=100 * frames, bar_format=form, disable=None, file=sys.stderr, leave=False)
        self.finished = 0

    def __enter__(self) -> FilmBar:
        return self

    def __exit__(self, *_: Any) -> None:
        self.bar.close()

    def begin(self, number: int) -> None:
        """Shows the frame of that number from now on."""
        self.bar.set_description_str(f"frame {number}")

    def show(self, done: float) -> None:
        """``done``: the part of the frame at hand, 0 to 1."""
        self.bar.update(max(100 * (self.finished + done) - self.bar.n, 0))

    def finish(self) -> None:
        """A frame is there."""
        self.show(1.0)
        self.finished += 1

    def leave_out(self) -> None:
        """A frame was there before."""
        self.bar.total -= 100
        self.bar.refresh()
