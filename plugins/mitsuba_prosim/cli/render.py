"""``prosim render``: a scene file in, an EXR and a PNG image out."""

from __future__ import annotations

import click

from . import film, output
from .image import SUFFIXES, write_image
from .input_files import SceneFile
from .job import Job, refuse_for_xml, takes_job
from .options import Command


@click.command(cls=Command)
@click.argument("scene", type=SceneFile())
@takes_job()
def render(job: Job) -> None:
    """Render SCENE, a file in the thesis's scene language (any name) or a Mitsuba scene (.xml).

    Writes a linear EXR (how it was made is in its metadata) and a tone-mapped PNG. Existing files are replaced when the
    new ones are complete. Ctrl-C ends the render and keeps the image so far (exit code 1).

    How good? --noise, --time or --spp; without these, what the scene says.
    """
    refuse_for_xml(job, "light_units", "tolerance", "allow_outside")
    stem = output.default_stem(job.output, job.scene, SUFFIXES)
    if job.frames is None:
        write_image(job, stem)
    else:
        film.render(job, stem)
