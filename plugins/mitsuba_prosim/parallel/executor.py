"""Work items as tasks of a Dask cluster."""

from __future__ import annotations

import hashlib
import pickle
import time
import warnings
from collections import OrderedDict
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import dask
import distributed
import drjit as dr
import mitsuba as mi

from .. import atomic
from ..alone import alone
from ..engine import origin
from ..engine.work import Results, TimeSlicer, WorkItem
from ..photons.caustics import Which
from ..scene import rendering, scene_file
from . import worker
from .bundle import SceneBundle

#: Seconds between two looks at the workers, and without workers until the user is told.
LOOK, PATIENCE = 0.5, 10.0

#: Tasks for each worker: one that it runs and one that waits; and how many may wait for earlier ones, where their order
#: matters, in windows.
WINDOW, AHEAD = 2, 2

#: Times that Dask repeats a task that fails; and times that a task is handed out again after its workers died, which
#: Dask itself tries some times.
RETRIES, LOSSES = 2, 3

#: Seconds of a work item; the last ones are smaller, by this factor at most. Photon sets that stay in the cluster.
SECONDS, FEWER, SETS = 2.0, 8, 4


class ClusterError(RuntimeError):
    """A cluster that cannot render the image."""


@dataclass(frozen=True, eq=False)
class ImageTask:
    """A whole image by one worker: ``make(scene, sensor, wanted, *arguments)``, see :func:`.worker.make`. Messages use
    ``name``.
    """

    name: str
    bundle: SceneBundle
    make: Callable[..., Any]
    arguments: tuple[Any, ...]


@dataclass(eq=False)
class _Task:
    """A function of :mod:`.worker` with its arguments, and what reads its result."""

    function: Callable[..., Any]
    bundle: SceneBundle
    arguments: tuple[Any, ...]
    read: Callable[[Any], Any]
    name: str
    number: int = 0
    lost: int = 0
    workers: frozenset[str] = field(default_factory=frozenset)


