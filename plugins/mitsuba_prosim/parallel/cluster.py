"""Starts a Dask cluster with workers on this machine, or connects to the scheduler of a running cluster."""

import asyncio
import logging
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

import dask
import distributed

from .executor import ClusterError

#: Settings of a cluster on this machine. Profiles and frequent statistics would take 4 % of a processor per process. If
#: a worker dies, its task is repeated on another worker. The HTTP servers of Dask, which know no TLS, have no pages.
SETTINGS = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "500ms",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.scheduler.allowed-failures": 10,
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
}

#: Timeout for the connection to a scheduler, and again for its first answer, in seconds; interval at which lost workers
#: are replaced; maximum number of attempts to start local workers.
TIMEOUT, REPLACE_INTERVAL, ATTEMPTS = 10, "2s", 3


def silence() -> None:
    """Hides the log messages of Dask, because ``mitsuba_prosim`` prints its own about lost workers and schedulers."""
    for name in ("distributed", "distributed.client", "distributed.scheduler", "distributed.nanny"):
        logging.getLogger(name).setLevel(logging.CRITICAL)


@contextmanager
def workers(number: int, threads: int | None = None, folder: Path | None = None) -> Iterator[distributed.Client]:
    """Starts local worker processes, and yields a client of their scheduler; lost workers are replaced.

    No other process can connect to the scheduler or to a worker, because they listen only to this machine, and use TLS
    with a certificate that exists only during the ``with`` block. ``number`` is the number of processes. ``threads`` is
    the number of their threads together; None stands for one per processor. ``folder`` is a folder for temporary files;
    None stands for Dask's default, which Dask does not delete. Raises RuntimeError if :data:`ATTEMPTS` attempts fail.
    """
    silence()
    place = None if folder is None else str(folder)
    for attempts_left in range(ATTEMPTS)[::-1]:
        try:
            # The setting is for the scheduler, and the argument for the workers, also for those that are replaced.
            with dask.config.set({**SETTINGS, "temporary-directory": place}), interrupts_blocked():
                cluster = distributed.LocalCluster(
                    n_workers=number,
                    threads_per_worker=max(1, (threads or os.cpu_count() or 1) // number),
                    host="127.0.0.1",
                    local_directory=place,
                    security=True if folder is None else certificate(folder),
                    dashboard_address="127.0.0.1:0",
                    memory_limit=0,  # no limit
                    silence_logs=logging.CRITICAL,
                )
            break
        except RuntimeError:  # a worker was lost at its start
            if not attempts_left:
                raise
    with cluster:
        # Without adaptive scaling, Dask does not replace a worker that is lost at its start.
        cluster.adapt(minimum=number, maximum=number, interval=REPLACE_INTERVAL)
        with distributed.Client(cluster, set_as_default=False) as client:
            yield client


def certificate(folder: Path) -> distributed.Security:
    """Returns a temporary certificate with files in ``folder``: Dask would write them elsewhere at each connection, and
    leave them there if the process is killed at this moment.
    """
    security = distributed.Security.temporary()
    for part in ("cert", "key"):
        path = folder / f"{part}.pem"
        path.touch(mode=0o600)
        path.write_text(getattr(security, f"tls_client_{part}"))
        for role in ("client", "scheduler", "worker"):
            setattr(security, f"tls_{role}_{part}", str(path))
    return security


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Blocks the signals of Ctrl-C and of a closed terminal in all processes and threads that start inside the ``with``
    block.

    A terminal sends these signals to all processes, but only the main process, which holds the image, may handle them.
    On Windows, this function does nothing.
    """
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGHUP})
    resource_tracker.ensure_running()  # started later, the tracker would unblock the signal of Ctrl-C
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class Client(distributed.Client):
    """A client that does not wait for ever if something else than a scheduler answers at the address."""

    def start(self, **how: Any) -> None:
        """Connects to the scheduler. Raises TimeoutError without an answer."""
        super().start(callback_timeout=2 * TIMEOUT, **how)


@contextmanager
def scheduler(address: str) -> Iterator[distributed.Client]:
    """Yields a client of the Dask scheduler at ``tcp://...``. Raises ClusterError if none answers."""
    silence()
    try:
        client = Client(address, set_as_default=False, timeout=TIMEOUT)
    # TypeError: tls:// without a certificate. Python 3.10 has another TimeoutError.
    except (OSError, ValueError, TypeError, asyncio.TimeoutError) as error:
        raise ClusterError(
            f"no scheduler answers at {address}; start one with `dask scheduler` and give the address that it prints, "
            f"such as tcp://machine:8786 ({error})"
        ) from None
    try:
        yield client
    finally:
        client.close(timeout=2)
