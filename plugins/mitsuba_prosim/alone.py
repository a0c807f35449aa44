"""What one thread of a process does at a time: loading a scene, and tracing kernels."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

_lock = threading.RLock()


@contextmanager
def alone() -> Iterator[None]:
    """Waits until no other thread is within, and keeps them out.

    Mitsuba 3.9 has one search path for the process, exchanged while a scene is loaded, and one number of threads. And
    its objects are known to all kernels as soon as their making begins: one that is traced meanwhile, in another
    thread, calls the functions of what is not there yet. Two threads of a process work with Mitsuba where a Dask worker
    shares it with its client, say.
    """
    with _lock:
        yield
