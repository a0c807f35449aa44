"""An image by a cluster, in Python."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import distributed
import mitsuba as mi

from ..scene import atomic, rendering, scene_file
from .faults import ClusterError
from .parcel import Parcel
from .remote import Remote


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

    ``client``: None for Dask's current one; ``spp``: samples per pixel, 0 for what the scene says; ``changes``: those
    of :class:`~mitsuba_prosim.scene.scene_file.SceneFile`, such as ``resolution=(640, 480)`` or
    ``integrator={"noise": 0.01}``. The image has the bits of one that this process alone renders.

    Raises :class:`.ClusterError` where the cluster can't, ValueError where the scene can't travel or be rendered so.
    """
    with atomic.scratch() as folder:
        file = scene_file.SceneFile(scene, folder, **changes)
        loaded = file.load()
        parcel = Parcel.of(file, sensor)
    chosen = scene_file.pick_sensor(loaded, sensor)
    integrator: Any = loaded.integrator()
    if not rendering.keeps(integrator):
        raise ValueError(
            "a cluster takes samples where prosim or prosim_adaptive says which, in all but scalar variants; this "
            f"scene's integrator is {integrator.class_name()}. Say how it should be sampled, such as "
            'integrator={"noise": 0.01}: it is put within prosim_adaptive then.'
        )
    with Remote(client or distributed.default_client(), parcel, warnings.warn) as taker:
        render = integrator.progressive(loaded, chosen, seed, spp, executor=taker).run()
        if taker.gone:
            raise ClusterError(taker.gone)
        return render.image()
