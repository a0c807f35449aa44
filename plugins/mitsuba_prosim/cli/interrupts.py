"""Handles signals that end a render early, such as the signal of Ctrl-C, so that the samples taken so far are kept."""

import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

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
