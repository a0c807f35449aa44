"""Work items and whole images as tasks of a Dask cluster."""

from __future__ import annotations

import pickle
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
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
from ..engine.work import Executor, Results, WorkItem
from ..photons.caustics import Which
from ..scene import rendering, scene_file
from . import worker
from .bundle import SceneBundle

#: Seconds between two checks of the workers, and without workers until a warning.
CHECK_INTERVAL, WARNING_DELAY = 0.5, 10.0

#: Tasks for each worker: one runs and one waits. Number of times that Dask repeats a task that fails; and that a task
#: is submitted again whose worker was lost.
WINDOW, RETRIES, LOSSES = 2, 2, 20

#: Seconds of a work item; the last ones are smaller, by this factor at most. Photon passes that stay in
#: the cluster.
SECONDS, FEWER, PHOTON_PASSES = 2.0, 8, 4


class ClusterError(RuntimeError):
    """A cluster that cannot render the image."""


@dataclass(eq=False)
class Task:
    """A call of a worker, begun by ``submit``; ``read`` makes the result of its value. Messages use ``name``."""

    name: str
    submit: Callable[[], distributed.Future]
    read: Callable[[Any], Any]
    #: The workers that may run it; and seconds that its value may take to arrive.
    workers: frozenset[str] = frozenset()
    future: Any = None
    value: Any = None
    timeout: float = 1.0
    #: How often it was lost with its worker.
    losses: int = 0


