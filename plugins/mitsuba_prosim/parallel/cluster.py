"""A cluster on this machine, and a scheduler elsewhere."""

from __future__ import annotations

import logging
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker

import dask
import distributed

from .executor import ClusterError

#: Settings of a cluster on this machine. Profiles and frequent statistics would take 4 % of a processor per process.
#: A worker that dies is no reason to give up its task.
SETTINGS = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "500ms",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.scheduler.allowed-failures": 10,
}

#: Timeout of a scheduler, in seconds; interval at which lost workers are replaced.
TIMEOUT, REPLACE_INTERVAL = 10, "2s"


def silence() -> None:
    """Silences Dask's messages about lost workers and schedulers; this package has its own."""
    for name in ("distributed", "distributed.client", "distributed.scheduler", "distributed.nanny"):
        logging.getLogger(name).setLevel(logging.CRITICAL)


@contextmanager
def workers(number: int, threads: int | None = None) -> Iterator[distributed.Client]:
    """A client of this number of local processes. Their scheduler listens to this machine only.

    ``threads``: of all processes together; None for one per processor.
    """
    silence()
    with dask.config.set(SETTINGS), interrupts_blocked():
        cluster = distributed.LocalCluster(
            n_workers=number,
            threads_per_worker=max(1, (threads or os.cpu_count() or 1) // number),
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            memory_limit=0,  # none
            silence_logs=logging.CRITICAL,
        )
    with cluster:
        # Else Dask gives up a worker that is lost at its start.
        cluster.adapt(minimum=number, maximum=number, interval=REPLACE_INTERVAL)
        with distributed.Client(cluster, set_as_default=False) as client:
            yield client


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Starts threads and processes that ignore Ctrl-C, which a terminal sends to all processes: only the one that
    renders handles it.
    """
    if sys.platform == "win32":
        yield
        return
    resource_tracker.ensure_running()  # it starts with the first process and would unblock the signal
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def scheduler(address: str) -> Iterator[distributed.Client]:
    """A client of the scheduler at an address such as ``tcp://machine:8786``. Raises ClusterError."""
    silence()
    try:
        client = distributed.Client(address, set_as_default=False, timeout=TIMEOUT)
    except (OSError, ValueError) as error:
        raise ClusterError(
            f"no scheduler answers at {address}; start one with `dask scheduler` and give the address that it prints, "
            f"such as tcp://machine:8786 ({error})"
        ) from None
    try:
        yield client
    finally:
        client.close(timeout=2)
