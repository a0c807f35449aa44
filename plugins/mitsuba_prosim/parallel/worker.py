"""The tasks of a Dask worker: samples of a work item, photons, and whole images.

All of them run in one thread of the worker, which uses all threads of Dr.Jit; two renders take turns.
"""

from __future__ import annotations

import asyncio
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
from ..engine import environment
from ..engine.estimator import Estimator
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


class WorkerScene:
    """A scene that is ready to be sampled."""

    def __init__(self, bundle: SceneBundle, contents: Mapping[str, bytes]) -> None:
        self.key = bundle.key
        self.scene, self.sensor = bundle.load(contents)

    @functools.cached_property
    def estimator(self) -> Estimator:
        """The estimator of the scene."""
        integrator: Any = self.scene.integrator()
        return integrator.estimator(self.scene, self.sensor)


#: The last scene of each client.
scenes: OrderedDict[str, WorkerScene] = OrderedDict()


async def check(variant: str, dask_worker: distributed.Worker) -> dict[str, str]:
    """Sets the variant and the number of threads; returns the environment.

    A worker renders with as many threads as Dask gives to it, or with those of its client where it shares the client's
    process. Raises ImportError or RuntimeError where it lacks the variant.
    """

    def prepare() -> dict[str, str]:
        if not dask_worker.address.startswith("inproc:"):
            dr.set_thread_count(dask_worker.state.nthreads)
            warnings.simplefilter("ignore", prosim_scene.SceneWarning)  # the client shows them
        session.set_variant(variant)
        return environment.this_environment()

    return await asyncio.wrap_future(render_thread().submit(prepare))


def load(bundle: SceneBundle, contents: Mapping[str, bytes]) -> WorkerScene:
    """The scene of ``bundle``, in its variant.

    Another scene of the same client is deleted first, so that the new one takes its places in Dr.Jit's tables, and
    kernels are found in the cache.
    """
    if mi.variant() != bundle.environment["variant"]:
        session.set_variant(bundle.environment["variant"])
    scene = scenes.pop(bundle.session, None)
    if scene is None or scene.key != bundle.key:
        scene = None
        while len(scenes) >= SCENES:
            scenes.popitem(last=False)
        gc.collect()  # scenes are in reference cycles
        scene = WorkerScene(bundle, contents)
    scenes[bundle.session] = scene
    return scene


class _Pickler(pickle.Pickler):
    """Pickles Dr.Jit arrays so that they keep the alignment of Dr.Jit's memory, see :func:`..compat.dr_array`."""

    def reducer_override(self, value: Any) -> Any:
        if type(value) in (mi.Float, mi.UInt32, mi.Int32):
            return dr_array, (np.array(value),)
        if type(value) in (mi.Point3f, mi.Vector3f, mi.Spectrum):
            return type(value), tuple(value)
        return NotImplemented


def pickled(value: Any) -> bytes:
    """``value``, which may hold Dr.Jit arrays, for ``pickle.loads``."""
    content = io.BytesIO()
    with alone():
        _Pickler(content).dump(value)
    return content.getvalue()


def packed(item: WorkItem) -> bytes:
    """A work item without the scene and without the function that stores the sums."""
    return pickled((item.plan, item.x, item.y, item.start, item.end))


@in_render_thread
def sample(
    bundle: SceneBundle, contents: Mapping[str, bytes], item: bytes, passes: Sequence[Which], photons: Sequence[bytes]
) -> tuple[float, bytes]:
    """``(seconds, sums)`` of a :func:`packed` work item. ``photons`` are those of some ``passes``, by :func:`emit`."""
    estimator = load(bundle, contents).estimator
    for which, photon_pass in zip(passes, photons):
        if not estimator.transport.caustics.has(which):
            with alone():
                estimator.transport.caustics.add(which, pickle.loads(photon_pass))
    return timed_sums(estimator, item)


def timed_sums(estimator: Estimator, item: bytes) -> tuple[float, bytes]:
    """``(seconds, sums)`` of a :func:`packed` work item; the sums are pickled."""
    with alone():
        work_item = WorkItem(estimator, *pickle.loads(item))
    started = time.perf_counter()
    sums = work_item.compute()
    dr.sync_thread()
    return time.perf_counter() - started, pickled(sums)


@in_render_thread
def emit(bundle: SceneBundle, contents: Mapping[str, bytes], which: Which) -> bytes:
    """The photons of a pass, pickled for all workers."""
    with alone():
        return pickled(load(bundle, contents).estimator.transport.caustics.photons(which))


@in_render_thread
def call(bundle: SceneBundle, contents: Mapping[str, bytes], function: Callable[..., Any], *arguments: Any) -> Any:
    """The result of ``function(scene, sensor, *arguments)``."""
    scene = load(bundle, contents)
    return function(scene.scene, scene.sensor, *arguments)
