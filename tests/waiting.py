"""Waiting for states, and never for durations; processes that end with their test."""

import subprocess
import time
from contextlib import contextmanager

#: How long anything may take on a machine with other work, in seconds; no test waits so long that succeeds.
PATIENCE = 120


def until(condition):
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "nothing came of it"
        time.sleep(0.005)


@contextmanager
def started(command, **how):
    """A process, which is killed where a test fails before it has ended."""
    with subprocess.Popen(command, **how) as process:
        try:
            yield process
        finally:
            process.kill()
