"""Rendering by other processes, as ``--cluster`` and ``--workers`` ask for."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING

import click

from ..scene.scene_file import SceneFile
from .job import Job
from .option_types import need, wrong_input
from .progress import warn

if TYPE_CHECKING:
    from ..parallel.executor import DaskExecutor


class Workers(ExitStack):
    """The workers that a job asks for, from the first image until the context ends."""

    def __init__(self, job: Job) -> None:
        super().__init__()
        self.job = job
        self.dask: DaskExecutor | None = None

    def executor(self, file: SceneFile) -> DaskExecutor | None:
        """The executor for the samples of an image of ``file``; None for this process.

        Raises InputError where the scene can't travel, and ClickException.
        """
        job, option = self.job, self.job.distributed
        if option is None:
            return None
        need("cluster", option)
        from ..parallel import cluster
        from ..parallel.bundle import SceneBundle
        from ..parallel.executor import DaskExecutor

        with wrong_input():
            bundle = SceneBundle.of(file, job.sensor)
        if self.dask is not None:
            self.dask.turn_to(bundle)
            return self.dask
        there = cluster.scheduler(job.cluster) if job.cluster else cluster.workers(job.workers or 1, job.threads)
        try:
            self.dask = DaskExecutor(self.enter_context(there), bundle, warn)
        except RuntimeError as error:
            message = str(error) if job.cluster else f"the workers can't be started here ({error})"
            raise click.ClickException(message) from None
        return self.dask
