"""Pauses Python's garbage collection."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def garbage_collection_paused() -> Iterator[None]:
    """Pauses Python's garbage collection during a ``with`` statement or a decorated function. If garbage collection was
    disabled before, it stays disabled afterwards.

    Without the pause, garbage collection takes a third of the time in which a scene is read. While a scene is read, a
    garbage collection would free nothing, because the new objects have no reference cycles.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
