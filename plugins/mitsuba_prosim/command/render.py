"""``prosim render``: a scene file in, an EXR and a PNG image out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ..engine.part import Part
from . import film, tev
from . import output as files
from .arguments import SCENE
from .frames import Frames
from .job import Job
from .making import SUFFIXES, make, refuse_waves
from .options import STOPS, Crop, Finite, Helpers, Share, Whole, choose_variant, defines, helped, running, translation
from .sampled import one_of, parameters, sampled, sampling


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
@click.option("-s", "--sensor", type=Whole(min=0), default=0, help="Which sensor of the scene.")
@running
@sampled
@click.option(
    "--crop",
    type=Crop(),
    help="Render only this window of the image, in pixels; the highlights of its PNG are compressed by what is in it.",
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
@click.option(
    "--keep",
    is_flag=True,
    help="Write the state beside the image, as NAME.state.exr, from time to time and at the end: prosim resume goes on "
    "with it, whatever has ended this render.",
)
@click.option(
    "--part",
    type=Share(),
    show_default=False,
    help="Render only part K of M, of which NAME.K-of-M.exr is written, from time to time and at the end: prosim merge "
    "makes the image of all.",
)
@click.option(
    "--frames",
    type=Frames(),
    show_default=False,
    help="Render a film: images NAME.0000, ..., one for each value of $frame in the scene. 0:48 are frames 0 to 47, 7 "
    "is frame 7 alone. Those that are there already are left.",
)
@click.option(
    "--fps",
    type=Finite(min=0, min_open=True),
    show_default=False,
    help="Frames a second, by which $time goes. [default: 24]",
)
@click.option(
    "--view",
    type=tev.Place(),
    show_default=False,
    help="tev: send the image to the viewer tev while it is rendered; tev=HOST:PORT where it does not listen at "
    f"{tev.HOST}:{tev.PORT}.",
)
@click.option("--anew", is_flag=True, help="Render frames anew that are there already.")
@helped
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
    caustics: bool | None,
    max_level: int | None,
    threshold: float | None,
    noise: float | None,
    noise_99: float | None,
    time: float | None,
    max_samples: int | None,
    adaptive: str | None,
    exposure: float,
    denoise: bool,
    keep: bool,
    part: Part | None,
    view: tuple[str, int] | None,
    frames: range | None,
    fps: float | None,
    anew: bool,
    resolution: tuple[int, int] | None,
    samples: int | None,
    helpers: Helpers | None,
    **language: Any,
) -> None:
    """Render SCENE, a file in the thesis's scene language (any name) or a Mitsuba scene (.xml).

    Writes a linear EXR (with how it was made as metadata) and a tone-mapped PNG. Existing files are replaced when the
    new ones are complete. Ctrl-C ends the render and keeps the image so far.
    """
    one_of(spp, samples)
    stem = files.stem(output, scene.with_name(scene.stem), SUFFIXES, scene)
    ends = {"noise": noise, "noise_99": noise_99, "time": time}
    if part and any(ends.values()):
        raise click.UsageError(
            "--noise and --time go by the whole image, of which a part knows nothing. Render the parts without them, "
            "with --adaptive none, then prosim merge --keep, and let the image go on: prosim resume NAME.state.exr "
            "--noise X --adaptive graded. Where machines can talk to each other, --cluster does it in one step."
        )
    if denoise and (keep or part):
        raise click.UsageError(
            "--denoise renders two images, and --keep and --part keep the state of one; give either."
        )
    if frames is None and (fps or anew):
        raise click.UsageError(f"{'--fps' if fps else '--anew'} is for films; say which --frames.")
    if frames is not None and (part or view):
        raise click.UsageError(
            "--part is for single images. A film is shared by giving each machine some of its --frames, such as 0:24 "
            "here and 24:48 there."
            if part
            else "--view is for single images. To see one frame: --frames 7 without it, or -D frame=7 with it."
        )
    asked = sampling(threshold, ends, max_samples, adaptive)
    variant = choose_variant(mode)
    options = ends | {"max_samples": max_samples, "adaptive": adaptive, "keep": keep or None, "part": part}
    named = (f"--{name.replace('_', '-')}" for name, value in options.items() if value is not None)
    refuse_waves(named, variant)
    job = Job(
        scene=str(scene),
        variant=variant,
        definitions=dict(definitions),
        sensor=sensor,
        seed=seed,
        spp=spp or 0,
        resolution=resolution,
        crop=crop,
        samples=samples,
        integrator=parameters(paths, max_level, caustics) | asked,
        language=language,
        exposure=exposure,
    )
    if frames is not None:
        film.render(job, stem, frames, fps, threads, verbose, keep, denoise, anew, helpers)
    else:
        kept = keep or part is not None
        make(job, stem, threads, verbose, keep=kept, part=part, denoise=denoise, helpers=helpers, view=view)
