"""Work items as tasks of a Dask cluster."""

from __future__ import annotations

import pickle
import time
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
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
from .bundle import SESSION, SceneBundle

#: Seconds between two checks of the workers, and without workers until a warning.
CHECK_INTERVAL, WARNING_DELAY = 0.5, 10.0

#: Tasks for each worker: one runs and one waits. Number of times that Dask repeats a task that fails; and that a task
#: is submitted again whose worker was lost.
WINDOW, RETRIES, LOSSES = 2, 2, 20

#: Seconds of a work item; the last ones are smaller, by this factor at most.
SECONDS, FEWER = 2.0, 8


class ClusterError(RuntimeError):
    """A cluster that cannot render the image."""


@dataclass(eq=False)
class Task:
    """A work item in the cluster, and its ``content``, which travels."""

    item: WorkItem
    content: bytes
    future: Any = None
    #: The workers that may run it; and seconds that its sums may take to arrive.
    workers: frozenset[str] = frozenset()
    timeout: float = 1.0
    #: How often it was lost with its worker.
    losses: int = 0


class DaskExecutor(Executor):
    """Takes samples of the scene in ``bundle`` by the workers of ``client``, which may come and go."""

    photon_passes = None

    def __init__(self, client: distributed.Client, bundle: SceneBundle) -> None:
        super().__init__(SECONDS)
        self.client = client
        #: Why the cluster has gone away.
        self.loss_reason: str | None = None
        self.address = getattr(client.scheduler, "address", "of the cluster")
        #: The address of each worker, and the reason why it can't take part; empty if it can.
        self._refusals = dict[str, str]()
        self._next_check, self._begun = 0.0, time.perf_counter()
        self.change_scene(bundle)

    def change_scene(self, bundle: SceneBundle) -> None:
        """Continues with another scene, between two images."""
        self._variant, self._scene = bundle.variant, pickle.dumps(bundle)
        #: The same in the cluster, whose workers pass it on to each other.
        self._shared: distributed.Future | None = None

    def limit(self, left: int, seconds: float = np.inf) -> int:
        """Samples of the next work item: some seconds of a worker, less towards the end."""
        least = max(int(self.speed * min(self.seconds, seconds)) // FEWER, self.SMALLEST)
        return min(super().limit(left, seconds), max(left // (WINDOW * max(len(self._workers), 1)), least))

    def __call__(self, items: Iterator[WorkItem]) -> Results:
        """Yields each work item with its sums, and None while there is nothing new, so that the caller can stop at
        once.

        Raises ClusterError if no worker can take part, or if a task fails too often.
        """
        running: list[Task] = []
        try:
            while not self._check_workers():
                self._begin(items, running)
                if self._workers and not running:
                    return
                ready = next((task for task in running if task.future.done()), None)
                sums = None if ready is None else self._sums(ready)
                if ready is None or sums is None:
                    time.sleep(0.01)
                    yield None
                else:
                    running.remove(ready)
                    yield ready.item, sums
        finally:
            for task in running:
                task.future.cancel()

    # ---------------------------------------------------------------- tasks

    def _begin(self, items: Iterator[WorkItem], running: list[Task]) -> None:
        """Submits the next work items, and those again whose workers were all lost."""
        busy = sum(not task.future.done() for task in running)
        while busy < WINDOW * len(self._workers) and (item := next(items, None)) is not None:
            running.append(Task(item, worker.packed(item)))
            busy += 1
        for task in running:
            if self._workers and task.workers.isdisjoint(self._workers):
                task.workers = self._workers
                with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 TiB"}):
                    self._shared = self._shared or self.client.submit(bytes, self._scene)
                    call = worker.sample, SESSION, self._shared, task.content
                    task.future = self.client.submit(*call, workers=list(self._workers), retries=RETRIES, pure=False)

    def _sums(self, task: Task) -> Accumulators | None:
        """The sums of a finished task; None if they are late or lost. Raises ClusterError."""
        try:
            seconds, content = task.future.result(task.timeout)
        except distributed.TimeoutError:  # late, or lost with all workers that may repeat the task
            task.timeout *= 2
            return None
        except (distributed.CancelledError, OSError) as error:
            task.workers, task.losses = frozenset(), task.losses + 1  # it is submitted again
            if task.losses > LOSSES:
                raise ClusterError(f"samples: lost {LOSSES} times, the last one with: {error}") from error
            return None
        except Exception as error:
            raise ClusterError(f"samples: {RETRIES + 1} attempts failed, the last one with: {error}") from error
        self.update_speed(task.item.samples, seconds)
        with alone():
            sums: Accumulators = pickle.loads(content)
            dr.eval(sums)
        return sums

    # ---------------------------------------------------------------- workers

    @property
    def _workers(self) -> frozenset[str]:
        """The workers that take part."""
        return frozenset(address for address, refusal in self._refusals.items() if not refusal)

    def _check_workers(self) -> bool:
        """Finds out which workers exist, and checks new ones; returns whether the cluster has gone away. Raises
        ClusterError if all workers are refused.
        """
        now, before = time.perf_counter(), self._workers
        if self.loss_reason or now < self._next_check:
            return bool(self.loss_reason)
        self._next_check = now + CHECK_INTERVAL
        try:
            if self.client.status != "running":
                raise OSError
            present = self.client.ncores().keys()
            new = [*present - self._refusals.keys()]
            checks = self.client.run(worker.check, self._variant, workers=new, on_error="return") if new else {}
        except (OSError, ValueError, TypeError, AttributeError):  # a lost connection raises any of these
            self.loss_reason = f"the scheduler {self.address} has gone away"
            return True
        found = {a: self._refusal(a, result) for a, result in checks.items() if not isinstance(result, OSError)}
        self._refusals = {address: why for address, why in (self._refusals | found).items() if address in present}
        if before - present:
            left = len(before & present) or "none"
            warnings.warn(
                f"a worker was lost, {left} left; others do its work, and the image stays the same", stacklevel=2
            )
        if not self._workers and self._refusals:
            raise ClusterError("no worker of the cluster can take part: " + "; ".join(self._refusals.values()))
        if not self._workers and now - self._begun > WARNING_DELAY:
            warnings.warn("the cluster has no workers yet; the render begins when there are some", stacklevel=2)
        return False

    def _refusal(self, address: str, found: Mapping[str, str] | Exception) -> str:
        """The reason why a worker can't take part, by the result of :func:`.worker.check`; empty if it can."""
        if isinstance(found, Exception):
            why = f"it can't run this version of mitsuba-prosim ({str(found) or type(found).__name__})"
        elif not (why := environment.differences(found, environment.MUST_AGREE)):
            if other := environment.differences(found, environment.MAY_DIFFER):
                warnings.warn(
                    f"the worker {address} is of another kind ({other}): its samples are as good, but may differ in "
                    "their last bits",
                    stacklevel=2,
                )
            return ""
        warnings.warn(f"a worker cannot take part, {address}: {why}", stacklevel=2)
        return f"{address}: {why}"


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
