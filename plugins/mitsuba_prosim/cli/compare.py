"""``prosim compare``: a scene under two integrators or samplers, as a page with every measure."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import mitsuba as mi
from prosim_scene import extras

from .. import atomic
from ..scene import session
from ..scene.errors import with_nearest
from . import output as files
from .image import check_denoising
from .input_files import SceneFile
from .job import Job, refuse_for_xml, takes_job
from .log import log
from .options import Command, Finite, InputError, Pattern, Whole, option, whole_numbers, wrong_input
from .progress import Progress, warn

SUFFIXES = (".html", ".json")


def levels(text: str) -> tuple[int, ...]:
    """Whole numbers, in ascending order. Raises ValueError where they are less than two."""
    numbers = sorted(set(whole_numbers(text, ",")))
    if len(numbers) < 2 or numbers[0] < 1:
        raise ValueError
    return tuple(numbers)


@click.command(cls=Command)
@click.argument("scene", type=SceneFile())
@click.argument("a", default="prosim")
@click.argument("b", default="path:multijitter")
@takes_job(
    "noise",
    "denoise",
    "output",
    "exposure",
    "definitions",
    "resolution",
    "allow_outside",
    "mode",
    "samples",
    "light_units",
    "tolerance",
)
@option("Comparison", "--rounds", type=Whole(min=1), default=5, help="Measured runs of each; medians are shown.")
@option(
    "Comparison",
    "--levels",
    type=Pattern("N,N,...", "2,3,4", levels),
    default="2,3,4,6,9",
    help="Square roots of the sample counts of the curves.",
)
@option(
    "Comparison",
    "--reference-seconds",
    type=Finite("seconds", low=0),
    default=60,
    help="Time for each reference; a cached one is continued.",
)
@option(
    "Comparison",
    "--cache",
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder of references. [default: mitsuba-prosim/references in the user's cache folder]",
)
def compare(
    job: Job, a: str, b: str, rounds: int, levels: tuple[int, ...], reference_seconds: float, cache: Path | None
) -> None:
    """Compare A and B on SCENE, in the thesis's language or XML: error, time, samples, and light left out.

    A and B are each INTEGRATOR[:SAMPLER][,PARAMETER=VALUE...], such as prosim,adaptive=none or
    path:multijitter,max_depth=5. B also renders with as many samples, and in as much time, as A; errors are against a
    converged reference. Where A is prosim and B is not, A renders both in B's transport of light and in the scene's.
    Without SAMPLER, it is the scene's. The page (.html) and its numbers (.json) are written beside the scene, as
    SCENE-compare.
    """
    if extras.missing("compare"):
        raise click.ClickException(extras.needs("prosim compare", "compare"))
    refuse_for_xml(job, "light_units", "tolerance", "allow_outside")
    scene, stem = Path(job.scene), files.default_stem(job.output, job.scene, SUFFIXES, "-compare")
    variant, noise, exposure = job.variant, job.integrator.get("noise"), job.exposure or 0.0
    if variant.startswith("scalar_") or not variant.endswith("_rgb"):
        raise click.ClickException(
            f"prosim compare can't use {variant}: it needs a variant that ends in _rgb and does not begin with scalar_."
        )

    from ..compare import page, scenes
    from ..compare.study import Effort, study

    with atomic.scratch() as folder, log(0):
        with wrong_input():
            specs = scenes.Spec(a), scenes.Spec(b)
            if noise:
                if not any(spec.is_adaptive for spec in specs):
                    raise ValueError(f"--noise is for prosim, and neither {a} nor {b} is")
                specs = specs[0].until(noise), specs[1].until(noise)
            mi.set_log_level(mi.LogLevel.Error)  # samplers that round their counts would warn: real counts are measured
            opened = scenes.Scene(replace(job, integrator={}).file(folder))
            if job.denoise:
                check_denoising(opened.sensor().film())
            for spec in specs:  # whatever is wrong with them shows before the long work
                try:
                    opened.contestant(spec, spec.transport or "scene", spp=4)
                except RuntimeError as error:
                    raise ValueError(
                        scenes.unknown_parameter(spec, error) or with_nearest(session.message(error))
                    ) from None
        width, height = opened.sensor().film().crop_size()
        if min(width, height) < 7:
            raise InputError(f"{scene}: {width} x {height} pixels are too few for SSIM; 7 x 7 or more are needed.")
        files.check(scene, stem, SUFFIXES, 2**23)
        cache = place_of_references(cache, folder, 2**4 * 3 * width * height)
        with Progress("comparing") as bar:
            tell = lambda doing, done: bar.show(done, doing)  # noqa: E731
            effort = Effort(levels, rounds, reference_seconds, cache, job.denoise, tell)
            facts, images = study(opened, scene.name, *specs, effort, exposure)
    texts = page.html(facts, images), page.json_text(facts)
    written = files.save(stem, {suffix: text.encode("utf-8") for suffix, text in zip(SUFFIXES, texts)})
    click.echo(summary(facts))
    click.echo(" and ".join(map(str, written)))


def place_of_references(asked: Path | None, scratch: Path, size: int) -> Path:
    """The folder for references of ``size`` bytes: ``asked``, or the user's; where that can't be written to,
    ``scratch``, and a warning says so. Raises InputError where it was asked for.
    """
    from ..compare import runs

    place = asked or runs.cache_folder()
    try:
        atomic.check([place / "reference"], size)
    except OSError as error:
        if asked:
            raise InputError(f"--cache: references can't be kept there: {files.said(error)}") from None
        warn(f"references are not kept: {files.said(error)}. --cache names another folder for them")
        return scratch
    return place


def summary(facts: Mapping[str, Any]) -> str:
    """The main result in a few lines."""
    section = facts["sections"][0]
    light = {
        "paths": "every path of light, without the ambient term",
        "direct": "direct light alone",
        "scene": "the light that the scene asks for",
    }[section["transport"]]
    lines = [f"All in {light}; samples and times as near to equal as the samplers allow:"]
    labels = [row["name"] + row["role"][1:] for row in section["rows"]]
    for label, row in zip(labels, section["rows"]):
        lines.append(
            f"{label:<{max(map(len, labels))}} {row['samples']:7.1f} samples  {row['seconds']['median']:7.3f} s  "
            f"RMSE {row['rmse']['median']:.5f}  FLIP {row['flip']['median']:.4f}"
        )
    return "\n".join(lines)
