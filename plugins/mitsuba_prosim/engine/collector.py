"""Python's garbage collector, kept still while kernels are traced."""

from __future__ import annotations

import contextlib
import gc
import threading
from collections.abc import Iterator

_lock = threading.RLock()
_within, _thresholds = 0, gc.get_threshold()


@contextlib.contextmanager
def suspended() -> Iterator[None]:
    """Keeps Python's garbage collector from running, until the last thread has left this.

    What it frees may be a scene that has gone in a cycle (with the traceback of an exception, say). Were that freed
    while a kernel is traced, the calls of virtual functions before and after would differ in the number of instances,
    and Dr.Jit 1.5 writes a function that both call into the kernel twice, which LLVM refuses by ending the process.

    It is told by the collector's threshold, as others who disable it for a while, such as :mod:`prosim_scene` in
    another thread, enable it again.
    """
    global _within, _thresholds
    with _lock:
        if not _within:
            _thresholds = gc.get_threshold()
            gc.set_threshold(0)
        _within += 1
    try:
        yield
    finally:
        with _lock:
            _within -= 1
            if not _within:
                gc.set_threshold(*_thresholds)
