"""Python's garbage collector, kept still while what is made is no garbage."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def still() -> Iterator[None]:
    """Keeps the collector from running.

    It runs again and again while many objects are made, and looks at all of them: a third of the time of reading a
    scene, in which nothing is made that refers to itself.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
