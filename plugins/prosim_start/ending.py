"""Ends a command without a result at Ctrl-C: one line, and the exit code of shells for it."""

import _thread
import os
import signal

#: The exit code that shells use for a process that Ctrl-C has ended.
EXIT_CODE = 128 + signal.SIGINT


def end_at_once() -> None:
    """Lets Ctrl-C end the process at any moment from now on: by a line on standard error, and :data:`EXIT_CODE`.

    Python's own handler answers between two lines of Python only, and with a traceback, of imports for example. Here a
    thread waits as well, so that compilers and renderers hold nothing up. Where the signal is ignored (by ``nohup``, or
    in the background of a script), it stays so.
    """
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        return
    lines = [b"Interrupted.\n"]
    reader, writer = os.pipe()
    if hasattr(os, "set_blocking"):  # not on Windows before Python 3.12, which does without
        os.set_blocking(writer, False)

    def end(*_: object) -> None:
        if lines:  # whoever comes first
            line = lines.pop()
            try:
                os.write(2, b"\n" + line if os.isatty(2) else line)  # below ^C, or a bar
            finally:
                os._exit(EXIT_CODE)

    def watch() -> None:
        while os.read(reader, 1) != bytes([signal.SIGINT]):
            pass
        end()

    signal.signal(signal.SIGINT, end)
    signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    _thread.start_new_thread(watch, ())
