"""Rendering by other processes, as ``--cluster`` and ``--workers`` ask for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

import click
import mitsuba as mi
from prosim_scene import extras

from ..scene import rendering, scene_file
from .job import Job

if TYPE_CHECKING:
    from ..cluster.parcel import Parcel
    from ..cluster.remote import Remote


def pack(job: Job, file: scene_file.SceneFile, integrator: mi.Integrator) -> Parcel | None:
    """The scene as it is sent to the workers; None where there are none.

    Raises ClickException where Dask is missing, ValueError where the scene can't travel or its integrator needs no
    helpers, OSError.
    """
    if job.helpers is None:
        return None
    try:
        import distributed  # noqa: F401
    except ImportError:
        raise click.ClickException(extras.needs(job.helpers, "cluster")) from None
    from ..cluster.parcel import Parcel

    if not rendering.keeps(integrator):
        raise ValueError(
            f"{job.helpers}: other processes take the samples where prosim or prosim_adaptive says which, in all but "
            f"scalar variants; this scene's integrator is {integrator.class_name()}. Say how it should be sampled, "
            "such as --noise 0.01 or --adaptive none --samples 8: it is put within prosim_adaptive then."
        )
    return Parcel.of(file, job.sensor)


class Helping:
    """What lets workers take samples: their cluster, from the first image that they are needed for until the end.
    ``say``: is told what is wrong with some of them.
    """

    def __init__(self, job: Job, say: Callable[[str], None]) -> None:
        self.job, self.say = job, say
        self.until = ExitStack()
        self.taker: Remote | None = None

    @property
    def elsewhere(self) -> bool:
        """Whether they may be other machines."""
        return self.job.cluster is not None

    def spent(self) -> tuple[float, int]:
        """Seconds that they have taken samples for, all together, and how many these are."""
        return (0.0, 0) if self.taker is None else (self.taker.taking, self.taker.work)

    def __enter__(self) -> Helping:
        return self

    def __exit__(self, *_: object) -> None:
        self.until.close()

    @contextmanager
    def __call__(self, parcel: Parcel | None, integrator: Any) -> Iterator[Remote | None]:
        """Lets them take the samples of ``integrator``, whose scene is ``parcel``, for a while; this process does it
        where that is None. Raises ClickException.
        """
        if parcel is None:
            yield None
            return
        from ..cluster.faults import ClusterError

        try:
            yield self._turned_to(parcel)
        except ClusterError as error:
            raise click.ClickException(str(error)) from None

    def _turned_to(self, parcel: Parcel) -> Remote:
        if self.taker is not None:
            self.taker.turn_to(parcel)
            return self.taker
        from ..cluster import local
        from ..cluster.faults import ClusterError
        from ..cluster.remote import Remote

        job = self.job
        there = local.scheduler(job.cluster) if job.cluster else local.workers(job.workers or 1, job.threads)
        try:
            client = self.until.enter_context(there)
        except RuntimeError as error:
            said = str(error) if job.cluster else f"the workers can't be begun here ({error})"
            raise ClusterError(said) from None
        self.taker = self.until.enter_context(Remote(client, parcel, self.say))
        return self.taker
