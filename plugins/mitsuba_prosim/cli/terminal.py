"""What a command does with its terminal: shows its progress and the messages of Mitsuba's log, and handles signals that
end a render early, such as that of Ctrl-C, so that the samples taken so far are kept.
"""

import os
import re
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

import mitsuba as mi
from tqdm import tqdm

#: Progress below which the remaining time is unknown, because kernels are compiled first.
KNOWN = 0.005

tqdm.set_lock(threading.RLock())  # the default lock imports multiprocessing


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


#: The signals of Ctrl-C, of ``kill``, and of a closed terminal, as far as the operating system has them.
ENDING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)]

#: Seconds between two calls of ``stop``.
AGAIN = 0.1


@contextmanager
def interruptible(stop: Callable[[], None], received_signals: list[int] | None = None) -> Iterator[list[int]]:
    """Calls ``stop`` when the first signal in :data:`ENDING` arrives; a second signal ends the process at once, with
    the exit code 128 plus its number.

    ``stop`` is called repeatedly until the ``with`` block ends, because a renderer ignores a call before the render has
    started. Yields the list ``received_signals``, or a new one, to which the numbers of arriving signals are appended.
    Ignored signals (after ``nohup``, for example) and handlers that were not installed from Python stay as they are.
    """
    received_signals = [] if received_signals is None else received_signals
    handled = [number for number in ENDING if signal.getsignal(number) not in (signal.SIG_IGN, None)]
    reader, writer = socket.socketpair()  # on Windows, a process cannot wait for a pipe with a timeout
    writer.setblocking(False)

    # A thread watches for signals, because Python calls handlers only in the main thread, and Mitsuba's own integrators
    # block the main thread.
    def watch() -> None:
        """Reads signals from the socket until it is closed."""
        while True:
            try:
                received = reader.recv(1)
            except TimeoutError:
                stop()
                continue
            if not received:  # the socket was closed: the ``with`` block ends
                return
            if (number := received[0]) not in handled:
                continue
            if reader.gettimeout() is not None:  # the first signal has set the timeout, so this is the second signal
                with suppress(OSError):  # the terminal was closed
                    os.write(2, b"\nEnded at once.\n" if os.isatty(2) else b"Ended at once.\n")
                os._exit(128 + number)
            if number == signal.SIGINT and os.isatty(2):  # on the line below ^C
                os.write(2, b"\nEnding; once more ends it at once.\n")
            stop()
            reader.settimeout(AGAIN)

    def handle(number: int, _: object) -> None:
        received_signals.append(number)
        stop()

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    wakeup = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
    before = {number: signal.signal(number, handle) for number in handled}
    try:
        yield received_signals
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(wakeup)
        writer.close()
        watcher.join()
        reader.close()
