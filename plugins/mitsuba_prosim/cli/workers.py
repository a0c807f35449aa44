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
    from ..cluster.parcel import Parcel
    from ..cluster.remote import Remote


def packed(task: Task) -> Task:
    """The task with the scene as it is sent to the workers; as it is where there are none.

    Raises ClickException where Dask is missing, ValueError where the scene can't travel or its integrator does not
    render progressively, OSError.
    """
    option = task.job.helpers
    if option is None:
        return task
    if extras.missing("cluster"):
        raise click.ClickException(extras.needs(option, "cluster"))
    from ..cluster.parcel import Parcel

    if not rendering.keeps(task.integrator):
        raise ValueError(
            f"{option}: other processes take the samples where prosim or prosim_adaptive says which, in all but scalar "
            f"variants; this scene's integrator is {task.integrator.class_name()}. {HOW_TO_SAMPLE}"
        )
    return replace(task, parcel=Parcel.of(task.file, task.job.sensor))


class Workers:
    """The workers that a job asks for, from the first image that needs them until the context ends."""

    def __init__(self, job: Job) -> None:
        self.job = job
        self.until = ExitStack()
        self.remote: Remote | None = None

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *_: object) -> None:
        self.until.close()

    def executor(self, parcel: Parcel | None) -> Remote | None:
        """What takes the samples of the scene ``parcel``; None where that is this process. Raises ClickException."""
        if parcel is None:
            return None
        if self.remote is not None:
            self.remote.turn_to(parcel)
            return self.remote
        from ..cluster import local
        from ..cluster.remote import Remote

        job = self.job
        there = local.scheduler(job.cluster) if job.cluster else local.workers(job.workers or 1, job.threads)
        try:
            client = self.until.enter_context(there)
            self.remote = self.until.enter_context(Remote(client, parcel, warn))
        except RuntimeError as error:
            said = str(error) if job.cluster else f"the workers can't be begun here ({error})"
            raise click.ClickException(said) from None
        return self.remote

    def spent(self) -> tuple[float, int]:
        """Seconds that they have taken samples for, all together, and how many these are."""
        return (0.0, 0) if self.remote is None else (self.remote.taking, self.remote.work)
