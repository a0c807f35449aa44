"""``prosim compare`` and ``prosim explain``: write an HTML page that compares integrators or samplers on a scene, or
explains why a pixel has its value.
"""

import shlex
import sys
from pathlib import Path

import click
import mitsuba as mi

from . import files
from .job import Command, Job, job_options, refuse_scalar
from .option_types import SCENE_FILE, Integer, Number, PatternType, input_errors, integers, option, require_extra
from .render_task import Resources
from .terminal import Progress


@click.command(cls=Command)
@click.argument("scene", type=SCENE_FILE)
@click.argument("a", default="prosim")
@click.argument("b", default="path:multijitter")
@job_options("output", "exposure", "definitions", "resolution", "allow_outside")
@job_options("variant", "samples", "light_units", "tolerance")
@option("Comparison", "--rounds", type=Integer(min=1), default=5, help="Number of measured runs of each method.")
@option("Comparison", "--reference-seconds", type=Number(0), default=60, help="Minimum seconds for the reference.")
def compare(job: Job, a: str, b: str, rounds: int, reference_seconds: float) -> None:
    """Compare A and B on SCENE, in the thesis's language or XML: error, time and samples.

    A and B are each INTEGRATOR[:SAMPLER][,PARAMETER=VALUE...], such as prosim,noise=0.01 or
    path:multijitter,max_depth=5; the default sampler is the scene's. B is rendered twice: with the same number of
    samples as A, and in A's processor time; if B is prosim, once with its own settings. Errors are differences from a
    converged reference image. If only one of A and B is prosim, prosim simulates the kinds of light paths of the other
    integrator. The command writes a page with the results, SCENE-compare.html, to the scene's folder.
    """
    require_extra("compare", "prosim compare")
    if job.variant.startswith("scalar_") or not job.variant.endswith("_rgb"):
        raise click.ClickException(f"prosim compare can't use {job.variant}; give an rgb variant that is not scalar.")

    from ..compare import comparison, comparison_page, methods

    stem = page_stem(job, "compare", 2**23)
    with Resources(job) as resources:
        with input_errors():
            specs = methods.Spec(a), methods.Spec(b)
            mi.set_log_level(mi.LogLevel.Error)  # hides warnings about rounded sample counts
            compared_scene = methods.ComparedScene(job.read_scene(resources.folder))
            compared = comparison.Comparison(compared_scene, *specs, rounds, reference_seconds, job.exposure or 0.0)
        with Progress("comparing") as bar:
            for phase, progress in compared.run():
                bar.show(progress, phase)
    page = comparison_page.html(compared, Path(job.scene).name)
    (written,) = files.save(stem, {".html": page.encode("utf-8")})
    light, width = comparison.LIGHT[compared.transport], max(len(row.name) for row in compared.rows)
    click.echo(f"Light: {light}. Samples and times are as near to equal as the samplers allow.")
    for row in compared.rows:
        click.echo(
            f"{row.name:<{width}} {row.median('samples'):7.1f} samples  {row.median('seconds'):7.3f} s  "
            f"RMSE {row.median('rmse'):.5f}  FLIP {row.median('flip'):.4f}"
        )
    click.echo(written)


PIXEL = PatternType("X,Y", "120,80", r"(\d+),(\d+)", integers)


@click.command(cls=Command)
@click.argument("scene", type=SCENE_FILE)
@option("Page", "--pixel", type=PIXEL, required=True, help="Column and row of the pixel, from the upper left corner.")
@job_options("spp", "output", "definitions", "sensor", "resolution", "crop", "paths", "caustics", "max_level")
@job_options("allow_outside", "threads", "variant", "seed", "samples", "light_units", "tolerance", "verbose")
def explain(job: Job, pixel: tuple[int, int]) -> None:
    """Explain a pixel of SCENE: the rays of its samples, and the light that each ray adds.

    The command writes one HTML page, SCENE-explain.html in the scene's folder, with the rays of the brightest samples
    of the pixel. --spp is the number of samples of the pixel; the default is that of the scene, N².
    """
    refuse_scalar("prosim explain", job.variant)
    stem = page_stem(job, "explain", 2**21)
    from ..explaining import explanation

    with Resources(job) as resources, input_errors():
        file = job.read_scene(resources.folder)
        command = shlex.join(["prosim", *sys.argv[1:]])
        page = explanation.page(file, command=command, pixel=pixel, spp=job.spp or 0, sensor=job.sensor, seed=job.seed)
    click.echo(files.save(stem, {".html": page.encode("utf-8")})[0])


def page_stem(job: Job, name: str, size: int) -> Path:
    """Returns the path, without suffix, of the page ``name`` of a job, of about ``size`` bytes. Raises the
    errors of :func:`.files.output_stem` and :func:`.files.check`.
    """
    scene = Path(job.scene)
    stem = files.output_stem(job.output, scene.with_name(f"{scene.stem}-{name}"), [".html"])
    files.check(stem, [".html"], size, [scene])
    return stem
