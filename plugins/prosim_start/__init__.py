"""Starts the ``prosim`` command: handles signals, reads the arguments, and only then imports Mitsuba.

Not within ``mitsuba_prosim``, because to import anything of that is to import Mitsuba: help needs none of it, and
Ctrl-C must work from the beginning.
"""

import os
import signal
import sys

__all__ = ["main"]


def main() -> None:
    """Runs the command with the arguments of the process, and ends the process."""
    for file, name in enumerate(("stdin", "stdout", "stderr")):
        open_if_closed(file, name)
    # Ctrl-C ends the process at any moment, also in compilers and renderers, where Python's handler waits. A render,
    # which has a result to keep, handles the signal itself. Where it is ignored (by nohup, say), it stays so.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from .group import prosim

    try:
        prosim(prog_name="prosim")
    except OSError as error:  # the commands handle errors of their files, so this is most often standard output
        sys.stderr.write(f"Error: {error.filename or 'standard output'}: {error.strerror or error}\n")
        # Or else Python would try again when it ends, and complain.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    finally:  # the work is done, and Python needs a moment to end
        for name in {"SIGINT", "SIGTERM", "SIGHUP"} & set(dir(signal)):
            signal.signal(getattr(signal, name), signal.SIG_IGN)


def open_if_closed(file: int, name: str) -> None:
    """Opens the null device in place of one of the three standard files that is closed: the next file that is opened,
    an image perhaps, would take its place.
    """
    try:
        os.fstat(file)
    except OSError:
        os.open(os.devnull, os.O_RDWR)  # the first that is free
        setattr(sys, name, os.fdopen(file, "w" if file else "r", encoding="utf-8", closefd=False))
