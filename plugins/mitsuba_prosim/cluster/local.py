"""A cluster on this machine, and one that is elsewhere."""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from multiprocessing import resource_tracker

import dask
import distributed
from distributed.core import Status
from tornado.ioloop import PeriodicCallback

from .faults import ClusterError

#: Dask looks at itself many times in a second, which takes the scheduler and each worker of this machine a twenty-fifth
#: of a processor; what it would learn, nobody asks.
CALM = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "500ms",
    "distributed.admin.system-monitor.interval": "10s",
}

#: Seconds that a scheduler has to answer; and from one look at whether workers are missing for good to the next.
ANSWER, REFILL = 10, 2


def be_quiet() -> None:
    """Dask tells of every worker that is lost, and of a scheduler that is; what matters is said here."""
    for name in ("distributed", "distributed.client", "distributed.scheduler", "distributed.nanny"):
        logging.getLogger(name).setLevel(logging.CRITICAL)


def refill(cluster: distributed.LocalCluster, number: int) -> None:
    """Sees to it from now on that there are so many workers: Dask gives up on one that is lost while it begins."""

    def look() -> None:
        if cluster.status is Status.running:
            cluster.scale(number)

    cluster.periodic_callbacks["refill"] = callback = PeriodicCallback(look, 1000 * REFILL)
    cluster.loop.add_callback(callback.start)  # type: ignore[union-attr]


@contextmanager
def workers(number: int, threads: int | None = None) -> Iterator[distributed.Client]:
    """A client of so many processes of this machine, for a while. ``threads``: of all together; None for all that
    there are. Their scheduler listens to this machine alone.
    """
    be_quiet()
    each = max(1, (threads or os.cpu_count() or 1) // number)
    with ExitStack() as until:
        with dask.config.set(CALM), deaf():
            cluster = until.enter_context(
                distributed.LocalCluster(
                    n_workers=number,
                    threads_per_worker=each,
                    processes=True,
                    host="127.0.0.1",
                    dashboard_address="127.0.0.1:0",
                    memory_limit=0,  # as much as one process may have
                    silence_logs=logging.CRITICAL,
                )
            )
        refill(cluster, number)
        yield until.enter_context(distributed.Client(cluster, set_as_default=False))


@contextmanager
def deaf() -> Iterator[None]:
    """Threads and processes that are begun meanwhile, and what these begin, hear no Ctrl-C: in a terminal it goes to
    all processes, but it is for the one that renders, which needs the others to end well.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    resource_tracker.ensure_running()  # with the first process it is begun, and would let the signal in again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def scheduler(address: str) -> Iterator[distributed.Client]:
    """A client of the scheduler at an address such as ``tcp://machine:8786``, for a while.

    Raises ClusterError where there is none.
    """
    be_quiet()
    try:
        client = distributed.Client(address, set_as_default=False, timeout=ANSWER)
    except (OSError, ValueError) as error:
        raise ClusterError(
            f"no scheduler answers at {address}; expected the address that `dask scheduler` says when it is started, "
            f"such as tcp://machine:8786 ({error})"
        ) from None
    try:
        yield client
    finally:
        client.close(timeout=2)
