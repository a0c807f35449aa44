"""``prosim compare``: a scene under two integrators or samplers, as a page with every measure."""

import importlib.util
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
import mitsuba as mi
from tqdm.auto import tqdm

from ..scene import atomic, scene_file, session
from . import denoised
from . import output as files
from .arguments import SCENE
from .lines import Steps
from .log import log
from .making import warn
from .options import STOPS, Finite, InputError, Whole, choose_variant, defines, translation, wrong_input

SUFFIXES = (".html", ".json", ".csv")


class Levels(click.ParamType):
    """Whole numbers separated by commas."""

    name = "N,N,..."

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, ...]:
        """The numbers, in ascending order."""
        try:
            levels = tuple(int(word) for word in value.split(",")) if isinstance(value, str) else value
        except ValueError:
            levels = ()
        if len(set(levels)) < 2 or min(levels) < 1:
            self.fail(f"{value!r} is not of the form N,N,... (two or more)", param, ctx)
        return tuple(sorted(set(levels)))


#: Module -> package, of what this command alone needs.
NEEDED = {"matplotlib": "matplotlib", "skimage": "scikit-image", "flip_evaluator": "flip-evaluator", "jinja2": "jinja2"}


def missing_packages() -> list[str]:
    """Those of the packages that ``prosim compare`` needs which are not installed."""
    return [package for module, package in NEEDED.items() if importlib.util.find_spec(module) is None]


@click.command()
@click.argument("scene", type=SCENE)
@click.argument("a", default="prosim")
@click.argument("b", default="path:multijitter")
@click.option(
    "-o",
    "--output",
    metavar="PATH",
    show_default=False,
    help="Page to write; the numbers go beside it, with the suffixes .json and .csv; or a folder. "
    "[default: SCENE-compare.html beside the scene]",
)
@click.option(
    "-m",
    "--mode",
    metavar="VARIANT",
    show_default=False,
    help="Mitsuba variant. [default: cuda_ad_rgb, metal_ad_rgb or llvm_ad_rgb]",
)
@defines
@click.option(
    "--noise",
    type=Finite(min=0, min_open=True),
    show_default=False,
    help="Let prosim render until the error of the displayed pixels, its root mean square, is so small, white being "
    "1; what it then takes is what others get. [default: what the scene says]",
)
@click.option(
    "--denoise",
    is_flag=True,
    help="Show each contestant's image denoised as well, as prosim render --denoise does it, and count its time.",
)
@click.option("--rounds", type=Whole(min=1), default=5, help="Measured runs of each; medians are shown.")
@click.option("--levels", type=Levels(), default="2,3,4,6,9", help="Square roots of the sample counts of the curves.")
@click.option(
    "--reference-seconds",
    type=Finite(min=0),
    default=60,
    help="Time for each reference; one that is kept already is continued.",
)
@click.option(
    "--exposure",
    type=Finite(-STOPS, STOPS),
    default=0.0,
    metavar="STOPS",
    help="Makes everything that is measured and shown brighter by so many factors of two; negative: darker.",
)
@click.option(
    "--cache",
    type=click.Path(file_okay=False, path_type=Path),
    show_default=False,
    help="Folder that references are kept in. [default: mitsuba-prosim/references in the user's cache folder]",
)
@translation
def compare(
    scene: Path,
    a: str,
    b: str,
    output: str | None,
    mode: str | None,
    definitions: tuple[tuple[str, str], ...],
    noise: float | None,
    denoise: bool,
    rounds: int,
    levels: tuple[int, ...],
    reference_seconds: float,
    exposure: float,
    cache: Path | None,
    resolution: tuple[int, int] | None,
    samples: int | None,
    **language: Any,
) -> None:
    """Compare A and B on SCENE, in the thesis's language or XML: error, time, samples, and light left out.

    A and B are each INTEGRATOR[:SAMPLER][,PARAMETER=VALUE...], such as prosim,adaptive=none or
    path:multijitter,max_depth=5. B also renders with as many samples, and in as much time, as A; errors are against a
    converged reference. Where A is prosim and B is not, A renders both in B's transport of light and in the scene's.
    Without SAMPLER, it is the scene's.
    """
    if missing := missing_packages():
        raise click.ClickException(
            f"prosim compare needs {', '.join(missing)}. Run: pip install 'mitsuba-prosim[compare]'"
        )
    stem = files.stem(output, scene.with_name(scene.stem + "-compare"), SUFFIXES, scene)
    variant = choose_variant(mode)
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
                if not any(spec.counts_itself for spec in specs):
                    raise ValueError(f"--noise is for prosim, and neither {a} nor {b} is")
                specs = specs[0].until(noise), specs[1].until(noise)
            mi.set_log_level(mi.LogLevel.Error)  # samplers that round their counts would warn: real counts are measured
            opened = scenes.FileScene(
                scene_file.SceneFile(
                    scene, folder, definitions=dict(definitions), resolution=resolution, samples=samples, **language
                )
            )
            if denoise:
                denoised.check(opened.scene().sensors()[0].film())
            for spec in specs:  # whatever is wrong with them shows before the long work
                try:
                    opened.contestant(spec, spec.transport or "scene", spp=4)
                except RuntimeError as error:
                    raise ValueError(scenes.unknown(spec, error) or session.message(error)) from None
        width, height = opened.scene().sensors()[0].film().crop_size()
        if min(width, height) < 7:
            raise InputError(f"{scene}: {width} x {height} pixels are too few for SSIM; 7 x 7 or more are needed.")
        files.check(scene, stem, SUFFIXES, 2**23)
        cache = place_of_references(cache, folder, 2**4 * 3 * width * height)
        with tqdm(total=100, unit="%", bar_format=Steps.FORM, smoothing=0, disable=None, leave=False) as bar:
            effort = Effort(levels, rounds, reference_seconds, cache, denoise, Steps(bar))
            facts, images = study(opened, scene.name, *specs, effort, exposure)
    texts = page.html(facts, images), page.json_text(facts), page.csv_text(facts)
    written = list(map(str, files.save(stem, {suffix: text.encode("utf-8") for suffix, text in zip(SUFFIXES, texts)})))
    click.echo(summary(facts))
    click.echo(f"{', '.join(written[:-1])} and {written[-1]}")


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
