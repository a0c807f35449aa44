"""``prosim resume`` and ``prosim merge``: continue a render from its state, and put the parts of an image together."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from ..engine import checkpoint
from ..engine.checkpoint import Checkpoint
from ..scene import session
from . import output
from .image import STATE, SUFFIXES, write_image
from .input_files import PartFile, SceneFile, StateFile, parts, stem
from .job import Job, continued, takes_job
from .options import Command, InputError, choose_variant, option

#: Policies that decide by the first samples alone: another aim is pursued by ``graded``.
BY_FIRST = ("neighbours", "thesis")

#: Options that say what is aimed at.
AIMS = ("noise", "time", "noise_99", "noise_999", "max_samples", "adaptive")

#: Decorator: the option of commands that open a state.
moved = option(
    "Scene", "--scene", type=SceneFile(), help="Where the scene is now. [default: where it was, or beside the state]"
)


@click.command(cls=Command)
@click.argument("state", type=StateFile())
@takes_job(
    "noise",
    "time",
    "noise_99",
    "noise_999",
    "max_samples",
    "adaptive",
    "output",
    "exposure",
    "verbose",
    "threads",
    "workers",
    "cluster",
)
@moved
def resume(asked: Job, state: Path, scene: Path | None) -> None:
    """Continue a render from STATE, which prosim render --keep has written, until it is what was asked for.

    The image is then the same to the bit as if nothing had been between. Other aims than before are pursued from where
    it is; --time counts from the beginning. A state that does not belong to the scene, or to this version, is refused.
    """
    record, job = opened(state, scene, asked.exposure)
    target = output.stem(asked.output, stem(state), SUFFIXES)
    aim = asked.integrator
    if record.part and aim:
        raise click.UsageError(
            f"{state} is a part, and all parts of an image are to have one aim: finish it as it is. --noise, "
            "--noise-99, --time, --max-samples and --adaptive are for the image that prosim merge --keep makes of them."
        )
    if record.part and asked.helpers:
        raise click.UsageError(f"{state} is a part, which one process renders; {asked.helpers} is for whole images.")
    if aim.get("adaptive") in BY_FIRST:
        raise click.UsageError(f"--adaptive {aim['adaptive']} decides by the first samples, and these are taken.")
    before = record.facts["sampling"]["time"]
    if aim and "time" not in aim and before and record.facts["seconds"] > 0.99 * before:
        raise click.UsageError(
            f"the {before:g} s that were asked for before are used up, as --time counts from the beginning: say --time "
            f"as well, such as --time {2 * before:g}"
        )
    changes = {**job.integrator, **changed(record, aim)}
    job = continued(job, asked, exposure=job.exposure, integrator=changes, keep=True, part=record.part)
    write_image(job, target, record, sources=[state])
    if record.finished and not aim:
        click.echo(
            f"It was finished before. When all parts are: prosim merge {parts(state)}"
            if record.part
            else f"It was finished before. To take it further, say how far, such as {further(record)}."
        )


@click.command(cls=Command)
@click.argument("files", metavar="PART...", type=PartFile(), nargs=-1, required=True)
@takes_job("output", "exposure", "keep", "verbose", "threads")
@moved
def merge(asked: Job, files: tuple[Path, ...], scene: Path | None) -> None:
    """Make the image of which each PART is one, as prosim render --part has written it: the same to the bit as if it
    had been rendered at once.

    All parts have to be there, each once, in any order. Nothing is rendered.
    """
    record, job = opened(files[0], scene, asked.exposure, lambda: checkpoint.merge(files))
    target = output.stem(asked.output, stem(files[0]), SUFFIXES)
    write_image(continued(job, asked, exposure=job.exposure), target, record, sources=files)
    number = f"The {len(files)} parts" if len(files) > 1 else "The part"
    click.echo(
        f"{number} can be removed: all that is known of the image is in {target}{STATE} as well."
        if asked.keep
        else f"{number} can be removed, unless the image is to be continued: prosim merge --keep makes a state of them."
    )


def further(record: Checkpoint) -> str:
    """Options that take a finished image further than it is: half its noise, where that is known, or twice its time."""
    sampling = record.facts["sampling"]
    noises = [noise for noise in (record.facts["noise"][0], sampling["noise"]) if noise > 0]  # not NaN
    options = [f"--noise {min(noises) / 2:.2g}"] if noises else []
    if not noises or sampling["time"]:
        options.append(f"--time {max(2 * record.facts['seconds'], 1):.3g}")
    if sampling["max_samples"]:
        options.append(f"--max-samples {4 * sampling['max_samples']}")
    return " ".join(options)


def opened(
    state: Path, scene: Path | None, exposure: float | None, read: Callable[[], Checkpoint] | None = None
) -> tuple[Checkpoint, Job]:
    """The record in a file, and the job that it is of, whose variant is set; ``scene``: where that of the job is now;
    ``exposure``: instead of that of the job; ``read``: what makes the record, if it is not in this file alone.

    Raises InputError.
    """
    try:
        choose_variant(checkpoint.about(state)["origin"]["variant"])
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            record = read() if read else checkpoint.load(state)
        job = Job.of(record)
        job = replace(job, scene=str(scene or found(Path(job.scene), state)))
        return record, job if exposure is None else replace(job, exposure=exposure)
    except OSError as error:
        raise InputError(f"{state}: {output.said(error)}") from None
    except ValueError as error:
        raise InputError(session.message(error)) from None


def found(scene: Path, state: Path) -> Path:
    """The scene where it was, or else beside the state. Raises ValueError where it is neither here nor there."""
    for path in (scene, state.parent / scene.name):
        if path.is_file():
            return path
    raise ValueError(f"{scene} is not there any more, nor beside {state}; say where it is with --scene")


def changed(record: Checkpoint, aim: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters of the integrator by which another ``aim`` is pursued."""
    if not aim:
        return {}
    adaptive = record.facts["sampling"]["adaptive"]
    return {**aim, "adaptive": aim.get("adaptive") or ("graded" if adaptive in BY_FIRST else adaptive)}
