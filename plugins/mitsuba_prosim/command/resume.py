"""``prosim resume``: goes on with a render from the state that it has kept."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from .. import saved
from ..engine.policies import POLICIES
from ..engine.record import Record
from ..scene import session
from . import output as files
from .arguments import SCENE, STATE, pattern
from .job import Job
from .making import SUFFIXES, make
from .options import STOPS, Finite, Helpers, InputError, aims, choose_variant, helped, running

#: Policies that decide by the first samples alone: another aim is pursued by ``graded``.
BY_FIRST = ("neighbours", "thesis")


#: Decorators: the options of commands that open a state.
moved = click.option(
    "--scene",
    type=SCENE,
    show_default=False,
    help="Where the scene is now. [default: where it was, or beside the state]",
)
exposing = click.option(
    "--exposure",
    type=Finite(-STOPS, STOPS),
    metavar="STOPS",
    show_default=False,
    help="Makes the PNG brighter by so many factors of two. [default: what was asked for]",
)


@click.command()
@click.argument("state", type=STATE)
@click.option(
    "-o",
    "--output",
    metavar="PATH",
    show_default=False,
    help="Image to write, as for prosim render; the state that follows is kept beside it. [default: beside STATE, "
    "under its name]",
)
@aims(
    noise="Go on until the error of the displayed pixels is so small. [default: what was asked for]",
    noise_99="Go on until 99 displayed pixels in 100 have no greater error. [default: what was asked for]",
    time="Go on until it has been rendered for so long in all. [default: what was asked for]",
    max_samples="Most samples that a pixel may get. [default: what was asked for]",
)
@click.option(
    "--adaptive",
    type=click.Choice([name for name in POLICIES if name not in BY_FIRST]),
    show_default=False,
    help="Which pixels get how many samples from now on. [default: as before; graded where that knows N*N samples and "
    "no more]",
)
@moved
@exposing
@helped
@running
def resume(
    state: Path,
    output: str | None,
    noise: float | None,
    noise_99: float | None,
    time: float | None,
    max_samples: int | None,
    adaptive: str | None,
    scene: Path | None,
    exposure: float | None,
    threads: int | None,
    verbose: int,
    helpers: Helpers | None,
) -> None:
    """Go on with a render from STATE, which prosim render --keep has written, until it is what was asked for.

    The image is then the same to the bit as if nothing had been between. Other aims are pursued from where it is. A
    state that does not belong to the scene, or to this version, is refused.
    """
    record, job = opened(state, scene, exposure)
    stem = files.stem(output, named(state), SUFFIXES)
    asked = {"noise": noise, "noise_99": noise_99, "time": time, "max_samples": max_samples, "adaptive": adaptive}
    if record.part and any(asked.values()):
        raise click.UsageError(
            f"{state} is a part, and all parts of an image are to have one aim: finish it as it is. --noise, "
            "--noise-99, --time, --max-samples and --adaptive are for the image that prosim merge --keep makes of them."
        )
    before = record.facts["sampling"]["time"]
    if any(asked.values()) and time is None and before and record.facts["seconds"] > 0.99 * before:
        raise click.UsageError(
            f"the {before:g} s that were asked for before are used up, as --time counts from the beginning: say --time "
            f"as well, such as --time {2 * before:g}"
        )
    if record.part and helpers:
        raise click.UsageError(f"{state} is a part, which one process renders; {helpers} is for whole images.")
    job = replace(job, integrator={**job.integrator, **changes(record, asked)})
    make(job, stem, threads, verbose, record, keep=True, part=record.part, helpers=helpers, sources=[state])
    if record.finished and not any(asked.values()):
        click.echo(
            f"It was finished before. When all parts are: prosim merge {pattern(state)}"
            if record.part
            else f"It was finished before. To take it further, say how far, such as {further(record)}."
        )


def further(record: Record) -> str:
    """Options that take a finished image further than it is: half its noise, where that is known, or twice its time."""
    sampling = record.facts["sampling"]
    noises = [noise for noise in (record.facts["noise"], sampling["noise"]) if noise > 0]  # not NaN
    options = [f"--noise {min(noises) / 2:.2g}"] if noises else []
    if not noises or sampling["time"]:
        options.append(f"--time {max(2 * record.facts['seconds'], 1):.3g}")
    if sampling["max_samples"]:
        options.append(f"--max-samples {4 * sampling['max_samples']}")
    return " ".join(options)


def opened(
    state: Path, scene: Path | None, exposure: float | None, read: Callable[[], Record] | None = None
) -> tuple[Record, Job]:
    """The record in a file, and the job that it is of, whose variant is set; ``scene``: where that of the job is now;
    ``exposure``: in the place of that of the job; ``read``: what makes the record, if it is not in this file alone.

    Raises InputError.
    """
    try:
        variant = saved.about(state)["origin"]["variant"]
        choose_variant(variant)
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            record = read() if read else saved.load(state)
        job = Job.of(record)
        job = replace(job, scene=str(scene or found(Path(job.scene), state)))
        return record, job if exposure is None else replace(job, exposure=exposure)
    except OSError as error:
        raise InputError(f"{state}: {files.said(error)}") from None
    except ValueError as error:
        raise InputError(session.message(error)) from None


def named(state: Path) -> Path:
    """The path of a state without its suffix."""
    return state.with_name(re.sub(r"(\.state|\.\d+-of-\d+)?\.exr$", "", state.name))


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
    return {"adaptive": "graded" if adaptive in BY_FIRST else adaptive} | new
