"""Mitsuba's log while a command runs."""

import os
import re
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import BinaryIO

import mitsuba as mi
from tqdm.auto import tqdm

LEVELS = (mi.LogLevel.Warn, mi.LogLevel.Info, mi.LogLevel.Debug, mi.LogLevel.Trace)

#: How a line of Mitsuba's log begins.
HEAD = re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d (?P<level>[A-Z]+) +")

#: Colours, and the progress bar that some of Mitsuba's integrators draw.
DECORATION = re.compile(r"\x1b\[[0-9;]*m|\r[^\n]*")


@contextmanager
def log(verbose: int) -> Iterator[None]:
    """Sends Mitsuba's log to standard error, out of the progress bar's way: warnings, or more if ``verbose``.

    Mitsuba writes to standard output, which is a file meanwhile, and a thread prints what is added to it. Its logger
    must never have an appender that Python knows, be it Mitsuba's own: to use one it waits for the interpreter, while
    it holds its lock and often that of the plugin manager. A thread that makes one of our plugins has the interpreter
    and wants these locks, and both would wait for ever.
    """
    level = mi.log_level()
    sys.stdout.flush()
    try:
        output = os.dup(1)
    except OSError:  # there is none
        output = None
    with tempfile.NamedTemporaryFile(delete=False) as file, open(file.name, "rb") as added:
        with suppress(OSError):  # Windows refuses while it is open
            os.unlink(file.name)
        finished = threading.Event()
        reader = threading.Thread(target=_follow, args=(added, finished), daemon=True)
        reader.start()
        if output is not None:
            os.dup2(file.fileno(), 1)
        mi.set_log_level(LEVELS[min(verbose, len(LEVELS) - 1)])
        try:
            yield
        finally:
            mi.set_log_level(level)
            if output is not None:
                os.dup2(output, 1)
                os.close(output)
            finished.set()
            reader.join()
    with suppress(OSError):
        os.unlink(file.name)


def _follow(file: BinaryIO, finished: threading.Event) -> None:
    """Prints the lines that are added to ``file``, until ``finished``; a warning of the same words once."""
    once, last, rest = Once(), False, b""
    while not last:
        last = finished.wait(0.05)
        added = rest + file.read()
        end = len(added) if last else added.rfind(b"\n") + 1
        rest = added[end:]
        if text := once(DECORATION.sub("", added[:end].decode("utf-8", "replace"))):
            tqdm.write(text, file=sys.stderr, end="" if text.endswith("\n") else "\n")


class Once:
    """Leaves warnings out that have been said, of each frame of a film for example."""

    def __init__(self) -> None:
        self.said: set[str] = set()
        self.silent = False

    def __call__(self, text: str) -> str:
        """What is left of whole lines; a message may have several."""
        return "".join(line for line in text.splitlines(keepends=True) if not self._was_said(line))

    def _was_said(self, line: str) -> bool:
        if head := HEAD.match(line):
            message = line[head.end() :]
            self.silent = head["level"] == "WARN" and message in self.said
            self.said.add(message)
        return self.silent