class DaskExecutor(Executor):
    """Takes samples of the scene in ``bundle`` by the workers of ``client``, which may come and go. ``say`` receives
    warnings about them.
    """

    photon_passes = None

    def __init__(
        self, client: distributed.Client, bundle: SceneBundle, say: Callable[[str], None] = lambda _: None
    ) -> None:
        super().__init__(SECONDS)
        self.client, self.bundle, self.say = client, bundle, say
        #: Why the cluster has gone away.
        self.loss_reason: str | None = None
        #: Seconds of all workers together.
        self.worker_seconds = 0.0
        self.address = getattr(client.scheduler, "address", "of the cluster")
        #: The address of each worker, and the reason why it can't take part; empty if it can.
        self._refusals = dict[str, str]()
        self._next_check, self._begun, self._warnings = 0.0, time.perf_counter(), set[str]()
        self._photons = dict[Which, distributed.Future]()
        self._files = dict[bytes, distributed.Future]()

    def change_scene(self, bundle: SceneBundle) -> None:
        """Continues with another scene, between two images."""
        self.bundle = bundle
        self._photons.clear()
        self._files = {content: self._files[content] for content in bundle.contents.values() if content in self._files}

    def limit(self, left: int, seconds: float = np.inf) -> int:
        """Samples of the next work item: some seconds of a worker, less towards the end."""
        size = super().limit(left, seconds)
        return min(size, max(left // (WINDOW * max(len(self._workers), 1)), size // FEWER, 1))

    def __call__(self, items: Iterable[WorkItem]) -> Results:
        """Yields each work item with its sums, and None while there is nothing new. Raises as :meth:`results`."""
        return self.results(map(self._task, items))

    # ---------------------------------------------------------------- tasks

    def _task(self, item: WorkItem) -> Task:
        """The task that takes the samples of ``item``."""
        content, passes = worker.packed(item), [which for which, _ in item.photon_passes() if which is not None]

        def submit() -> distributed.Future:
            photons = [self._photons_of(which) for which in passes] if len(passes) <= PHOTON_PASSES else []
            return self.submit(worker.sample, self.bundle, content, passes, photons)

        def read(value: tuple[float, bytes]) -> tuple[WorkItem, Any]:
            seconds, sums = value
            self.worker_seconds += seconds
            self.learn(item.samples, seconds)
            with alone():
                result = pickle.loads(sums)
                dr.eval(result)
            return item, result

        return Task("samples", submit, read)

    def _photons_of(self, which: Which) -> distributed.Future:
        """The photons of a pass, which one worker draws for all."""
        if which not in self._photons:
            self._photons[which] = self.submit(worker.emit, self.bundle, which)
            while len(self._photons) > PHOTON_PASSES:
                del self._photons[next(iter(self._photons))]
        return self._photons[which]

    def submit(self, function: Callable[..., Any], bundle: SceneBundle, *arguments: Any) -> distributed.Future:
        """A future of ``function(bundle, files, *arguments)``. Workers pass the files on to each other."""
        with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 TiB"}):
            for content in bundle.contents.values():
                self._files[content] = self._files.get(content) or self.client.submit(bytes, content)
            files = {name: self._files[content] for name, content in bundle.contents.items()}
            call = function, replace(bundle, contents={}), files, *arguments
            return self.client.submit(*call, workers=list(self._workers), retries=RETRIES, pure=False)

    def results(self, tasks: Iterator[Task]) -> Generator[Any, None, None]:
        """Yields the result of each task, and None while there is nothing new, so that the caller can stop at once.

        Raises ClusterError if no worker can take part, or if a task fails too often.
        """
        running: list[Task] = []
        try:
            while not self._check_workers():
                self._begin(tasks, running)
                if self._workers and not running:
                    return
                ready = next((task for task in running if task.future.done()), None)
                if ready is not None and self._arrived(ready):
                    running.remove(ready)
                    yield ready.read(ready.value)
                else:
                    time.sleep(0.01)
                    yield None
        finally:
            for task in running:
                task.future.cancel()

    def _begin(self, tasks: Iterator[Task], running: list[Task]) -> None:
        """Submits the next tasks, and those again whose workers were all lost."""
        for task in running:
            if self._workers and task.workers.isdisjoint(self._workers):
                task.future, task.workers = task.submit(), self._workers
        busy = sum(not task.future.done() for task in running)
        while busy < WINDOW * len(self._workers) and (new := next(tasks, None)) is not None:
            new.future, new.workers = new.submit(), self._workers
            running.append(new)
            busy += 1

    def _arrived(self, task: Task) -> bool:
        """Whether the value of a finished task is here; it may be late or lost. Raises ClusterError."""
        try:
            task.value = task.future.result(task.timeout)
            return True
        except distributed.TimeoutError:  # late, or lost with all workers that may repeat the task
            task.timeout *= 2
        except (distributed.CancelledError, OSError) as error:
            task.workers, task.losses = frozenset(), task.losses + 1  # it is submitted again
            if task.losses > LOSSES:
                raise ClusterError(f"{task.name}: lost {LOSSES} times, the last one with: {error}") from error
        except Exception as error:
            raise ClusterError(f"{task.name}: {RETRIES + 1} attempts failed, the last one with: {error}") from error
        return False

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
            new, variant = [*present - self._refusals.keys()], self.bundle.environment["variant"]
            checks = self.client.run(worker.check, variant, workers=new, on_error="return") if new else {}
        except (OSError, ValueError, TypeError, AttributeError):  # a lost connection raises any of these
            self.loss_reason = f"the scheduler {self.address} has gone away"
            return True
        found = {a: self._refusal(a, result) for a, result in checks.items() if not isinstance(result, OSError)}
        self._refusals = {address: why for address, why in (self._refusals | found).items() if address in present}
        if before - present:
            left = len(before & present) or "none"
            self._warn(f"a worker was lost, {left} left; others do its work, and the image stays the same")
            self._photons.clear()  # workers that are lost can't draw them again
        if not self._workers and self._refusals:
            raise ClusterError("no worker of the cluster can take part: " + "; ".join(self._refusals.values()))
        if not self._workers and now - self._begun > WARNING_DELAY:
            self._warn("the cluster has no workers yet; the render begins when there are some")
        return False

    def _refusal(self, address: str, found: Mapping[str, str] | Exception) -> str:
        """The reason why a worker can't take part, by the result of :func:`.worker.check`; empty if it can."""
        if isinstance(found, Exception):
            why = f"it can't run this version of mitsuba-prosim ({str(found) or type(found).__name__})"
        elif not (why := environment.differences(found, environment.MUST_AGREE)):
            if other := environment.differences(found, environment.MAY_DIFFER):
                self._warn(
                    f"the worker {address} is of another kind ({other}): its samples are as good, but may differ in "
                    "their last bits"
                )
            return ""
        self._warn(f"a worker cannot take part, {address}: {why}")
        return f"{address}: {why}"

    def _warn(self, text: str) -> None:
        if text not in self._warnings:
            self._warnings.add(text)
            self.say(text)


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
    if not rendering.is_progressive(integrator):
        raise ValueError(
            f"{scene}: a cluster renders with prosim or prosim_adaptive, in all but scalar variants; this scene's "
            f'integrator is {integrator.class_name()}. Add integrator={{"noise": 0.01}}, for example: prosim_adaptive '
            "then wraps it."
        )
    executor = DaskExecutor(client or distributed.default_client(), bundle, warnings.warn)
    chosen = scene_file.pick_sensor(loaded, sensor)
    progress = integrator.progressive(loaded, chosen, seed, spp, executor=executor).run()
    if executor.loss_reason:
        raise ClusterError(executor.loss_reason)
    return progress.image()
