"""``prosim compare``: a scene under two integrators or samplers, as a page with every measure."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import mitsuba as mi

from .. import atomic
from ..compat import PLACE
from ..scene import session
from . import output_files
from .input_files import SCENE_FILE
from .job import Command, Job, takes
from .log import log
from .option_types import LEVELS, InputError, Integer, Number, need, option, wrong_input
from .progress import Progress
from .render_task import check_denoising

SUFFIXES = (".html", ".json")

#: Pixels a side that SSIM needs.
SSIM_WINDOW = 7

CACHE = click.Path(file_okay=False, path_type=Path)

#: The words of the summary for the light of a section.
LIGHT = {
    "paths": "all paths of light, without the ambient term",
    "direct": "direct light only",
    "scene": "the light of the scene",
}


@click.command(cls=Command)
@click.argument("scene", type=SCENE_FILE)
@click.argument("a", default="prosim")
@click.argument("b", default="path:multijitter")
@takes("noise", "denoise", "output", "exposure", "definitions", "resolution", "allow_outside")
@takes("variant", "samples", "light_units", "tolerance")
@option("Comparison", "--rounds", type=Integer(min=1), default=5, help="Measured runs of each; medians are shown.")
@option("Comparison", "--levels", type=LEVELS, default="2,3,4,6,9", help="Square roots of the curves' sample counts.")
@option("Comparison", "--reference-seconds", type=Number(0), default=60, help="Time for each reference, or more of it.")
@option("Comparison", "--cache", type=CACHE, help="Folder of references.", show_default="in the user's cache folder")
def compare(
    job: Job, a: str, b: str, rounds: int, levels: tuple[int, ...], reference_seconds: float, cache: Path | None
) -> None:
    """Compare A and B on SCENE, in the thesis's language or XML: error, time, samples, and missing light.

    A and B are each INTEGRATOR[:SAMPLER][,PARAMETER=VALUE...], such as prosim,adaptive=none or
    path:multijitter,max_depth=5; the default sampler is the scene's. B also renders with as many samples, and in as
    much time, as A; errors are against a converged reference. Where A is prosim and B is not, A renders both B's light
    and the scene's. Writes a page (.html) and its numbers (.json) in the scene's folder, as SCENE-compare.
    """
    need("compare", "prosim compare")
    scene = Path(job.scene)
    stem = output_files.stem(job.output, scene.with_name(scene.stem + "-compare"), SUFFIXES)
    noise = job.noise
    if job.variant.startswith("scalar_") or not job.variant.endswith("_rgb"):
        raise click.ClickException(f"prosim compare can't use {job.variant}; give an rgb variant that is not scalar.")

    from ..compare import comparison, comparison_page, contestants, runs

    with atomic.scratch() as folder, log(0):
        with wrong_input():
            specs = contestants.Spec(a), contestants.Spec(b)
            if noise:
                if not any(spec.is_adaptive for spec in specs):
                    raise ValueError(f"--noise is for prosim, which neither {a} nor {b} is")
                specs = specs[0].until(noise), specs[1].until(noise)
            mi.set_log_level(mi.LogLevel.Error)  # samplers that round their counts would warn: real counts are measured
            opened = contestants.Scene(replace(job, noise=None).file(folder))
            if job.denoise:
                check_denoising(opened.sensor().film())
            for spec in specs:  # errors of the contestants come before the long work
                try:
                    opened.contestant(spec, spec.transport or "scene", spp=4)
                except RuntimeError as error:
                    # The place is one of the scene, in which the contestant was put.
                    raise ValueError(
                        f"'{spec.text}': {PLACE.sub('', session.message(error)).removeprefix(': ')}"
                    ) from None
        width, height = opened.sensor().film().crop_size()
        if min(width, height) < SSIM_WINDOW:
            smallest = f"{SSIM_WINDOW} x {SSIM_WINDOW}"
            raise InputError(f"{scene}: SSIM needs {smallest} pixels; the image has {width} x {height}.")
        output_files.check(stem, SUFFIXES, 2**23, [scene])
        cache = cache or runs.cache_folder()
        check_cache(cache, 2**4 * 3 * width * height)
        effort = comparison.Effort(levels, rounds, reference_seconds, cache, job.denoise)
        compared = comparison.Comparison(opened, scene.name, *specs, effort, job.exposure or 0.0)
        with Progress("comparing") as bar:
            for step, done in compared.run():
                bar.show(done, step)
    texts = comparison_page.html(compared.facts, compared.images), comparison_page.json_text(compared.facts)
    written = output_files.save(stem, {suffix: text.encode("utf-8") for suffix, text in zip(SUFFIXES, texts)})
    click.echo(summary(compared.facts))
    click.echo(" and ".join(map(str, written)))


def check_cache(folder: Path, size: int) -> None:
    """Raises InputError where references of ``size`` bytes can't be stored in ``folder``."""
    try:
        atomic.check([folder / "reference"], size)
    except OSError as error:
        why = output_files.reason(error)
        raise InputError(f"references can't be stored: {why}. Give another folder by --cache") from None


def summary(facts: Mapping[str, Any]) -> str:
    """The main result in a few lines."""
    section = facts["sections"][0]
    lines = [
        f"Every row follows {LIGHT[section['transport']]}; samples and times as near to equal as the samplers allow:"
    ]
    labels = [row["name"] + row["role"][1:] for row in section["rows"]]
    for label, row in zip(labels, section["rows"]):
        lines.append(
            f"{label:<{max(map(len, labels))}} {row['samples']:7.1f} samples  {row['seconds']['median']:7.3f} s  "
            f"RMSE {row['rmse']['median']:.5f}  FLIP {row['flip']['median']:.4f}"
        )
    return "\n".join(lines)
