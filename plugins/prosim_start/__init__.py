"""How the ``prosim`` command starts: signals first, then words, and only then what is heavy.

Not within ``mitsuba_prosim``, because to import anything of that is to import Mitsuba: help needs none of it, and
Ctrl-C has to be heard from the beginning.
"""

import os
import signal
import sys

__all__ = ["main"]


def main() -> None:
    """Runs the command with the arguments of the process, and ends the process."""
    # Python's own handler would be heard between two lines of Python only, and answer with a traceback of imports. What
    # has something to keep when it ends, a render, says so itself. A signal that is ignored stays so.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from .group import prosim

    try:
        prosim(prog_name="prosim")
    except OSError as error:  # of the commands' own files they speak themselves, so this is standard output
        sys.stderr.write(f"Error: what there is to say could not be printed: {error.strerror or error}\n")
        # Or else Python would try again when it ends, and complain.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
