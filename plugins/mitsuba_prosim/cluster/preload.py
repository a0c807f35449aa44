"""What a worker of this machine does when it begins: Ctrl-C in the terminal, which goes to all processes, is for the
one that renders, and needs the workers to end well.
"""

import signal
from typing import Any


def dask_setup(worker: Any) -> None:
    """Called by Dask in the worker's main thread."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
