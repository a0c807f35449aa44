"""Rendering by other processes, as ``--cluster`` and ``--workers`` ask for."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING

import click
from prosim_scene import extras

from ..scene import rendering
from .image import HOW_TO_SAMPLE, Task
from .job import Job
from .progress import warn

if TYPE_CHECKING:
    from ..parallel.bundle import SceneBundle
    from ..parallel.executor import DaskExecutor


def bundled(task: Task) -> Task:
    """The task with the scene as it is sent to the workers; as it is where there are none.

    Raises ClickException where Dask is missing, ValueError where the scene can't travel or its integrator does not
    render progressively, OSError.
    """
    option = task.job.helpers
    if option is None:
        return task
    if extras.missing("cluster"):
        raise click.ClickException(extras.needs(option, "cluster"))
    from ..parallel.bundle import SceneBundle

    if not rendering.keeps(task.integrator):
        raise ValueError(
            f"{option}: other processes take the samples where prosim or prosim_adaptive says which, in all but scalar "
            f"variants; this scene's integrator is {task.integrator.class_name()}. {HOW_TO_SAMPLE}"
        )
    return replace(task, bundle=SceneBundle.of(task.file, task.job.sensor))


class Workers:
    """The workers that a job asks for, from the first image that needs them until the context ends."""

    def __init__(self, job: Job) -> None:
        self.job = job
        self.until = ExitStack()
        self.dask: DaskExecutor | None = None

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *_: object) -> None:
        self.until.close()

    def executor(self, bundle: SceneBundle | None) -> DaskExecutor | None:
        """What takes the samples of the scene ``bundle``; None where that is this process. Raises ClickException."""
        if bundle is None:
            return None
        if self.dask is not None:
            self.dask.turn_to(bundle)
            return self.dask
        from ..parallel import cluster
        from ..parallel.executor import DaskExecutor

        job = self.job
        there = cluster.scheduler(job.cluster) if job.cluster else cluster.workers(job.workers or 1, job.threads)
        try:
            client = self.until.enter_context(there)
            self.dask = self.until.enter_context(DaskExecutor(client, bundle, warn))
        except RuntimeError as error:
            said = str(error) if job.cluster else f"the workers can't be begun here ({error})"
            raise click.ClickException(said) from None
        return self.dask
