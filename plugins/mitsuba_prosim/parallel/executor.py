"""Executor that computes work items as tasks of a Dask cluster."""

import asyncio
import pickle
import time
import warnings
from collections.abc import Iterator
from typing import Any

import dask
import distributed
import drjit as dr
import numpy as np

from ..alone import alone
from ..engine import environment
from ..engine.accumulators import Accumulators
from ..engine.work import Executor, Results, WorkItem
from . import worker
from .worker import SceneBundle

#: Seconds between two checks of the workers; seconds without workers after which a warning is emitted; seconds after
#: which a scheduler that does not answer is lost, as for Dask.
CHECK_INTERVAL, WARNING_DELAY, ANSWER = 0.5, 10.0, 30.0

#: Number of tasks per worker (one runs and one waits); number of times that Dask repeats a task that fails.
WINDOW, RETRIES = 2, 2

#: Duration of a work item in seconds; maximum factor by which the last work items of a pass are shorter.
SECONDS, MAX_SHORTENING = 2.0, 8


class ClusterError(RuntimeError):
    """The cluster cannot render the image."""


class DaskExecutor(Executor):
    """Computes work items of the scene in ``bundle`` on the workers of ``client``, which may come and go."""

    def __init__(self, client: distributed.Client, bundle: SceneBundle) -> None:
        super().__init__(SECONDS)
        self.client = client
        #: The reason why the cluster is lost; None while the cluster is there.
        self.loss_reason: str | None = None
        self.address = getattr(client.scheduler, "address", "of the cluster")
        #: Addresses of the workers.
        self._workers = frozenset[str]()
        self._next_check, self._begun = 0.0, time.perf_counter()
        self.change_scene(bundle)

    def change_scene(self, bundle: SceneBundle) -> None:
        """Sets the scene of later images; not during a render."""
        self._scene, self._environment = pickle.dumps(bundle), environment.this_environment()
        #: The scene in the memory of the cluster; workers send it to each other.
        self._shared: distributed.Future | None = None

    def limit(self, left: int, seconds: float = np.inf) -> int:
        """Returns the maximum number of samples of the next work item, if ``left`` samples are not yet in work items.

        A work item takes a worker at most about ``seconds``. Near the end of a pass, work items are smaller by a factor
        of at most :data:`MAX_SHORTENING`, so that all workers finish at about the same time.
        """
        least = max(int(self.speed * min(self.seconds, seconds)) // MAX_SHORTENING, self.SMALLEST)
        return min(super().limit(left, seconds), max(left // (WINDOW * max(len(self._workers), 1)), least))

    def __call__(self, items: Iterator[WorkItem]) -> Results:
        """Computes the work items on the workers, stores their sums, and yields each of them, or None while there is no
        new result.

        If the scheduler is lost, the iteration ends early, and :attr:`loss_reason` tells why. Raises ClusterError for
        other software on a worker, and for a task that fails more than :data:`RETRIES` times.
        """
        done = distributed.as_completed(loop=self.client.loop, with_results=True, raise_errors=False)
        running = dict[distributed.Future, WorkItem]()
        try:
            while not self._check_workers():
                while len(running) < WINDOW * len(self._workers) and (item := next(items, None)) is not None:
                    running[self._submit(item, done)] = item
                if self._workers and not running:
                    return
                finished = done.next_batch(block=False)
                for future, result in finished:
                    item = running.pop(future)
                    if future.cancelled():  # the scheduler was disconnected for a moment
                        self._shared = None
                        running[self._submit(item, done)] = item
                    else:
                        item.store(self._sums(item, future, result))
                        yield item
                if not finished:
                    time.sleep(0.01)
                    yield None
        finally:
            for future in running:
                future.cancel()

    def _submit(self, item: WorkItem, done: distributed.as_completed) -> distributed.Future:
        with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 TiB"}):
            self._shared = self._shared or self.client.submit(bytes, self._scene)
            call = worker.sample, self.client.id, self._environment, self._shared, worker.packed(item)
            future = self.client.submit(*call, retries=RETRIES, pure=False)
        done.add(future)
        return future

    def _sums(self, item: WorkItem, future: distributed.Future, result: Any) -> Accumulators:
        """Returns the new sums of the pixels of a finished work item, and updates the measured speed of a worker. Warns
        if the worker has another processor or LLVM version.
        """
        if future.status == "error":
            _, error, _ = result
            raise ClusterError(f"samples: {RETRIES + 1} attempts failed, the last one with: {error}") from error
        seconds, content, found = result
        if wrong := environment.differences(found, environment.MUST_AGREE):
            raise ClusterError(f"a worker of the cluster can't take part: {wrong}")
        if other := environment.differences(found, environment.MAY_DIFFER):
            words = f"a worker is of another kind ({other}): its samples are as good, but may differ in their last bits"
            warnings.warn(words, stacklevel=2)
        self.update_speed(item.samples, seconds)
        with alone():
            sums: Accumulators = pickle.loads(content)
            dr.eval(sums)
        return sums

    def _check_workers(self) -> bool:
        """Updates the list of workers from time to time; returns whether the scheduler is lost. Warns if a worker was
        lost, or if there are none for :data:`WARNING_DELAY` seconds.
        """
        now, before = time.perf_counter(), self._workers
        if self.loss_reason or now < self._next_check:
            return bool(self.loss_reason)
        self._next_check = now + CHECK_INTERVAL
        try:
            if self.client.status != "running":
                raise OSError
            scheduler: Any = self.client.scheduler
            self._workers = frozenset(self.client.sync(scheduler.ncores, callback_timeout=ANSWER))
        # A lost connection raises any of these. Python 3.10 has another TimeoutError.
        except (OSError, ValueError, TypeError, AttributeError, asyncio.TimeoutError):
            self.loss_reason = f"the scheduler {self.address} has gone away"
            return True
        if before - self._workers:
            left = len(before & self._workers) or "none"
            words = f"a worker was lost, {left} left; others do its work, and the image stays the same"
            warnings.warn(words, stacklevel=2)
        if not self._workers and now - self._begun > WARNING_DELAY:
            warnings.warn("the cluster has no workers yet; the render begins when there are some", stacklevel=2)
        return False
