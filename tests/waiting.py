"""Waiting for states, and never for durations."""

import time

#: How long anything may take on a machine with other work, in seconds; no test waits so long that succeeds.
PATIENCE = 120


def until(condition):
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "nothing came of it"
        time.sleep(0.005)
