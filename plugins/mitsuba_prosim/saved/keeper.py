"""A state that is written from time to time, while an image is rendered."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..rendering.record import Record
from ..scene_files import writing
from . import files


class Keeper:
    """Writes the record of an image to ``path`` every few seconds, and at its end.

    ``about``: that of :class:`.Record`; ``say``: told once that it can't be written. To be called between two portions
    of the work.
    """

    #: Seconds from one to the next: so many times what writing it takes, within bounds; where it takes long, so many
    #: times at least.
    TIMES, SHORTEST, LONGEST, LEAST_TIMES = 50, 4.0, 7.0, 20

    def __init__(self, path: Path, about: Mapping[str, Any], say: Callable[[str], None] = lambda _: None) -> None:
        self.path, self.about, self.say = path, about, say
        self.last = time.perf_counter()
        self.wait = self.SHORTEST
        #: Whether it went wrong; and what could not be written in the end.
        self.failed = False
        self.unwritten: memoryview | None = None
        self.writer: threading.Thread | None = None

    def __call__(self, record: Callable[[], Record], last: bool) -> None:
        """Writes it if it is time for it, beside the work; or the ``last`` time, and waits for the end of that. What
        fails is tried again the next time.
        """
        if last and self.writer is not None:
            self.writer.join()
        elif not last and (time.perf_counter() - self.last < self.wait or (self.writer and self.writer.is_alive())):
            return
        begun = time.perf_counter()
        self.writer = threading.Thread(target=self._write, args=(record(), begun, last))
        self.writer.start()
        if last:
            self.writer.join()

    def _write(self, record: Record, begun: float, last: bool) -> None:
        content = files.encode(replace(record, about=self.about))
        try:
            writing.write({self.path: content})
        except OSError as error:
            if last:
                self.unwritten = content
            elif not self.failed:
                self.say(f"the state can't be written to {self.path}: {error.strerror or error}; the render goes on")
            self.failed = True
        self.last = time.perf_counter()
        took = self.last - begun
        self.wait = max(min(max(self.TIMES * took, self.SHORTEST), self.LONGEST), self.LEAST_TIMES * took)
