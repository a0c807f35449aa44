"""A lock for work that only one thread may do at a time: loading a scene, tracing and launching kernels."""

from __future__ import annotations

import gc
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_lock = threading.RLock()


@contextmanager
def alone() -> Iterator[None]:
    """Acquires the lock of this module, and pauses Python's garbage collector, until the ``with`` block ends.

    Do not hold the lock while the user's code runs, nor across the ``yield`` of an iterator.

    Mitsuba 3.9 has only one search path and one number of threads per process, and each loading of a scene replaces the
    search path. Kernels call the objects of all scenes, including a scene that another thread is still loading: such a
    kernel would call functions of incomplete objects.

    The garbage collector frees scenes in reference cycles. If the collector frees a scene while a kernel is traced,
    virtual function calls before and after this moment differ in the number of instances. Then Dr.Jit 1.5 writes a
    function twice, and LLVM aborts the process. The pause sets the collector's threshold, because :mod:`prosim_scene`
    may enable the collector in another thread.
    """
    with _lock:
        thresholds = gc.get_threshold()
        gc.set_threshold(0)
        try:
            yield
        finally:
            gc.set_threshold(*thresholds)
