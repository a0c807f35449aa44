"""``prosim resume``: goes on with a render from the state that it has kept."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from .. import saved
from ..rendering.record import Record
from ..scene_files import session
from . import output as files
from .job import Job
from .making import STATE, SUFFIXES, make
from .options import SCENE, STOPS, Finite, InputError, choose_variant, running

#: Policies that decide by the first samples alone: another aim is pursued by ``graded``.
BY_FIRST = ("neighbours", "thesis")


@click.command()
@click.argument("state", type=SCENE)
@click.option(
    "-o",
    "--output",
    metavar="PATH",
    show_default=False,
    help="Image to write, as for prosim render; the state that follows is kept beside it. [default: beside STATE, "
    "under its name]",
)
@click.option(
    "--noise",
    type=Finite(min=0, min_open=True),
    show_default=False,
    help="Go on until the error of the displayed pixels is so small. [default: what was asked for]",
)
@click.option(
    "--time",
    type=Finite(min=0, min_open=True),
    metavar="SECONDS",
    show_default=False,
    help="Go on until it has been rendered for so long in all. [default: what was asked for]",
)
@click.option(
    "--max-samples",
    type=click.IntRange(1, 2**20),
    show_default=False,
    help="Most samples that a pixel may get. [default: what was asked for]",
)
@click.option(
    "--scene", type=SCENE, show_default=False, help="Where the scene is now. [default: where it was, or beside STATE]"
)
@click.option(
    "--exposure",
    type=Finite(-STOPS, STOPS),
    metavar="STOPS",
    show_default=False,
    help="Makes the PNG brighter by so many factors of two. [default: what was asked for]",
)
@running
def resume(
    state: Path,
    output: str | None,
    noise: float | None,
    time: float | None,
    max_samples: int | None,
    scene: Path | None,
    exposure: float | None,
    threads: int | None,
    verbose: int,
) -> None:
    """Go on with a render from STATE, which prosim render --keep has written, until it is what was asked for.

    The image is then the same to the bit as if nothing had been between. Other aims are pursued from where it is. A
    state that does not belong to the scene, or to this version, is refused.
    """
    record, job = opened(state, scene)
    stem = files.stem(output, named(state), SUFFIXES)
    asked = {"noise": noise, "time": time, "max_samples": max_samples}
    job = replace(job, integrator={**job.integrator, **changes(record, asked)})
    if exposure is not None:
        job = replace(job, exposure=exposure)
    make(job, stem, threads, verbose, record, keep=True)


def opened(state: Path, scene: Path | None) -> tuple[Record, Job]:
    """The record in a file, and the job that it is of, whose variant is set; ``scene``: where that of the job is now.

    Raises InputError.
    """
    try:
        variant = saved.about(state)["origin"]["variant"]
        choose_variant(variant)
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            record = saved.load(state)
        job = Job.of(record)
        return record, replace(job, scene=str(scene or found(Path(job.scene), state)))
    except OSError as error:
        raise InputError(f"{state}: {files.said(error)}") from None
    except ValueError as error:
        raise InputError(session.message(error)) from None


def named(state: Path) -> Path:
    """The path of a state without its suffix."""
    return state.with_name(state.name.removesuffix(STATE).removesuffix(".exr"))


def found(scene: Path, state: Path) -> Path:
    """The scene where it was, or else beside the state. Raises ValueError where it is neither here nor there."""
    for path in (scene, state.parent / scene.name):
        if path.is_file():
            return path
    raise ValueError(f"{scene} is not there any more, nor beside {state}; say where it is with --scene")


def changes(record: Record, asked: dict[str, Any]) -> dict[str, Any]:
    """Parameters of the integrator by which another aim is pursued; ``asked``: new ones, or None."""
    new = {name: value for name, value in asked.items() if value is not None}
    if not new:
        return {}
    adaptive = record.facts["sampling"]["adaptive"]
    return new | {"adaptive": "graded" if adaptive in BY_FIRST else adaptive}
