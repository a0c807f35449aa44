"""``prosim render``: a scene file in, an EXR and a PNG image out."""

from __future__ import annotations

import sys
from contextlib import closing
from pathlib import Path

import click

from .. import atomic
from ..engine.checkpoint import Checkpoint
from ..scene import rendering, session
from . import frames, output_files
from .input_files import SCENE_FILE
from .job import OPTIONS, Command, Job, takes
from .log import log
from .option_types import wrong_input
from .progress import Progress, warn
from .render_task import SUFFIXES, RenderTask, render_image
from .tev import TevClient
from .workers import Workers


@click.command(cls=Command)
@click.argument("scene", type=SCENE_FILE)
@takes(*OPTIONS)
def render(job: Job) -> None:
    """Render SCENE, a file in the thesis's scene language (any name) or a Mitsuba scene (.xml).

    Writes a linear EXR, whose metadata say how it was made, and a tone-mapped PNG. Existing files are replaced when the
    new ones are complete. Ctrl-C ends the render and keeps the image so far (exit code 1).

    Set the quality by --noise, --time or --spp; by default, the scene sets it.
    """
    stem = output_files.stem(job.output, Path(job.scene).with_suffix(""), SUFFIXES)
    if job.frames is None:
        write_image(job, stem)
    else:
        frames.render(job, stem)


def write_image(job: Job, stem: Path, begin: Checkpoint | None = None) -> None:
    """Renders a job, or its part alone, writes its image, and prints a report. ``stem``: the path without suffix.

    ``begin``: continues from there. Raises InputError, where nothing has been written, and ClickException; ends the
    process where it was interrupted.
    """
    with log(job.verbose), session.threads(job.threads), atomic.scratch() as folder:
        with wrong_input():
            task = RenderTask(job, job.file(folder), stem, begin)
            task.check()
        progressive = rendering.is_progressive(task.integrator)
        with (
            Workers(job) as workers,
            closing(TevClient(job, task.sensor.film())) as shown,
            # The first step ends when the kernels are compiled and one work item is rendered.
            Progress("compiling kernels" if progressive else "rendering", timed=progressive) as bar,
        ):
            image, report = render_image(task, bar, workers, shown)
        if image.black:
            warn(image.black)
    click.echo(report)
    if image.interruption:
        sys.exit(1)
