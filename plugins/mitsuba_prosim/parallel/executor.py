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
from ..engine import origin
from ..engine.work import Executor, Results, WorkItem
from ..photons.caustics import Which
from ..scene import rendering, scene_file
from . import worker
from .bundle import SceneBundle

#: Seconds between two looks at the workers, and without workers until a warning.
LOOK, PATIENCE = 0.5, 10.0

#: Tasks for each worker: one runs and one waits.
WINDOW = 2

#: Number of times that Dask repeats a task that fails.
RETRIES = 2

#: Seconds of a work item; the last ones are smaller, by this factor at most. Photon sets that stay in the cluster.
SECONDS, FEWER, SETS = 2.0, 8, 4


class ClusterError(RuntimeError):
    """A cluster that cannot render the image."""


@dataclass(frozen=True, eq=False)
class ImageTask:
    """A whole image by one worker: ``make(scene, sensor, *arguments)``. Messages use ``name``."""

    name: str
    bundle: SceneBundle
    make: Callable[..., Any]
    arguments: tuple[Any, ...]


class _Task:
    """A task, and the function that reads its result. It may run on the ``workers`` that exist when it is submitted."""

    def __init__(self, name: str, submit: Callable[[], distributed.Future], read: Callable[[Any], Any]) -> None:
        self.name, self.submit, self.read = name, submit, read
        self.workers: frozenset[str] = frozenset()
        self.future: Any = None


