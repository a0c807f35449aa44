"""Shows the progress of a command as a bar on a terminal."""

from __future__ import annotations

import sys
from threading import RLock
from typing import Any

from tqdm import tqdm

#: Progress below which the remaining time is unknown, because kernels are compiled first.
KNOWN = 0.005

tqdm.set_lock(RLock())  # the default lock imports multiprocessing


class Progress(tqdm):
    """Shows on standard error, if it is a terminal, the progress of successive phases of work, or of the frames of an
    animation.

    ``doing`` is the text that describes the work until the first phase begins. ``frames`` is the number of frames.
    """

    def __init__(self, doing: str, frames: int = 1) -> None:
        self.phase, self.finished = "", 0
        form = "{l_bar}{bar}| {elapsed}, {remaining} left"
        how = {"leave": False, "miniters": 0, "smoothing": 0, "bar_format": form, "disable": None}
        super().__init__(None, doing, frames, file=sys.stderr, **how)

    def show(self, done: float, phase: str = "rendering") -> None:
        """Shows ``done``, the finished fraction of a phase or frame, in [0, 1].

        The bar moves back if the render now expects more work. A new phase begins with an empty bar. The remaining time
        is estimated without the progress of the first call, which an earlier, interrupted render made.
        """
        if phase != self.phase:
            if self.phase:
                self.reset()
            self.phase, self.initial = phase, done
            self.set_description_str(phase, refresh=False)
        self.update(self.finished + done - self.n)

    @property
    def format_dict(self) -> dict[str, Any]:
        """What the bar shows; without a remaining time at the beginning."""
        shown: dict[str, Any] = super().format_dict
        early = shown["n"] - shown["initial"] < KNOWN * shown["total"]
        return shown | {"initial": shown["n"]} if early else shown

    def begin(self, number: int, finished: int, total: int) -> None:
        """Shows that the frame ``number`` is being rendered, and that ``finished`` of ``total`` frames are finished."""
        self.phase, self.finished, self.total = "rendering", finished, total
        self.set_description_str(f"frame {number}")
