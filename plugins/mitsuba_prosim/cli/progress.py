"""The progress of a command: a bar on a terminal, else a line now and then."""

from __future__ import annotations

import sys
from typing import Any

from tqdm import tqdm

#: Seconds between two lines of a log, at least and at most; and as a part of the time that has passed.
SHORTEST, LONGEST, SHARE = 10.0, 300.0, 0.25


class Progress(tqdm):
    """The progress of one step after the other, or of a film's frames, on standard error.

    ``doing``: shown until the first step begins; ``frames``: of a film; ``timed``: whether a step shows progress before
    its end.
    """

    def __init__(self, doing: str, frames: int = 1, timed: bool = True) -> None:
        self.on_terminal, self.next_line = sys.stderr.isatty(), SHORTEST
        form = "{l_bar}{bar}| {elapsed}, {remaining} left" if timed else "{desc}"
        self.step, self.finished = "", 0
        super().__init__(
            desc=doing, total=frames, bar_format=form, file=sys.stderr, leave=False, smoothing=0, miniters=0
        )

    def show(self, done: float, step: str = "rendering") -> None:
        """Shows that the part ``done`` of a step, or of the frame, is done, 0 to 1; the bar never moves back. What the
        first call says of a step was done before: the time left does not count it.
        """
        if step != self.step:
            if self.step:
                self.reset()
                self.next_line = SHORTEST
            self.step, self.initial = step, done
            self.set_description_str(step, refresh=False)
        self.update(max(self.finished + done - self.n, 0))  # an estimate may become worse

    def display(self, msg: str | None = None, pos: int | None = None) -> bool:
        """Draws the bar; without a terminal prints a line, if it is time for one."""
        if self.on_terminal:
            return bool(super().display(msg, pos))
        shown = self.format_dict
        if msg is None and shown["elapsed"] >= self.next_line:
            self.next_line = shown["elapsed"] + min(max(SHORTEST, SHARE * shown["elapsed"]), LONGEST)
            form = "{desc}: {percentage:.0f} %, {elapsed} passed, {remaining} left"
            print(self.format_meter(**shown | {"bar_format": form}), file=sys.stderr, flush=True)
        return False

    def clear(self, *how: Any, **more: Any) -> None:
        """Removes the bar, where there is one, until the next :meth:`display`."""
        if self.on_terminal:
            super().clear(*how, **more)

    def begin(self, number: int) -> None:
        """Shows the frame of that number from now on."""
        self.step = "rendering"
        self.set_description_str(f"frame {number}")

    def finish(self) -> None:
        """Counts a frame that was rendered."""
        self.show(1.0)
        self.finished += 1

    def leave_out(self) -> None:
        """Counts a frame that exists."""
        self.total -= 1
        self.refresh()
