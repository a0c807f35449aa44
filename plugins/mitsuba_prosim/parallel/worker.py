"""The tasks of a Dask worker: samples of a work item, photons, and whole images.

All of them run in one thread of the worker, whatever the number of its own: a task has all the threads of Dr.Jit, and
two renders take turns.
"""

from __future__ import annotations

import functools
import gc
import io
import pickle
import time
import warnings
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import distributed
import drjit as dr
import mitsuba as mi
import numpy as np
import prosim_scene

from ..alone import alone
from ..compat import dr_array
from ..engine import origin
from ..engine.estimator import Estimator
from ..engine.policies import POLICIES
from ..engine.work import WorkItem
from ..photons.caustics import Which
from ..scene import session
from .bundle import SceneBundle

#: Clients of which a worker keeps the last scene.
SCENES = 4


@functools.cache
def render_thread() -> ThreadPoolExecutor:
    """The thread that runs all tasks."""
    return ThreadPoolExecutor(1, "prosim")


def in_render_thread(function: Callable[..., Any]) -> Callable[..., Any]:
    """``function``, run in the :func:`render_thread`."""

    @functools.wraps(function)
    def wrapped(*arguments: Any) -> Any:
        return render_thread().submit(function, *arguments).result()

    return wrapped


class Loaded:
    """A scene that is ready to be sampled."""

    def __init__(self, bundle: SceneBundle, contents: Mapping[str, bytes]) -> None:
        self.key = bundle.key
        self.scene, self.sensor = bundle.load(contents)
        self.integrator: Any = self.scene.integrator()
        self.sensor.film().prepare(self.integrator.aov_names())
        self._estimator: Estimator | None = None

    @property
    def draws(self) -> int:
        """Photon sets that were drawn here."""
        caustics = None if self._estimator is None else self._estimator.transport.caustics
        return 0 if caustics is None else caustics.draws

    def estimator(self) -> Estimator:
        """The estimator of the scene."""
        if self._estimator is None:
            self._estimator = self.integrator.estimator(self.scene, self.sensor)
        return self._estimator


#: The last scene of each client.
scenes: OrderedDict[str, Loaded] = OrderedDict()


def loaded(bundle: SceneBundle, contents: Mapping[str, bytes]) -> Loaded:
    """The scene of ``bundle``, in its variant.

    Another scene of the same client is forgotten first, so that the new one takes its places in Dr.Jit's tables, by
    which kernels are found again.
    """
    if mi.variant() != bundle.variant:
        session.set_variant(bundle.variant)
    scene = scenes.pop(bundle.session, None)
    if scene is None or scene.key != bundle.key:
        scene = None
        while len(scenes) >= SCENES:
            scenes.popitem(last=False)
        gc.collect()  # scenes are in reference cycles
        scene = Loaded(bundle, contents)
    scenes[bundle.session] = scene
    return scene


def check(variant: str) -> Mapping[str, str]:
    """Prepares the worker for ``variant`` and returns what its samples depend on.

    It renders with as many threads as Dask gives to it, or with those of its client if it shares the client's process.
    Raises ImportError or RuntimeError where it lacks the variant.
    """
    here = distributed.get_worker()

    def prepared() -> Mapping[str, str]:
        if not here.address.startswith("inproc:"):
            dr.set_thread_count(here.state.nthreads)
            warnings.simplefilter("ignore", prosim_scene.SceneWarning)  # the client shows them
        session.set_variant(variant)
        return origin.here()

    return render_thread().submit(prepared).result()


class _Pickler(pickle.Pickler):
    """Dr.Jit arrays are read to the alignment of Dr.Jit's own memory, by which kernels are found again."""

    def reducer_override(self, value: Any) -> Any:
        if type(value) in (mi.Float, mi.UInt32, mi.Int32):
            return dr_array, (np.array(value),)
        if type(value) in (mi.Vector3f, mi.Spectrum):
            return type(value), tuple(value)
        return NotImplemented


def pickled(value: Any) -> bytes:
    """``value``, which may hold Dr.Jit arrays, for ``pickle.loads``."""
    content = io.BytesIO()
    with alone():
        _Pickler(content).dump(value)
    return content.getvalue()


def packed(item: WorkItem) -> bytes:
    """``item`` as it travels: all but the scene, and what stores the sums."""
    return pickled((item.plan, item.x, item.y, item.start, item.end, item.policy is not None))


@in_render_thread
def take(
    bundle: SceneBundle, contents: Mapping[str, bytes], item: bytes, sets: Sequence[Which], photons: Sequence[bytes]
) -> tuple[float, bytes]:
    """``(seconds, sums)`` of a :func:`packed` work item. ``photons`` are those of some ``sets``, by :func:`draw`."""
    scene = loaded(bundle, contents)

    def estimator() -> Estimator:
        found = scene.estimator()
        for which, photon_pass in zip(sets, photons):
            if not found.transport.caustics.has(which):
                found.transport.caustics.put(which, pickle.loads(photon_pass))
        return found

    return taken(estimator, item)


def taken(estimator: Callable[[], Estimator], item: bytes) -> tuple[float, bytes]:
    """``(seconds, sums)`` of a :func:`packed` work item; the sums are pickled."""
    with alone():
        plan, x, y, start, end, decides = pickle.loads(item)
        policy = POLICIES[plan.sampling.adaptive](plan, plan.sampling.threshold) if decides else None
        whole = WorkItem(estimator(), plan, x, y, start, end, policy)
    begun = time.perf_counter()
    sums = whole.take()
    dr.sync_thread()
    return time.perf_counter() - begun, pickled(sums)


@in_render_thread
def draw(bundle: SceneBundle, contents: Mapping[str, bytes], which: Which) -> bytes:
    """The photons of a set, pickled for all workers."""
    scene = loaded(bundle, contents)
    with alone():
        return pickled(scene.estimator().transport.caustics.photons(which))


def make(bundle: SceneBundle, contents: Mapping[str, bytes], function: Callable[..., Any], arguments: Sequence) -> Any:
    """The result of ``function(scene, sensor, wanted, *arguments)``; ``wanted()`` says whether the client still wants
    it.
    """
    here = distributed.get_worker()
    key, tasks = here.get_current_task(), here.state.tasks

    def wanted() -> bool:
        task = tasks.get(key)
        return task is not None and task.state == "executing"

    def made() -> Any:
        if not wanted():
            return None
        scene = loaded(bundle, contents)
        return function(scene.scene, scene.sensor, wanted, *arguments)

    return render_thread().submit(made).result()
