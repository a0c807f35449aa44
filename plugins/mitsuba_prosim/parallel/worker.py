"""The task of a Dask worker: the samples of a work item.

It runs in one thread of the worker, which uses all threads of Dr.Jit; two renders take turns.
"""

from __future__ import annotations

import functools
import gc
import io
import pickle
import time
import warnings
from collections.abc import Mapping
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

#: Clients of which a worker keeps the last scene.
SCENES = 4


@functools.cache
def render_thread() -> ThreadPoolExecutor:
    """The thread that runs all tasks."""
    return ThreadPoolExecutor(1, "prosim")


#: The last scene of each client, pickled, and ready to be sampled.
scenes = dict[str, tuple[bytes, Estimator]]()


def load(client: str, content: bytes) -> Estimator:
    """The estimator of a pickled :class:`.SceneBundle` of a ``client``.

    Another scene of the same client is deleted first, so that the new one takes its places in Dr.Jit's tables, and
    kernels are found in the cache.
    """
    known, estimator = scenes.pop(client, (b"", None))
    if estimator is None or known != content:
        estimator = None
        while len(scenes) >= SCENES:
            del scenes[next(iter(scenes))]
        gc.collect()  # scenes are in reference cycles
        scene, sensor = pickle.loads(content).load()
        integrator: Any = scene.integrator()
        estimator = integrator.estimator(scene, sensor)
    scenes[client] = content, estimator
    return estimator


def pickled(value: Any) -> bytes:
    """``value`` for ``pickle.loads``. Dr.Jit arrays keep the alignment of Dr.Jit's memory, see
    :func:`..compat.dr_array`.
    """
    content = io.BytesIO()
    pickler = pickle.Pickler(content)
    kinds = mi.Float, mi.UInt32, mi.Int32
    pickler.dispatch_table = dict.fromkeys(kinds, lambda array: (dr_array, (np.array(array),)))
    with alone():
        pickler.dump(value)
    return content.getvalue()


def packed(item: WorkItem) -> bytes:
    """A work item without the scene and without the function that stores the sums."""
    return pickled((item.plan, item.x, item.y, item.start, item.end))


def sample(
    client: str, expected: Mapping[str, str], scene: bytes, item: bytes
) -> tuple[float, bytes, Mapping[str, str]]:
    """``(seconds, sums, environment)``: the time and the sums of ``item``, a :func:`packed` work item, rendered with
    ``scene``, a pickled :class:`.SceneBundle`; and the environment of this worker. No sums if that must agree with the
    ``expected`` one and does not.

    A worker renders with as many threads as Dask gives to it, or with those of its client where it shares the client's
    process. Raises ImportError or RuntimeError where it lacks the variant.
    """
    dask_worker = distributed.get_worker()

    def compute() -> tuple[float, bytes, Mapping[str, str]]:
        if not dask_worker.address.startswith("inproc:"):
            dr.set_thread_count(dask_worker.state.nthreads)
            warnings.simplefilter("ignore", prosim_scene.SceneWarning)  # the client shows them
        if mi.variant() != expected["variant"]:
            session.set_variant(expected["variant"])
        found = environment.this_environment()
        if environment.differences(expected, environment.MUST_AGREE):
            return 0.0, b"", found
        return *timed_sums(load(client, scene), item), found

    return render_thread().submit(compute).result()


def timed_sums(estimator: Estimator, item: bytes) -> tuple[float, bytes]:
    """``(seconds, sums)`` of a :func:`packed` work item; the sums are pickled."""
    with alone():
        work_item = WorkItem(estimator, *pickle.loads(item))
    started = time.perf_counter()
    sums = work_item.compute()
    dr.sync_thread()
    return time.perf_counter() - started, pickled(sums)
