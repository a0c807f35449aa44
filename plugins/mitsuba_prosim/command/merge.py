"""``prosim merge``: the image of which the parts were rendered one by one."""

from __future__ import annotations

from pathlib import Path

import click

from .. import saved
from . import output as files
from .arguments import PART
from .making import STATE, SUFFIXES, make
from .options import running
from .resume import exposing, moved, named, opened


@click.command()
@click.argument("parts", metavar="PART...", type=PART, nargs=-1, required=True)
@click.option(
    "-o",
    "--output",
    metavar="PATH",
    show_default=False,
    help="Image to write, as for prosim render. [default: beside the first part, under its name]",
)
@click.option(
    "--keep",
    is_flag=True,
    help="Write the state as well, as NAME.state.exr, so that prosim resume can go on with the whole.",
)
@moved
@exposing
@running
def merge(
    parts: tuple[Path, ...],
    output: str | None,
    keep: bool,
    scene: Path | None,
    exposure: float | None,
    threads: int | None,
    verbose: int,
) -> None:
    """Make the image of which each PART is one, as prosim render --part has written it: the same to the bit as if it
    had been rendered at once.

    All parts have to be there, each once, in any order. Nothing is rendered.
    """
    record, job = opened(parts[0], scene, exposure, lambda: saved.merge(parts))
    stem = files.stem(output, named(parts[0]), SUFFIXES)
    make(job, stem, threads, verbose, record, keep, sources=parts)
    number = f"The {len(parts)} parts" if len(parts) > 1 else "The part"
    click.echo(
        f"{number} can be removed: all that is known of the image is in {stem}{STATE} as well."
        if keep
        else f"{number} can be removed, unless the image is to go on: prosim merge --keep makes a state of them."
    )