class DaskExecutor:
    """Takes samples of the scene in ``bundle`` by the workers of ``client``: an :class:`.Executor`.

    Workers may come and go. ``say`` receives warnings about them. Use it as a context manager.
    """

    sets = None

    def __init__(
        self, client: distributed.Client, bundle: SceneBundle, say: Callable[[str], None] = lambda _: None
    ) -> None:
        self.client, self.bundle, self.say = client, bundle, say
        self.slicer = TimeSlicer(SECONDS)
        #: Why the cluster has gone away.
        self.gone: str | None = None
        #: Seconds of all workers together.
        self.seconds = 0.0
        self.address = getattr(client.scheduler, "address", "of the cluster")
        self._workers: frozenset[str] = frozenset()
        self._refused: dict[str, str] = {}
        self._checks: dict[str, distributed.Future] = {}
        self._next_look, self._since, self._said = 0.0, time.perf_counter(), set[str]()
        self._photons: OrderedDict[Which, distributed.Future] = OrderedDict()
        self._files: dict[str, distributed.Future] = {}

    def turn_to(self, bundle: SceneBundle) -> None:
        """Continues with another scene, between two images."""
        self.bundle = bundle
        self._photons.clear()
        self._contents(bundle, forget=True)

    def close(self) -> None:
        """Releases all futures; workers keep the scene for the next time."""
        for future in self._checks.values():
            future.cancel()
        self._checks.clear()
        self._photons.clear()
        self._files.clear()

    def __enter__(self) -> DaskExecutor:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # ---------------------------------------------------------------- the interface of an executor

    def limit(self, left: int, seconds: float) -> int:
        """Samples of the next work item: some seconds of a worker, less towards the end."""
        size = self.slicer.limit(left, seconds)
        return min(size, max(left // (WINDOW * max(len(self._workers), 1)), size // FEWER, 1))

    def __call__(self, items: Iterator[WorkItem]) -> Results:
        """Yields each work item with its sums, and None while there is nothing new.

        Raises ClusterError if no worker can take part, or if a work item fails again and again.
        """
        return _values(self._results(map(self._task, items)))

    def make(self, images: Iterable[ImageTask]) -> Generator[tuple[ImageTask, Any] | None, None, None]:
        """Yields each image with its result as soon as it is there, and None while there is nothing new.

        Raises ClusterError as for work items.
        """

        def task(image: ImageTask) -> _Task:
            return _Task(
                worker.make, image.bundle, (image.make, image.arguments), lambda what: (image, what), image.name
            )

        return _values(self._results(map(task, images)))

    # ---------------------------------------------------------------- tasks

    def _task(self, item: WorkItem) -> _Task:
        sets = item.photon_sets()
        photons = [self._drawn(which) for which in sets] if len(sets) <= SETS else []

        def read(result: tuple[float, bytes]) -> tuple[WorkItem, Any]:
            seconds, content = result
            self.seconds += seconds
            self.slicer.learn(item.work, seconds)
            with alone():
                sums = pickle.loads(content)
                dr.eval(sums)
            return item, sums

        return _Task(worker.take, self.bundle, (worker.packed(item), sets, photons), read, "samples")

    def _drawn(self, which: Which) -> distributed.Future:
        """The photons of a set, which one worker draws for all."""
        if which not in self._photons:
            self._photons[which] = self._submit(_Task(worker.draw, self.bundle, (which,), tuple, "photons"))
            while len(self._photons) > SETS:
                self._photons.popitem(last=False)
        self._photons.move_to_end(which)
        return self._photons[which]

    def _contents(self, bundle: SceneBundle, forget: bool = False) -> dict[str, distributed.Future]:
        """The files of ``bundle``, which workers pass on to each other."""
        found, known = {}, self._files
        for name, content in bundle.contents.items():
            key = f"prosim-{hashlib.sha256(content).hexdigest()}"
            known[key] = found[name] = known.get(key) or self.client.submit(bytes, content, key=key)
        if forget:
            self._files = {key: future for key, future in known.items() if future in found.values()}
        return found

    def _submit(self, task: _Task) -> distributed.Future:
        task.workers = self._workers
        bundle = replace(task.bundle, contents={})
        with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 TiB"}):
            return self.client.submit(
                task.function,
                bundle,
                self._contents(task.bundle),
                *task.arguments,
                workers=list(self._workers),
                retries=RETRIES,
                pure=False,
            )

    def _results(self, tasks: Iterator[_Task]) -> Generator[tuple[int, Any] | None, None, None]:
        """Yields the number of each task with its result, and None while there is nothing new."""
        running: dict[distributed.Future, _Task] = {}
        finished, asked, exhausted = distributed.as_completed(loop=self.client.loop), 0, False

        def hand_out(task: _Task) -> None:
            future = self._submit(task)
            running[future] = task
            finished.add(future)

        try:
            while True:
                self._look()
                if self.gone or (exhausted and not running):
                    return
                for future in self._stranded(running):
                    future.cancel()
                    hand_out(running.pop(future))
                window, oldest = WINDOW * len(self._workers), min((t.number for t in running.values()), default=asked)
                while not exhausted and len(running) < window and asked - oldest < AHEAD * window:
                    if (task := next(tasks, None)) is None:
                        exhausted = True
                    else:
                        task.number, asked = asked, asked + 1
                        hand_out(task)
                for future in finished.next_batch(block=False) if finished.has_ready() else []:
                    if (task := running.pop(future, None)) is not None:
                        if outcome := self._outcome(future, task):
                            yield task.number, outcome[0]
                        else:
                            hand_out(task)
                if not finished.has_ready():
                    time.sleep(0.01)
                    yield None
        finally:
            for future in running:
                future.cancel()

    def _stranded(self, running: dict[distributed.Future, _Task]) -> list[distributed.Future]:
        """Those of which none of the workers that may run them is left, if there are others."""
        return [f for f, task in running.items() if not task.workers & self._workers] if self._workers else []

    def _outcome(self, future: distributed.Future, task: _Task) -> list[Any]:
        """What was made of a task, or nothing if it has to be handed out again. Raises ClusterError."""
        try:
            return [task.read(future.result())]
        except distributed.KilledWorker:
            task.lost += 1
            if task.lost >= LOSSES:
                raise ClusterError(
                    f"{task.name}: too many workers died at this task; do they have enough memory?"
                ) from None
        except (distributed.CancelledError, OSError):
            pass
        except Exception as error:
            raise ClusterError(f"{task.name}: {RETRIES + 1} attempts failed, the last one with: {error}") from error
        return []

    # ---------------------------------------------------------------- workers

    def _look(self) -> None:
        """Finds out which workers exist, and checks new ones. Raises ClusterError if all are refused."""
        now = time.perf_counter()
        if now >= self._next_look:
            self._next_look = now + LOOK
            try:
                present = frozenset(self.client.ncores()) if self.client.status == "running" else None
            except (OSError, ValueError, TypeError, AttributeError):  # what a lost connection raises
                present = None
            if present is None:
                self.gone = f"the scheduler {self.address} has gone away"
                return
            if (self._workers | set(self._checks)) - present:
                left = len(self._workers & present) or "none"
                self._warn(f"a worker was lost, {left} left; others do its work, and the image stays the same")
            self._workers &= present
            self._refused = {address: why for address, why in self._refused.items() if address in present}
            for address in set(self._checks) - present:
                self._checks.pop(address).cancel()
            for address in present - self._workers - set(self._refused) - set(self._checks):
                self._checks[address] = self.client.submit(
                    worker.check, self.bundle.variant, workers=[address], pure=False
                )
        for address, future in list(self._checks.items()):
            if future.done():
                del self._checks[address]
                self._checked(address, future)
        if not self._workers and not self._checks:
            if self._refused:
                raise ClusterError("no worker of the cluster can take part: " + "; ".join(self._refused.values()))
            if now - self._since > PATIENCE:
                self._warn("the cluster has no workers yet; the render begins when there are some")

    def _checked(self, address: str, future: distributed.Future) -> None:
        try:
            theirs = future.result()
        except (distributed.KilledWorker, distributed.CancelledError, OSError):
            return  # it has gone
        except (ImportError, AttributeError) as error:
            why = f"it has no mitsuba-prosim of this version, or lacks something that it needs ({error})"
        except Exception as error:  # noqa: BLE001  (whatever it is, the others continue)
            why = str(error) or type(error).__name__
        else:
            ours = origin.here()
            if not (why := origin.differences(theirs, ours, origin.EXACT)):
                if other := origin.differences(theirs, ours, origin.CLOSE):
                    self._warn(
                        f"the worker {address} is of another kind ({other}): its samples are as good, but may differ "
                        "in their last bits"
                    )
                self._workers |= {address}
                return
            why = f"it would not make the same samples ({why})"
        self._refused[address] = f"{address}: {why}"
        self._warn(f"a worker cannot take part, {self._refused[address]}")

    def _warn(self, text: str) -> None:
        if text not in self._said:
            self._said.add(text)
            self.say(text)


def _values(results: Iterator[tuple[int, Any] | None]) -> Generator[Any, None, None]:
    """The results, without their numbers."""
    for result in results:
        yield None if result is None else result[1]


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
