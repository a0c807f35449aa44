"""Pauses Python's garbage collection."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def garbage_collection_paused() -> Iterator[None]:
    """Pauses Python's garbage collection in a ``with`` statement or a decorated function.

    The collector takes a third of the time while a scene is read, and finds nothing: new objects have no cycles.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
