"""The task that a Dask worker executes: takes the samples of a work item.

All tasks of a worker run in a single thread, which uses all threads of Dr.Jit. If two clients render on one worker,
their tasks are executed in turn.
"""

from __future__ import annotations

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

#: Maximum number of clients whose last scene a worker keeps.
SCENES = 4


#: The pool of one thread that runs all tasks of this worker.
RENDER_THREAD = ThreadPoolExecutor(1, "prosim")

#: Client -> its last scene, pickled, and the estimator of this scene.
scenes = dict[str, tuple[bytes, Estimator]]()


def load(client: str, content: bytes) -> Estimator:
    """Returns the :class:`.Estimator` of a scene; loads the scene, unless it is the last scene that this client used.

    ``client`` is the id of the Dask client. ``content`` is a pickled :class:`.SceneBundle`. If :data:`SCENES` other
    clients have scenes, the scene of the client that has waited longest is deleted.

    The previous scene of this client is deleted before the new scene is loaded. Because the previous scene is deleted
    first, the objects of the new scene get the numbers of the deleted objects in Dr.Jit's registry, so that compiled
    kernels in the cache can be used again.
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
    """Returns ``value`` in pickled form.

    When the result is unpickled, Dr.Jit arrays are made by :func:`..compat.dr_array`, so that kernels are not compiled
    again because of another memory alignment.
    """
    content = io.BytesIO()
    pickler = pickle.Pickler(content)
    kinds = mi.Float, mi.Float64, mi.UInt32, mi.Int32
    pickler.dispatch_table = dict.fromkeys(kinds, lambda array: (dr_array, (np.array(array),)))
    with alone():
        pickler.dump(value)
    return content.getvalue()


def packed(item: WorkItem) -> bytes:
    """Returns a work item in pickled form, without its scene and without the function that stores its sums."""
    return pickled((item.plan, item.x, item.y, item.start, item.end))


def sample(
    client: str, expected: Mapping[str, str], scene: bytes, item: bytes
) -> tuple[float, bytes, Mapping[str, str]]:
    """Computes a work item on this worker, and returns ``(seconds, sums, environment)``.

    ``scene`` is a pickled :class:`.SceneBundle`, and ``item`` a :func:`packed` work item. ``sums`` are the pickled new
    sums of the pixels. ``environment`` is the variant, the software versions and the processor of this worker. If this
    worker has another variant or other software versions than ``expected``, the samples are not taken, and ``sums`` is
    empty.

    A worker renders with the number of threads that Dask assigns to this worker. A worker in the same process as the
    client does not change the number of threads of this process. Raises ImportError or RuntimeError if the worker
    cannot use the variant.
    """
    dask_worker = distributed.get_worker()

    def compute() -> tuple[float, bytes, Mapping[str, str]]:
        if not dask_worker.address.startswith("inproc:"):
            dr.set_thread_count(dask_worker.state.nthreads)
            warnings.simplefilter("ignore", prosim_scene.SceneWarning)  # the client shows these warnings
        session.set_variant(expected["variant"])
        found = environment.this_environment()
        if environment.differences(expected, environment.MUST_AGREE):
            return 0.0, b"", found
        return *timed_sums(load(client, scene), item), found

    return RENDER_THREAD.submit(compute).result()


def timed_sums(estimator: Estimator, item: bytes) -> tuple[float, bytes]:
    """Computes a :func:`packed` work item; returns ``(seconds, sums)``, without the time for pickling."""
    with alone():
        work_item = WorkItem(estimator, *pickle.loads(item))
    started = time.perf_counter()
    sums = work_item.compute()
    dr.sync_thread()
    return time.perf_counter() - started, pickled(sums)
