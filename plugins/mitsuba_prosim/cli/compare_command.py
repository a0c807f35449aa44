"""``prosim compare``: compares two integrators or samplers on a scene, and writes an HTML page with the results."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
import mitsuba as mi

from ..compat import PLACE
from ..scene import session
from . import files
from .files import SCENE_FILE
from .job import Command, Job, job_options
from .option_types import ROOTS, Integer, Number, input_errors, option, require_extra
from .progress import Progress
from .render_task import Resources, check_denoising

SUFFIXES = (".html", ".json")


@click.command(cls=Command)
@click.argument("scene", type=SCENE_FILE)
@click.argument("a", default="prosim")
@click.argument("b", default="path:multijitter")
@job_options("denoise", "output", "exposure", "definitions", "resolution", "allow_outside")
@job_options("variant", "samples", "light_units", "tolerance")
@option("Comparison", "--rounds", type=Integer(min=1), default=5, help="Number of measured runs of each method.")
@option("Comparison", "--sqrt-spp", type=ROOTS, default="2,3,4,6,9", help="Square roots of the samples per pixel.")
@option("Comparison", "--reference-seconds", type=Number(0), default=60, help="Minimum seconds for each reference.")
def compare(job: Job, a: str, b: str, rounds: int, sqrt_spp: tuple[int, ...], reference_seconds: float) -> None:
    """Compare A and B on SCENE, in the thesis's language or XML: error, time and samples.

    A and B are each INTEGRATOR[:SAMPLER][,PARAMETER=VALUE...], such as prosim,noise=0.01 or
    path:multijitter,max_depth=5; the default sampler is the scene's. If B is not adaptive, B is rendered twice: with
    the same number of samples as A, and in A's processor time. Errors are differences from a converged reference image.
    If only one of A and B is prosim, prosim renders the scene twice: once with the kinds of light paths that the other
    integrator simulates, and once with the kinds that the scene selects. The command writes two files to the scene's
    folder: a page with the results, SCENE-compare.html, and the numbers of this page, SCENE-compare.json.
    """
    require_extra("compare", "prosim compare")
    scene = Path(job.scene)
    stem = files.output_stem(job.output, scene.with_name(scene.stem + "-compare"), SUFFIXES)
    if job.variant.startswith("scalar_") or not job.variant.endswith("_rgb"):
        raise click.ClickException(f"prosim compare can't use {job.variant}; give an rgb variant that is not scalar.")

    from ..compare import comparison, comparison_page, methods

    with Resources(job) as resources:
        with input_errors():
            specs = methods.Spec(a), methods.Spec(b)
            mi.set_log_level(mi.LogLevel.Error)  # hides warnings about rounded sample counts
            compared_scene = methods.ComparedScene(job.read_scene(resources.folder))
            if job.denoise:
                check_denoising(compared_scene.sensor().film())
            for spec in specs:  # finds errors in A and B before the long work begins
                try:
                    compared_scene.method(spec, spec.transport or "scene", spp=4)
                except RuntimeError as error:
                    # The message names a line of the scene, but the error is in A or B: removes the line.
                    raise ValueError(
                        f"'{spec.text}': {PLACE.sub('', session.message(error)).removeprefix(': ')}"
                    ) from None
        files.check(stem, SUFFIXES, 2**23, [scene])  # 8 MiB is about the size of the page
        effort = comparison.Effort(sqrt_spp, rounds, reference_seconds, job.denoise)
        compared = comparison.Comparison(compared_scene, scene.name, *specs, effort, job.exposure or 0.0)
        with Progress("comparing") as bar:
            for phase, progress in compared.run():
                bar.show(progress, phase)
    numbers = json.dumps(compared.facts, indent=1, ensure_ascii=False) + "\n"
    texts = comparison_page.html(compared.facts, compared.images), numbers
    written = files.save(stem, {suffix: text.encode("utf-8") for suffix, text in zip(SUFFIXES, texts)})
    click.echo(summary(compared.facts, comparison.LIGHT))
    click.echo(" and ".join(map(str, written)))


def summary(facts: Mapping[str, Any], light: Mapping[str, str]) -> str:
    """Returns the rows of the first section of the results, see :attr:`.Comparison.facts`, as a few lines of text.
    ``light`` describes each light transport.
    """
    section = facts["sections"][0]
    lines = [f"Light: {light[section['transport']]}. Samples and times are as near to equal as the samplers allow."]
    labels = [row["name"] + row["role"][1:] for row in section["rows"]]  # "b at equal time" -> "path at equal time"
    for label, row in zip(labels, section["rows"]):
        lines.append(
            f"{label:<{max(map(len, labels))}} {row['samples']:7.1f} samples  {row['seconds']['median']:7.3f} s  "
            f"RMSE {row['rmse']['median']:.5f}  FLIP {row['flip']['median']:.4f}"
        )
    return "\n".join(lines)
