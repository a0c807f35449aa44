"""What is special where Mitsuba's own loop takes the samples: in scalar variants."""

from __future__ import annotations

import signal
import threading


def take_back_interrupts() -> None:
    """Gives SIGINT back to Python, as Mitsuba (3.9) does after its own ``render``, but not where that was called within
    another: it would take Ctrl-C for ever, for an integrator that may be gone.
    """
    handler = signal.getsignal(signal.SIGINT)
    if handler is not None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, handler)
