"""Python's garbage collector, kept still while kernels are traced."""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Iterator


@contextlib.contextmanager
def suspended() -> Iterator[None]:
    """Keeps Python's garbage collector from running.

    What it frees may be a scene that has gone in a cycle (with the traceback of an exception, say). Were that freed
    while a kernel is traced, the calls of virtual functions before and after would differ in the number of instances,
    and Dr.Jit 1.5 writes a function that both call into the kernel twice, which LLVM refuses by ending the process.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
