"""Starts the ``prosim`` command: handles signals and reads the arguments before it imports Mitsuba.

This package is not a part of ``mitsuba_prosim``, because importing any module of ``mitsuba_prosim`` imports Mitsuba.
Help does not need Mitsuba, and Ctrl-C must work from the beginning.
"""

import gc
import io
import os
import signal
import sys

__all__ = ["main"]


def main() -> None:
    """Runs the command with the arguments of the process, and ends the process.

    If the command raises an OSError, for example because standard output is closed, prints a message, and ends the
    process with the exit code 1.
    """
    for file, name in enumerate(("stdin", "stdout", "stderr")):
        open_if_closed(file, name)
    # Mitsuba and XML need names of files in UTF-8, so the process starts again, but once.
    if sys.getfilesystemencoding() != "utf-8" and os.environ.get("PYTHONUTF8") != "1":
        os.environ["PYTHONUTF8"] = "1"
        os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])
    # A name that the terminal, or the file in its place, cannot show is no error of a command that has done its work.
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        os.getcwd()
    except OSError:  # Mitsuba would abort
        sys.stderr.write("Error: the current folder was deleted; change to another folder.\n")
        sys.exit(2)
    # With the system's handler, Ctrl-C ends the process at any moment. Python's handler would wait for compilers and
    # renderers. A render keeps its result, so it installs its own handler. A signal that is ignored (after nohup, for
    # example) stays ignored.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    gc.disable()  # modules make many objects and no garbage
    from .group import prosim

    try:
        prosim(prog_name="prosim")
    except OSError as error:  # commands handle errors of their files; this is usually standard output
        sys.stderr.write(f"Error: {error.filename or 'standard output'}: {error.strerror or error}\n")
        # Otherwise Python would write to standard output again when the process ends, and report a second error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    finally:
        gc.freeze()  # Python would search all objects for garbage before the process ends
        # Ignores signals while Python ends, because the work is done.
        for name in {"SIGINT", "SIGTERM", "SIGHUP"} & set(dir(signal)):
            signal.signal(getattr(signal, name), signal.SIG_IGN)


def open_if_closed(file: int, name: str) -> None:
    """Opens the null device as the standard file ``file`` (0, 1 or 2), if this file is closed.

    If the standard file stayed closed, the next file that the process opens, perhaps an image, would take its number.
    """
    try:
        os.fstat(file)
    except OSError:
        os.open(os.devnull, os.O_RDWR)  # the system uses the first free number, which is ``file``
        setattr(sys, name, os.fdopen(file, "w" if file else "r", encoding="utf-8", closefd=False))
