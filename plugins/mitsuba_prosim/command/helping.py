"""Rendering by other processes, as ``--cluster`` and ``--workers`` ask for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click
import mitsuba as mi

from ..scene_files import opening, rendering
from .options import Helpers, InputError

if TYPE_CHECKING:
    from ..cluster.parcel import Parcel
    from ..cluster.remote import Remote


def pack(helpers: Helpers | None, file: opening.SceneFile, integrator: mi.Integrator, sensor: int) -> Parcel | None:
    """The scene as it is sent to ``helpers``; None where there are none.

    Raises InputError where Dask is missing, ValueError where the scene can't travel or its integrator needs no helpers,
    OSError.
    """
    if helpers is None:
        return None
    try:
        import distributed  # noqa: F401
    except ImportError:
        raise InputError(f"{helpers} needs Dask: pip install 'mitsuba-prosim[cluster]'") from None
    from ..cluster.parcel import Parcel

    if not rendering.keeps(integrator):
        raise ValueError(
            f"{helpers}: other processes take the samples where prosim or prosim_adaptive says which, in all but "
            f"scalar variants; this scene's integrator is {integrator.class_name()}. Say how it should be sampled, "
            "such as --noise 0.01 or --adaptive none --samples 8: it is put within prosim_adaptive then."
        )
    return Parcel.of(file, sensor)


@contextmanager
def helping(
    helpers: Helpers | None, parcel: Parcel | None, threads: int | None, say: Callable[[str], None], integrator: Any
) -> Iterator[Remote | None]:
    """Lets ``helpers`` take the samples of ``integrator``, for a while. ``threads``: of all on this
    machine; ``say``: is told what is wrong with some of them. Raises ClickException.
    """
    if helpers is None or parcel is None:
        yield None
        return
    from ..cluster import local
    from ..cluster.remote import ClusterError, Remote

    there = local.scheduler(helpers.cluster) if helpers.cluster else local.workers(helpers.workers or 1, threads)
    try:
        with there as client, Remote(client, parcel, say) as taker:
            integrator.taker, taker.stop = taker, integrator.cancel
            try:
                yield taker
            finally:
                integrator.taker = None
    except ClusterError as error:
        raise click.ClickException(str(error)) from None
