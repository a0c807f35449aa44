"""A state that is written from time to time, while an image is rendered."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import drjit as dr

from ..engine.record import Record
from ..engine.render import Render
from ..scene import atomic
from . import files


class Keeper:
    """Writes the record of an image to ``path`` every few seconds, and at its end.

    ``about``: that of :class:`.Record`; ``say``: told once that it can't be written. To be called between two portions
    of the work.
    """

    #: Seconds from one to the next, at least; the part of the processors' time that writing may take; and so many times
    #: what it takes by the clock, where the disk is slow.
    SHORTEST, SHARE, TIMES = 4.0, 0.02, 3

    def __init__(self, path: Path, about: Mapping[str, Any], say: Callable[[str], None] = lambda _: None) -> None:
        self.path, self.about, self.say = path, about, say
        self.last = time.perf_counter()
        self.wait = self.SHORTEST
        #: Whether it went wrong; and what could not be written in the end.
        self.failed = False
        self.unwritten: atomic.Content | None = None
        self.writer: threading.Thread | None = None

    def __call__(self, render: Render, last: bool = False) -> None:
        """Writes the checkpoint of ``render`` if it is time for it, in a thread; or the ``last`` time, and waits for
        its end. What fails is tried again the next time.
        """
        if last and self.writer is not None:
            self.writer.join()
        elif not last and (time.perf_counter() - self.last < self.wait or (self.writer and self.writer.is_alive())):
            return
        begun, used = time.perf_counter(), time.thread_time()
        content = replace(render.checkpoint(), about=self.about)
        self.writer = threading.Thread(target=self._write, args=(content, begun, time.thread_time() - used, last))
        self.writer.start()
        if last:
            self.writer.join()

    def _write(self, record: Record, begun: float, used: float, last: bool) -> None:
        content, start = partial(files.put, record), time.thread_time()
        try:
            atomic.write({self.path: content})
        except OSError as error:
            if last:
                self.unwritten = content
            elif not self.failed:
                self.say(f"the state can't be written to {self.path}: {error.strerror or error}; the render goes on")
            self.failed = True
        self.last = time.perf_counter()
        used += time.thread_time() - start
        self.wait = max(
            self.SHORTEST, used / (self.SHARE * max(dr.thread_count(), 1)), self.TIMES * (self.last - begun)
        )
