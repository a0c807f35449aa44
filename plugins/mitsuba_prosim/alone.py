"""A lock for work that only one thread may do at a time: loading a scene, tracing and launching Dr.Jit kernels."""

import gc
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext

import drjit as dr
import mitsuba as mi

_lock = threading.RLock()


@contextmanager
def alone() -> Iterator[None]:
    """Holds the lock of this module, and pauses Python's garbage collector, during a ``with`` statement or a decorated
    function.

    A thread that holds the lock may call this function again. Do not hold the lock while the user's code runs, nor
    across the ``yield`` of an iterator.

    Two threads must not load scenes at the same time, because Mitsuba 3.9 has only one search path per process, which
    loading replaces. A kernel must not be traced while another thread loads a scene, because it contains calls of the
    objects of all scenes, also of incomplete ones.

    If the garbage collector freed a scene, which is in reference cycles, while a kernel is traced, virtual function
    calls before and after would have different instances. Dr.Jit 1.5 would then write a function twice into the kernel,
    and LLVM would abort the process. The collector is paused by its threshold, not by ``gc.disable``, because
    :mod:`prosim_scene` may call ``gc.enable`` in another thread.
    """
    with _lock:
        thresholds = gc.get_threshold()
        gc.set_threshold(0)
        try:
            yield
        finally:
            gc.set_threshold(*thresholds)


@contextmanager
def alone_if_traced() -> Iterator[None]:
    """Does what :func:`alone` does, except in scalar variants, where Mitsuba's own threads need the lock."""
    with alone() if dr.is_jit_v(mi.Float) else nullcontext():
        yield
