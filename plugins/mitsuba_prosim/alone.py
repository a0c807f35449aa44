"""A lock for work of one thread at a time: loading a scene, tracing and launching kernels."""

from __future__ import annotations

import gc
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_lock = threading.RLock()


@contextmanager
def alone() -> Iterator[None]:
    """Locks, and pauses Python's garbage collector. Do not hold it while control is with the user, nor across a
    ``yield``.

    Mitsuba 3.9 has one search path per process, which loading a scene replaces, and one number of threads. Kernels call
    the objects of all scenes, also of one that is being loaded: a kernel that another thread traces then calls
    functions of incomplete objects.

    The collector frees scenes in reference cycles. If it does so while a kernel is traced, the virtual function calls
    before and after differ in the number of instances; Dr.Jit 1.5 then writes a function twice, and LLVM aborts the
    process. The pause uses the collector's threshold, as :mod:`prosim_scene` may enable it in another thread.
    """
    with _lock:
        thresholds = gc.get_threshold()
        gc.set_threshold(0)
        try:
            yield
        finally:
            gc.set_threshold(*thresholds)
