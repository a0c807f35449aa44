"""Shows the messages of Mitsuba's log while a command runs."""

import os
import re
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import mitsuba as mi
from tqdm import tqdm

LEVELS = (mi.LogLevel.Warn, mi.LogLevel.Info, mi.LogLevel.Debug, mi.LogLevel.Trace)

#: Matches the date and time at the beginning of each message of Mitsuba's log.
TIME = re.compile(r"^(\d{4}-\d\d-\d\d \d\d:\d\d:\d\d )", re.MULTILINE)

#: Matches terminal colours, and the progress bar that some of Mitsuba's integrators draw.
DECORATION = re.compile(r"\x1b\[[0-9;]*m|\r[^\n]*")


@contextmanager
def log(verbose: int, folder: Path) -> Iterator[None]:
    """Prints Mitsuba's log messages to standard error, above the progress bar, until the ``with`` block ends.

    If ``verbose`` is 0, only warnings and errors are printed; 1 adds information, 2 debug messages, 3 all messages.
    Mitsuba writes its log to standard output, so this function redirects standard output to a file in ``folder``, which
    a thread follows.

    An appender of Mitsuba's logger that is accessible from Python may cause a deadlock: it waits for Python's
    interpreter lock, while its thread holds the locks of the logger and often of the plugin manager. Another thread
    that creates a plugin in Python holds the interpreter lock, and waits for those locks.
    """
    level = mi.log_level()
    sys.stdout.flush()
    output, finished = os.dup(1), threading.Event()
    with open(folder / "log", "w+b") as file, open(file.name, "rb") as added:
        reader = threading.Thread(target=_follow, args=(added, finished), daemon=True)
        reader.start()
        os.dup2(file.fileno(), 1)
        mi.set_log_level(LEVELS[min(verbose, len(LEVELS) - 1)])
        try:
            yield
        finally:
            mi.set_log_level(level)
            os.dup2(output, 1)
            os.close(output)
            finished.set()
            reader.join()


def _follow(file: BinaryIO, finished: threading.Event) -> None:
    """Prints the complete lines that are appended to ``file``, until ``finished`` is set; prints equal warnings only
    once.

    Times, terminal colours and progress bars do not count.
    """
    warnings, at_end, incomplete = set[str](), False, b""
    while not at_end:
        at_end = finished.wait(0.05)
        added = incomplete + file.read()
        end = len(added) if at_end else added.rfind(b"\n") + 1
        incomplete = added[end:]
        first, *parts = TIME.split(DECORATION.sub("", added[:end].decode("utf-8", "replace")))
        messages = [first]
        for time, message in zip(parts[::2], parts[1::2]):
            if not (message.startswith("WARN") and message in warnings):
                messages.append(time + message)
            warnings.add(message)
        if text := "".join(messages):
            tqdm.write(text, file=sys.stderr, end="" if text.endswith("\n") else "\n")
