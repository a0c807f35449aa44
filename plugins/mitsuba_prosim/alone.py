"""What one thread of a process does at a time: load a scene, trace and launch kernels."""

from __future__ import annotations

import gc
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_lock = threading.RLock()
_depth, _thresholds = 0, gc.get_threshold()


@contextmanager
def alone() -> Iterator[None]:
    """Waits until no other thread is within, keeps them out, and pauses Python's garbage collector. Not to be held
    while control is with the user, nor across a ``yield``.

    Mitsuba 3.9 has one search path for the process, exchanged while a scene is loaded, and one number of threads. Its
    objects are known to all kernels as soon as they are made: a kernel that another thread traces meanwhile calls
    functions of objects that are not complete.

    The collector frees scenes that reference cycles keep alive. If one goes while a kernel is traced, the virtual
    function calls before and after differ in the number of instances; Dr.Jit 1.5 then writes a function twice, and LLVM
    ends the process. The pause is by the collector's threshold, as :mod:`prosim_scene` in another thread may enable it.
    """
    global _depth, _thresholds
    with _lock:
        if not _depth:
            _thresholds = gc.get_threshold()
            gc.set_threshold(0)
        _depth += 1
        try:
            yield
        finally:
            _depth -= 1
            if not _depth:
                gc.set_threshold(*_thresholds)
