"""Python's garbage collector, kept still while kernels are traced."""

from __future__ import annotations

import contextlib
import gc
import threading
from collections.abc import Iterator

_lock = threading.RLock()
_within, _was_enabled = 0, False


@contextlib.contextmanager
def suspended() -> Iterator[None]:
    """Keeps Python's garbage collector from running, until the last thread has left this.

    What it frees may be a scene that has gone in a cycle (with the traceback of an exception, say). Were that freed
    while a kernel is traced, the calls of virtual functions before and after would differ in the number of instances,
    and Dr.Jit 1.5 writes a function that both call into the kernel twice, which LLVM refuses by ending the process.
    """
    global _within, _was_enabled
    with _lock:
        if not _within:
            _was_enabled = gc.isenabled()
            gc.disable()
        _within += 1
    try:
        yield
    finally:
        with _lock:
            _within -= 1
            if not _within and _was_enabled:
                gc.enable()
