"""Handles signals that end a render; the samples so far are kept."""

import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

#: Ctrl-C, the polite kill, and the end of the terminal, as far as the system has them.
ENDING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)]

#: Seconds from one call of ``stop`` to the next.
AGAIN = 0.1


@contextmanager
def interruptible(stop: Callable[[], None], received_signals: list[int] | None = None) -> Iterator[list[int]]:
    """Calls ``stop`` at the first signal of :data:`ENDING`, and again until the context ends, because a renderer that
    has not started yet forgets it. A second signal ends the process at once.

    Yields the list of these signals that have come, ``received_signals`` if that is given. Signals that the process
    ignores (by ``nohup``, or in the background of a script) stay ignored; handlers of other signals run as before.
    """
    received_signals = [] if received_signals is None else received_signals
    handled = [number for number in ENDING if signal.getsignal(number) not in (signal.SIG_IGN, None)]
    reader, writer = socket.socketpair()  # Windows can't wait for a pipe
    writer.setblocking(False)

    # In a thread, because Mitsuba's own integrators hold up Python's handlers, in the main thread, until they are done.
    def watch() -> None:
        while True:
            try:
                received = reader.recv(1)
            except TimeoutError:
                stop()
                continue
            if not received:  # the end
                return
            if (number := received[0]) not in handled:
                continue
            if reader.gettimeout() is not None:  # the second
                os.write(2, b"\nEnded at once.\n" if os.isatty(2) else b"Ended at once.\n")
                os._exit(128 + number)
            if number == signal.SIGINT and os.isatty(2):  # below ^C
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
