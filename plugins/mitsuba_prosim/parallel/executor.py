"""Work items as tasks of a Dask cluster."""

from __future__ import annotations

import pickle
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import dask
import distributed
import drjit as dr
import mitsuba as mi
import numpy as np

from .. import atomic
from ..alone import alone
from ..engine import environment
from ..engine.accumulators import Accumulators
from ..engine.work import Executor, Results, WorkItem
from ..scene import rendering, scene_file
from . import worker
from .bundle import SceneBundle

#: Seconds between two checks of the workers, and without workers until a warning.
CHECK_INTERVAL, WARNING_DELAY = 0.5, 10.0

#: Tasks for each worker: one runs and one waits. Number of times that Dask repeats a task that fails.
WINDOW, RETRIES = 2, 2

#: Seconds of a work item; the last ones are smaller, by this factor at most.
SECONDS, FEWER = 2.0, 8


class ClusterError(RuntimeError):
    """A cluster that cannot render the image."""


class DaskExecutor(Executor):
    """Takes samples of the scene in ``bundle`` by the workers of ``client``, which may come and go."""

    photon_passes = None

    def __init__(self, client: distributed.Client, bundle: SceneBundle) -> None:
        super().__init__(SECONDS)
        self.client = client
        #: Why the cluster has gone away.
        self.loss_reason: str | None = None
        self.address = getattr(client.scheduler, "address", "of the cluster")
        #: The addresses of the workers.
        self._workers = frozenset[str]()
        self._next_check, self._begun = 0.0, time.perf_counter()
        self.change_scene(bundle)

    def change_scene(self, bundle: SceneBundle) -> None:
        """Continues with another scene, between two images."""
        self._scene, self._environment = pickle.dumps(bundle), environment.this_environment()
        #: The scene in the cluster, whose workers pass it on to each other.
        self._shared: distributed.Future | None = None

    def limit(self, left: int, seconds: float = np.inf) -> int:
        """Samples of the next work item: some seconds of a worker, less towards the end."""
        least = max(int(self.speed * min(self.seconds, seconds)) // FEWER, self.SMALLEST)
        return min(super().limit(left, seconds), max(left // (WINDOW * max(len(self._workers), 1)), least))

    def __call__(self, items: Iterator[WorkItem]) -> Results:
        """Yields each work item with its sums, and None while there is nothing new, so that the caller can stop at
        once.

        Raises ClusterError if a worker cannot take part, or if a task fails too often.
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
                    if future.cancelled():  # the connection to the scheduler was lost for a moment
                        self._shared = None
                        running[self._submit(item, done)] = item
                    else:
                        yield item, self._sums(item, future, result)
                if not finished:
                    time.sleep(0.01)
                    yield None
        finally:
            for future in running:
                future.cancel()

    def _submit(self, item: WorkItem, done: distributed.as_completed) -> distributed.Future:
        """Begins a work item, whose sums ``done`` will have. Dask repeats it if its worker is lost."""
        with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 TiB"}):
            self._shared = self._shared or self.client.submit(bytes, self._scene)
            call = worker.sample, self.client.id, self._environment, self._shared, worker.packed(item)
            future = self.client.submit(*call, retries=RETRIES, pure=False)
        done.add(future)
        return future

    def _sums(self, item: WorkItem, future: distributed.Future, result: Any) -> Accumulators:
        """The sums of a finished work item, whose worker gave this ``result`` or error. Raises ClusterError."""
        if future.status == "error":
            _, error, _ = result
            raise ClusterError(f"samples: {RETRIES + 1} attempts failed, the last one with: {error}") from error
        seconds, content, found = result
        if wrong := environment.differences(found, environment.MUST_AGREE):
            raise ClusterError(f"a worker of the cluster can't take part: {wrong}")
        if other := environment.differences(found, environment.MAY_DIFFER):
            warnings.warn(
                f"a worker is of another kind ({other}): its samples are as good, but may differ in their last bits",
                stacklevel=2,
            )
        self.update_speed(item.samples, seconds)
        with alone():
            sums: Accumulators = pickle.loads(content)
            dr.eval(sums)
        return sums

    def _check_workers(self) -> bool:
        """Finds out which workers exist; returns whether the cluster has gone away."""
        now, before = time.perf_counter(), self._workers
        if self.loss_reason or now < self._next_check:
            return bool(self.loss_reason)
        self._next_check = now + CHECK_INTERVAL
        try:
            if self.client.status != "running":
                raise OSError
            self._workers = frozenset(self.client.ncores())
        except (OSError, ValueError, TypeError, AttributeError):  # a lost connection raises any of these
            self.loss_reason = f"the scheduler {self.address} has gone away"
            return True
        if before - self._workers:
            left = len(before & self._workers) or "none"
            warnings.warn(
                f"a worker was lost, {left} left; others do its work, and the image stays the same", stacklevel=2
            )
        if not self._workers and now - self._begun > WARNING_DELAY:
            warnings.warn("the cluster has no workers yet; the render begins when there are some", stacklevel=2)
        return False


def render(
    scene: str | Path,
    *,
    client: distributed.Client | None = None,
    sensor: int = 0,
    seed: int = 0,
    spp: int = 0,
    **changes: Any,
) -> mi.TensorXf:
    """The image of a scene file, of either kind, by the workers of ``client``; shape (height, width, channels).

    ``client``: None for Dask's current one; ``spp``: samples per pixel, 0 for those of the scene; ``changes``: those of
    :class:`.SceneFile`, such as ``resolution=(640, 480)`` or ``integrator={"noise": 0.01}``. The image has the bits of
    one that this process alone renders.

    Raises :class:`ClusterError` if the cluster cannot render it, ValueError if the scene cannot travel.
    """
    with atomic.scratch() as folder:
        file = scene_file.SceneFile(scene, folder, **changes)
        loaded = file.load()
        bundle = SceneBundle.of(file, sensor)
    integrator: Any = loaded.integrator()
    rendering.require_progressive(integrator, f"{scene}: a cluster")
    executor = DaskExecutor(client or distributed.default_client(), bundle)
    chosen = scene_file.pick_sensor(loaded, sensor)
    progress = integrator.progressive(loaded, chosen, seed, spp, executor=executor).run()
    if executor.loss_reason:
        raise ClusterError(executor.loss_reason)
    return progress.image()
