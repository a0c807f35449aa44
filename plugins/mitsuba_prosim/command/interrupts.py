"""Signals that end a render, and let it keep what it has."""

import os
import select
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

#: Ctrl-C, the polite kill, and the end of the terminal.
ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

#: Seconds from one time that it is told to stop to the next.
AGAIN = 0.1


@contextmanager
def interruptible(stop: Callable[[], None]) -> Iterator[list[int]]:
    """Calls ``stop`` at the first signal that ends a program, and again and again until the end, as a renderer that has
    not begun yet forgets it; a second signal ends the process at once.

    Yields the list of the signals that have come. What the process was told to ignore (by ``nohup``, or in the
    background of a script) stays ignored.
    """
    seen: list[int] = []
    handled = [number for number in ENDING if signal.getsignal(number) not in (signal.SIG_IGN, None)]
    reader, writer = os.pipe()
    os.set_blocking(writer, False)

    # In a thread, because Mitsuba's own integrators hold up Python's handlers, in the main thread, until they are done.
    def watch() -> None:
        come = 0
        while True:
            if come and not select.select([reader], [], [], AGAIN)[0]:
                stop()
                continue
            number = int.from_bytes(os.read(reader, 1), "little")
            if not number:  # the end
                return
            come += number in handled
            if come > 1:
                os.write(2, b"\nEnded at once.\n" if os.isatty(2) else b"Ended at once.\n")
                os._exit(128 + number)
            if come and number == signal.SIGINT and os.isatty(2):  # below ^C
                os.write(2, b"\nEnding; once more ends it at once.\n")
            stop()

    def handle(number: int, _: object) -> None:
        seen.append(number)
        stop()

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    wakeup = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    before = {number: signal.signal(number, handle) for number in handled}
    try:
        yield seen
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(wakeup)
        os.close(writer)
        watcher.join()
        os.close(reader)
