"""The task of a Dask worker: the samples of a work item.

It runs in one thread of the worker, which uses all threads of Dr.Jit; two renders take turns.
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
from ..scene import session
from .bundle import SceneBundle

#: Clients of which a worker keeps the last scene.
SCENES = 4


@functools.cache
def render_thread() -> ThreadPoolExecutor:
    """The thread that runs all tasks."""
    return ThreadPoolExecutor(1, "prosim")


class WorkerScene:
    """The scene of a pickled :class:`.SceneBundle`, ready to be sampled in its variant."""

    def __init__(self, content: bytes) -> None:
        bundle: SceneBundle = pickle.loads(content)
        self.content, self.variant = content, session.set_variant(bundle.variant)
        scene, sensor = bundle.load()
        integrator: Any = scene.integrator()
        self.estimator: Estimator = integrator.estimator(scene, sensor)


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


def load(client: str, content: bytes) -> WorkerScene:
    """The scene of a ``client``, in its variant.

    Another scene of the same client is deleted first, so that the new one takes its places in Dr.Jit's tables, and
    kernels are found in the cache.
    """
    scene = scenes.pop(client, None)
    if scene is None or scene.content != content:
        scene = None
        while len(scenes) >= SCENES:
            scenes.popitem(last=False)
        gc.collect()  # scenes are in reference cycles
        scene = WorkerScene(content)
    elif mi.variant() != scene.variant:
        session.set_variant(scene.variant)
    scenes[client] = scene
    return scene


class _Pickler(pickle.Pickler):
    """Pickles Dr.Jit arrays so that they keep the alignment of Dr.Jit's memory, see :func:`..compat.dr_array`."""

    def reducer_override(self, value: Any) -> Any:
        if type(value) in (mi.Float, mi.UInt32, mi.Int32):
            return dr_array, (np.array(value),)
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


def sample(client: str, scene: bytes, item: bytes) -> tuple[float, bytes]:
    """``(seconds, sums)`` of a :func:`packed` work item by a pickled :class:`.SceneBundle`."""
    return render_thread().submit(lambda: timed_sums(load(client, scene).estimator, item)).result()


def timed_sums(estimator: Estimator, item: bytes) -> tuple[float, bytes]:
    """``(seconds, sums)`` of a :func:`packed` work item; the sums are pickled."""
    with alone():
        work_item = WorkItem(estimator, *pickle.loads(item))
    started = time.perf_counter()
    sums = work_item.compute()
    dr.sync_thread()
    return time.perf_counter() - started, pickled(sums)
