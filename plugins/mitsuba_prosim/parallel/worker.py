"""The task that a Dask worker executes: takes the samples of a work item, of a scene that the worker gets as a bundle.

All tasks of a worker run in a single thread, which uses all threads of Dr.Jit. If two clients render on one worker,
their tasks are executed in turn.
"""

from __future__ import annotations

import gc
import io
import os
import pickle
import time
import warnings
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import distributed
import drjit as dr
import mitsuba as mi
import numpy as np
import prosim_scene

from .. import atomic
from ..alone import alone
from ..compat import dr_array
from ..engine import environment
from ..engine.estimator import Estimator
from ..engine.work import WorkItem
from ..parameters import pick_sensor
from ..scene import scene_file, session

#: Name of the file by which a bundle has an empty folder.
EMPTY = ".empty"


@dataclass(frozen=True)
class SceneBundle:
    """A scene in a form that can be sent to a worker: its text, and the files that the text names.

    ``main`` is the name of the scene's XML file, ``changes`` are further arguments of :class:`.SceneFile`, and
    ``contents`` maps the name of each file, relative to the scene's folder, to its bytes. Bundles in two variants are
    different, so that a worker loads the scene again.
    """

    main: str
    changes: Mapping[str, Any]
    sensor: int
    variant: str
    contents: Mapping[str, bytes]

    @classmethod
    def of(cls, file: scene_file.SceneFile, sensor: int = 0) -> SceneBundle:
        """Returns the bundle of the scene ``file``.

        Raises OSError if a file cannot be read. Raises ValueError if the scene names a file or a folder outside the
        scene's folder, or a file by an absolute path.
        """
        folders, contents = [Path(os.path.abspath(folder)) for folder in (file.xml.parent, file.path.parent)], {}
        # The folders of elements <path> must exist on the worker, so each has an empty file.
        searched = [str(folder) for folder in file.resolver if str(folder) not in file.folders]
        empty = [(os.path.relpath(folder, folders[1]), Path(folder, EMPTY)) for folder in searched]
        for name, path in [*file.named_files(), *empty]:
            place = Path(os.path.abspath(path))
            folder = next((folder for folder in folders if place.is_relative_to(folder)), None)
            if folder is None or os.path.isabs(name):
                raise ValueError(
                    f"{file.path}: the scene names {name}, and a cluster needs all files in the scene's folder; copy "
                    "the file there, and name it relative to that folder"
                )
            contents[place.relative_to(folder).as_posix()] = b"" if path.name == EMPTY else path.read_bytes()
        return cls(file.xml.name, file.changes, sensor, mi.variant() or "", contents)

    def load(self) -> tuple[mi.Scene, mi.Sensor]:
        """Writes the files to a temporary folder, and returns the scene and its sensor. Raises the errors of
        :class:`.SceneFile` and of the plugins.
        """
        with atomic.scratch() as folder:
            atomic.write({folder / name: content for name, content in self.contents.items()})
            scene = scene_file.SceneFile(folder / self.main, folder, **self.changes).load()
            return scene, pick_sensor(scene, self.sensor)


#: Maximum number of clients whose last scene a worker keeps.
SCENES = 4


#: The pool of one thread that runs all tasks of this worker.
RENDER_THREAD = ThreadPoolExecutor(1, "prosim")

#: Client -> its last scene, pickled, and the estimator of this scene.
scenes = dict[str, tuple[bytes, Estimator]]()


def load(client: str, content: bytes) -> Estimator:
    """Returns the :class:`.Estimator` of the scene in ``content``, a pickled :class:`.SceneBundle`; loads the scene,
    unless it is the last one of this ``client``, the id of a Dask client.

    The previous scene of the client is deleted first, so that the objects of the new scene get the same numbers in
    Dr.Jit's registry, and compiled kernels can be used again.
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
    """Returns ``value`` in pickled form, in which :func:`..compat.dr_array` makes the Dr.Jit arrays, so that kernels
    are not compiled again because of another memory alignment.
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
    return pickled((item.plan, item.x, item.y, item.start, item.end, item.samples))


def sample(
    client: str, expected: Mapping[str, str], scene: bytes, item: bytes
) -> tuple[float, bytes, Mapping[str, str]]:
    """Computes a :func:`packed` work item on this worker; returns the seconds, the pickled new sums of the pixels, and
    the environment of this worker: variant, software versions and processor.

    ``scene`` is a pickled :class:`.SceneBundle`. A worker with another variant or other versions than ``expected``
    takes no samples. The worker uses the threads that Dask assigns to it, unless it is in the client's process. Raises
    ImportError or RuntimeError if it cannot use the variant.
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
    """Computes a :func:`packed` work item; returns the seconds, without those for pickling, and the pickled sums."""
    with alone():
        work_item = WorkItem(estimator, *pickle.loads(item))
    started = time.perf_counter()
    sums = work_item.compute()
    dr.sync_thread()
    return time.perf_counter() - started, pickled(sums)
