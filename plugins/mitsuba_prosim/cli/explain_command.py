"""``prosim explain``: writes an HTML page that explains why a pixel has its value."""

import shlex
import sys
from pathlib import Path

import click

from . import files
from .files import SCENE_FILE
from .job import Command, Job, job_options, refuse_scalar
from .option_types import PatternType, input_errors, integers, option
from .render_task import Resources

PIXEL = PatternType("X,Y", "120,80", r"(\d+),(\d+)", integers)


@click.command(cls=Command)
@click.argument("scene", type=SCENE_FILE)
@option("Page", "--pixel", type=PIXEL, required=True, help="Column and row of the pixel, from the upper left corner.")
@job_options("spp", "output", "definitions", "sensor", "resolution", "paths", "caustics", "max_level", "allow_outside")
@job_options("threads", "variant", "seed", "samples", "light_units", "tolerance", "verbose")
def explain(job: Job, pixel: tuple[int, int]) -> None:
    """Explain a pixel of SCENE: the rays of its samples, and the light that each ray adds.

    The command writes one HTML page, SCENE-explain.html in the scene's folder, with the rays of the brightest samples
    of the pixel. --spp is the number of samples of the pixel; the default is that of the scene, N².
    """
    refuse_scalar("prosim explain", job.variant)
    scene = Path(job.scene)
    stem = files.output_stem(job.output, scene.with_name(scene.stem + "-explain"), [".html"])
    files.check(stem, [".html"], 2**21, [scene])
    from ..explaining import explanation

    with Resources(job) as resources, input_errors():
        file = job.read_scene(resources.folder)
        command = shlex.join(["prosim", *sys.argv[1:]])
        page = explanation.page(file, command=command, pixel=pixel, spp=job.spp or 0, sensor=job.sensor, seed=job.seed)
    click.echo(files.save(stem, {".html": page.encode("utf-8")})[0])