class DaskExecutor(Executor):
    """Takes samples of the scene in ``bundle`` by the workers of ``client``: an :class:`.Executor`.

    Workers may come and go. ``say`` receives warnings about them. Use it as a context manager.
    """

    sets = None

    def __init__(
        self, client: distributed.Client, bundle: SceneBundle, say: Callable[[str], None] = lambda _: None
    ) -> None:
        self.client, self.bundle, self.say = client, bundle, say
        super().__init__(SECONDS)
        #: Why the cluster has gone away.
        self.gone: str | None = None
        #: Seconds of all workers together.
        self.worker_seconds = 0.0
        self.address = getattr(client.scheduler, "address", "of the cluster")
        self._workers: frozenset[str] = frozenset()
        self._refused: dict[str, str] = {}
        self._next_look, self._begun, self._said = 0.0, time.perf_counter(), set[str]()
        self._photons: dict[Which, tuple[distributed.Future, frozenset[str]]] = {}
        self._files: dict[bytes, distributed.Future] = {}

    def turn_to(self, bundle: SceneBundle) -> None:
        """Continues with another scene, between two images."""
        self.bundle = bundle
        self._photons.clear()
        self._files = {content: self._files[content] for content in bundle.contents.values() if content in self._files}

    def __enter__(self) -> DaskExecutor:
        return self

    def __exit__(self, *_: object) -> None:
        self._photons.clear()
        self._files.clear()

    # ---------------------------------------------------------------- the interface of an executor

    def limit(self, left: int, seconds: float = np.inf) -> int:
        """Samples of the next work item: some seconds of a worker, less towards the end."""
        size = super().limit(left, seconds)
        return min(size, max(left // (WINDOW * max(len(self._workers), 1)), size // FEWER, 1))

    def __call__(self, items: Iterator[WorkItem]) -> Results:
        """Yields each work item with its sums, and None while there is nothing new.

        Raises ClusterError if no worker can take part, or if a work item fails too often.
        """
        return self._results(map(self._samples, items))

    def make(self, images: Iterable[ImageTask]) -> Generator[tuple[ImageTask, Any] | None, None, None]:
        """Yields each image with its result, and None while there is nothing new. Raises ClusterError."""

        def task(image: ImageTask) -> _Task:
            arguments = worker.make, image.bundle, image.make, image.arguments
            return _Task(image.name, lambda: self._submit(*arguments), lambda result: (image, result))

        return self._results(map(task, images))

    # ---------------------------------------------------------------- tasks

    def _samples(self, item: WorkItem) -> _Task:
        """The task that takes the samples of ``item``."""
        content, sets = worker.packed(item), [which for which, _ in item.photon_sets() if which is not None]

        def submit() -> distributed.Future:
            photons = [self._draw(which) for which in sets] if len(sets) <= SETS else []
            return self._submit(worker.take, self.bundle, content, sets, photons)

        def read(result: tuple[float, bytes]) -> tuple[WorkItem, Any]:
            seconds, sums = result
            self.worker_seconds += seconds
            self.learn(item.work, seconds)
            with alone():
                values = pickle.loads(sums)
                dr.eval(values)
            return item, values

        return _Task("samples", submit, read)

    def _draw(self, which: Which) -> distributed.Future:
        """The photons of a set, which one worker draws for all."""
        future, workers = self._photons.get(which, (None, frozenset()))
        if future is None or workers.isdisjoint(self._workers):
            future = self._submit(worker.draw, self.bundle, which)
            self._photons[which] = future, self._workers
            while len(self._photons) > SETS:
                del self._photons[next(iter(self._photons))]
        return future

    def _submit(self, function: Callable[..., Any], bundle: SceneBundle, *arguments: Any) -> distributed.Future:
        """A future of ``function(bundle, files, *arguments)``. Workers pass the files on to each other."""
        with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 TiB"}):
            for content in bundle.contents.values():
                self._files[content] = self._files.get(content) or self.client.submit(bytes, content)
            files = {name: self._files[content] for name, content in bundle.contents.items()}
            call = function, replace(bundle, contents={}), files, *arguments
            return self.client.submit(*call, workers=list(self._workers), retries=RETRIES, pure=False)

    def _results(self, tasks: Iterator[_Task]) -> Generator[Any, None, None]:
        """Yields the result of each task, and None while there is nothing new."""
        running: list[_Task] = []

        def submit(task: _Task) -> None:
            task.future, task.workers = task.submit(), self._workers

        try:
            while True:
                self._look()
                if self.gone:
                    return
                if not self._workers:
                    time.sleep(0.1)
                    yield None
                    continue
                for task in running:
                    if task.workers.isdisjoint(self._workers):  # all of them were lost
                        submit(task)
                window = WINDOW * len(self._workers)
                busy = sum(not task.future.done() for task in running)
                while busy < window and (new := next(tasks, None)) is not None:
                    submit(new)
                    running.append(new)
                    busy += 1
                if not running:
                    return
                ready = next((task for task in running if task.future.done()), None)
                if ready is None:
                    time.sleep(0.01)
                    yield None
                elif (result := self._result(ready)) is None:
                    submit(ready)
                else:
                    running.remove(ready)
                    yield result
        finally:
            for task in running:
                task.future.cancel()

    def _result(self, task: _Task) -> Any:
        """The result of a finished task; None where it was lost. Raises ClusterError."""
        try:
            return task.read(task.future.result())
        except (distributed.CancelledError, OSError):
            return None
        except distributed.KilledWorker:
            why = "too many workers died at this task; do they have enough memory?"
            raise ClusterError(f"{task.name}: {why}") from None
        except Exception as error:
            raise ClusterError(f"{task.name}: {RETRIES + 1} attempts failed, the last one with: {error}") from error

    # ---------------------------------------------------------------- workers

    def _look(self) -> None:
        """Finds out which workers exist, and checks new ones. Raises ClusterError if all are refused."""
        now = time.perf_counter()
        if now < self._next_look:
            return
        self._next_look = now + LOOK
        try:
            if self.client.status != "running":
                raise OSError
            present = frozenset(self.client.ncores())
            new = present - self._workers - self._refused.keys()
            variant = self.bundle.origin["variant"]
            checks = self.client.run(worker.check, variant, workers=list(new), on_error="return") if new else {}
        except (OSError, ValueError, TypeError, AttributeError):  # a lost connection raises any of these
            self.gone = f"the scheduler {self.address} has gone away"
            return
        if self._workers - present:
            left = len(self._workers & present) or "none"
            self._warn(f"a worker was lost, {left} left; others do its work, and the image stays the same")
        self._workers &= present
        self._refused = {address: why for address, why in self._refused.items() if address in present}
        for address, found in checks.items():
            self._checked(address, found)
        if not self._workers and self._refused:
            raise ClusterError("no worker of the cluster can take part: " + "; ".join(self._refused.values()))
        if not self._workers and now - self._begun > PATIENCE:
            self._warn("the cluster has no workers yet; the render begins when there are some")

    def _checked(self, address: str, found: Mapping[str, str] | Exception) -> None:
        """Takes the result of :func:`.worker.check` into account."""
        if isinstance(found, OSError):
            return  # the worker has gone
        if isinstance(found, (ImportError, AttributeError)):
            why = f"it has no mitsuba-prosim of this version, or lacks a package ({found})"
        elif isinstance(found, Exception):
            why = str(found) or type(found).__name__
        elif not (why := origin.differences(found, self.bundle.origin, origin.EXACT)):
            if other := origin.differences(found, self.bundle.origin, origin.CLOSE):
                self._warn(
                    f"the worker {address} is of another kind ({other}): its samples are as good, but may differ in "
                    "their last bits"
                )
            self._workers |= {address}
            return
        self._refused[address] = f"{address}: {why}"
        self._warn(f"a worker cannot take part, {self._refused[address]}")

    def _warn(self, text: str) -> None:
        if text not in self._said:
            self._said.add(text)
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
    chosen = scene_file.pick_sensor(loaded, sensor)
    integrator: Any = loaded.integrator()
    if not rendering.keeps(integrator):
        raise ValueError(
            f"{scene}: a cluster renders with prosim or prosim_adaptive, in all but scalar variants; this scene's "
            f'integrator is {integrator.class_name()}. Add integrator={{"noise": 0.01}}, for example: prosim_adaptive '
            "then wraps it."
        )
    with DaskExecutor(client or distributed.default_client(), bundle, warnings.warn) as executor:
        progress = integrator.progressive(loaded, chosen, seed, spp, executor=executor).run()
        if executor.gone:
            raise ClusterError(executor.gone)
        return progress.image()
