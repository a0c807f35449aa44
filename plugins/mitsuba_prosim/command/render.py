"""``prosim render``: a scene file in, an EXR and a PNG image out."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from time import perf_counter
from typing import Any

import click
import mitsuba as mi
from tqdm.auto import tqdm

from ..rendering.policies import POLICIES
from ..scene_files import images, opening, rendering, session, writing
from . import denoised, reached
from . import output as files
from .interrupts import interruptible
from .log import log
from .options import SCENE, STOPS, Crop, Finite, InputError, choose_variant, defines, translation, wrong_input

SUFFIXES = (".exr", ".png")

#: More than any machine has processors.
MOST_THREADS = 1024


@click.command()
@click.argument("scene", type=SCENE)
@click.option(
    "-o",
    "--output",
    metavar="PATH",
    show_default=False,
    help="Image to write, without or with the suffix .exr or .png: both are written; or a folder. "
    "[default: beside the scene, under its name]",
)
@click.option(
    "-m",
    "--mode",
    metavar="VARIANT",
    help="Mitsuba variant. [default: cuda_ad_rgb, metal_ad_rgb, llvm_ad_rgb or scalar_rgb, the first that "
    "this machine can run]",
    show_default=False,
)
@defines
@click.option("-s", "--sensor", type=click.IntRange(min=0), default=0, help="Which sensor of the scene.")
@click.option(
    "-t",
    "--threads",
    type=click.IntRange(1, MOST_THREADS),
    show_default=False,
    help="Number of threads. [default: all]",
)
@click.option("-v", "--verbose", count=True, help="Say more; twice: still more.")
@click.option(
    "--spp",
    type=click.IntRange(1, 2**24),
    help="Samples per pixel, as Mitsuba counts them, instead of --samples. [default: what the scene says]",
    show_default=False,
)
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=0, help="Seed of the samples.")
@click.option(
    "--crop",
    type=Crop(),
    help="Render only this window of the image, in pixels; the highlights of its PNG are compressed by what is in it.",
)
@click.option(
    "--paths",
    is_flag=True,
    help="Follow every path of light, diffuse reflections included, in place of the ambient term.",
)
@click.option(
    "--max-level",
    type=click.IntRange(-1, 2**16),
    show_default=False,
    help="Deepest level of reflected and refracted rays; -1, with --paths: any. "
    "[default: what the scene says; with --paths: -1]",
)
@click.option(
    "--threshold",
    type=Finite(min=0),
    show_default=False,
    help="Noise of a pixel that is small enough, white being 1; smaller takes longer. [default: what the scene says]",
)
@click.option(
    "--noise",
    type=Finite(min=0, min_open=True),
    show_default=False,
    help="Render until the error of the displayed pixels, its root mean square, is so small, white being 1: 0.02 is "
    "rough, 0.005 is good.",
)
@click.option(
    "--time",
    type=Finite(min=0, min_open=True),
    metavar="SECONDS",
    show_default=False,
    help="Render for so long; with --noise: at most.",
)
@click.option(
    "--max-samples",
    type=click.IntRange(1, 2**20),
    show_default=False,
    help="Most samples that a pixel may get. [default: what the scene says; with --noise or --time: any number]",
)
@click.option(
    "--adaptive",
    type=click.Choice(tuple(POLICIES)),
    show_default=False,
    help="Which pixels get how many samples. [default: what the scene says; with --noise or --time: graded, which "
    "makes the most of them]",
)
@click.option(
    "--exposure",
    type=Finite(-STOPS, STOPS),
    default=0.0,
    metavar="STOPS",
    help="Makes the PNG brighter by so many factors of two; negative: darker.",
)
@click.option(
    "--denoise",
    is_flag=True,
    help="Denoise the image, as far as two halves of its samples agree that this makes it better. The raw image is a "
    "layer of the EXR.",
)
@translation
def render(
    scene: Path,
    output: str | None,
    mode: str | None,
    definitions: tuple[tuple[str, str], ...],
    sensor: int,
    threads: int | None,
    verbose: int,
    spp: int | None,
    seed: int,
    crop: tuple[int, int, int, int] | None,
    paths: bool,
    max_level: int | None,
    threshold: float | None,
    noise: float | None,
    time: float | None,
    max_samples: int | None,
    adaptive: str | None,
    exposure: float,
    denoise: bool,
    resolution: tuple[int, int] | None,
    samples: int | None,
    **language: Any,
) -> None:
    """Render SCENE, a file in the thesis's scene language (any name) or a Mitsuba scene (.xml).

    Writes a linear EXR (with how it was made as metadata) and a tone-mapped PNG. Existing files are replaced when the
    new ones are complete. Ctrl-C ends the render and keeps the image so far.
    """
    if spp and samples:
        raise click.UsageError("--spp and --samples both say how many samples a pixel gets; give one of them.")
    stem = files.stem(output, scene.with_name(scene.stem), SUFFIXES)
    asked = sampling(threshold, noise, time, max_samples, adaptive)
    variant = choose_variant(mode)
    options = {"--noise": noise, "--time": time, "--max-samples": max_samples, "--adaptive": adaptive}
    refuse_waves((option for option, value in options.items() if value is not None), variant)
    with log(verbose), session.threads(threads):
        with writing.scratch() as folder, wrong_input():
            file = opening.SceneFile(
                scene,
                folder,
                definitions=dict(definitions),
                resolution=resolution,
                crop=crop,
                samples=samples,
                integrator=parameters(paths, max_level) | asked,
                **language,
            )
            loaded = file.load()
            chosen = opening.pick_sensor(loaded, sensor)
        width, height = chosen.film().crop_size()
        integrator = loaded.integrator()
        refuse_waves((name for name in ("noise", "time") if getattr(integrator, name, 0)), variant)
        if denoise:
            denoised.check(chosen.film())
        # Four channels of 32 bits and what else there is, and three bytes of the PNG.
        others = len(integrator.aov_names()) + 9 * denoise
        files.check(scene, stem, SUFFIXES, int(width * height) * (19 + 4 * others) + 2**16)

        start = perf_counter()
        with interruptible(integrator.cancel) as signals:
            try:
                with progress_bar(integrator, variant) as tell:
                    if denoise:
                        picture = denoised.render(loaded, chosen, seed, spp or 0, tell, lambda: bool(signals))
                    else:
                        rendering.render(loaded, chosen, seed, spp or 0, tell)
                        picture = denoised.Picture(chosen.film().bitmap())
            except (RuntimeError, MemoryError) as error:
                raise click.ClickException(f"the scene could not be rendered: {session.message(error)}") from None
            seconds, interrupted = perf_counter() - start, bool(signals)
            facts = reached.facts(integrator, interrupted) | {
                "prosim.scene": str(scene),
                "prosim.version": version("mitsuba-prosim"),
                "prosim.variant": variant,
                "prosim.integrator": str(integrator),
                "prosim.seed": str(seed),
                "prosim.seconds": f"{seconds:.3f}",
            }
            facts |= picture.facts
            written = files.save(stem, images.encode(picture.bitmap, facts, exposure, picture.facts))
    click.echo(
        f"{' and '.join(map(str, written))}: {width} x {height} pixels, {variant}, {seconds:.2f} s"
        + (f", {file.wrapped} within prosim_adaptive" if file.wrapped else "")
        + (", interrupted" if interrupted else "")
    )
    if said := reached.sentence(integrator, interrupted):
        click.echo(said)
    if picture.said:
        click.echo(picture.said)
    if interrupted:
        sys.exit(1)


def parameters(paths: bool, max_level: int | None) -> dict[str, Any]:
    """Parameters of the ``prosim`` integrator that the options ask for; None takes one away."""
    result: dict[str, Any] = {"diffuse_bounces": -1, "max_level": -1, "ambient": None} if paths else {}
    return result | ({} if max_level is None else {"max_level": max_level})


def sampling(
    threshold: float | None, noise: float | None, time: float | None, max_samples: int | None, adaptive: str | None
) -> dict[str, Any]:
    """Parameters of ``prosim`` and ``prosim_adaptive`` that the options ask for."""
    if (noise or time) and adaptive is None:
        adaptive = "graded"
    if (noise or time) and adaptive == "thesis":
        raise click.UsageError(
            "--adaptive thesis ends each pixel by its own samples, N to N*N, and knows neither --noise nor --time; "
            "leave them out, or take another policy."
        )
    asked = {"threshold": threshold, "noise": noise, "time": time, "max_samples": max_samples, "adaptive": adaptive}
    return {name: value for name, value in asked.items() if value is not None}


def refuse_waves(names: Iterable[str], variant: str) -> None:
    """Raises InputError where something of these names was asked of a scalar variant, which knows no waves."""
    if variant.startswith("scalar_") and (names := list(names)):
        raise InputError(
            f"{', '.join(names)}: {variant} finishes one pixel after the other, each with the samples of the scene's "
            "sampler, and can't go by what the whole image has come to. Take a variant that can, such as -m "
            "llvm_ad_rgb (prosim doctor says which this machine can run), or say --spp instead."
        )


@contextmanager
def progress_bar(integrator: mi.Integrator, variant: str) -> Iterator[Callable[[float], None] | None]:
    """Shows how far a render is, with the time left, if the integrator tells and a person watches.

    Yields the function to be told the part done, 0 to 1, or None.
    """
    told = rendering.tells_progress(integrator)
    form = "{l_bar}{bar}| {elapsed}" if told else "{desc}"
    # The first step comes when the kernels are compiled and a part is rendered.
    doing = "compiling kernels" if told and not variant.startswith("scalar") else "rendering"
    with tqdm(desc=doing, total=100, unit="%", bar_format=form, disable=None, file=sys.stderr, leave=False) as bar:

        def tell(done: float) -> None:
            bar.set_description_str("rendering", refresh=False)
            if done > 0.01:  # before, nobody knows
                bar.bar_format = form + ", {remaining} left"
            bar.update(max(100 * done - bar.n, 0))  # an estimate that has become worse is not shown

        yield tell if told else None
