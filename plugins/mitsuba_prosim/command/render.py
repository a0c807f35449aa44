"""``prosim render``: a scene file in, an EXR and a PNG image out."""

from __future__ import annotations

import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any

import click
import mitsuba as mi
import prosim_scene
from tqdm.auto import tqdm

from ..scene_files import images, opening, rendering, session, writing
from .log import log
from .options import SCENE, Definition, InputError, Numbers, choose_variant, translation


@click.command()
@click.argument("scene", type=SCENE)
@click.option("-o", "--output", type=click.Path(path_type=Path),
              help="Image to write, without or with the suffix .exr or .png: both are written. "
                   "[default: beside the scene, under the NAME in it or else its own]", show_default=False)
@click.option("-m", "--mode", metavar="VARIANT",
              help="Mitsuba variant. [default: cuda_ad_rgb, metal_ad_rgb, llvm_ad_rgb or scalar_rgb, the first that "
                   "this machine can run]", show_default=False)
@click.option("-D", "--define", "definitions", type=Definition(), multiple=True,
              help="Constant that replaces $key in the XML scene. May be repeated.")
@click.option("-s", "--sensor", type=click.IntRange(min=0), default=0, help="Which sensor of the scene.")
@click.option("-t", "--threads", type=click.IntRange(min=1), show_default=False,
              help="Number of threads. [default: all]")
@click.option("-v", "--verbose", count=True, help="Say more; twice: still more.")
@click.option("--spp", type=click.IntRange(min=1), help="Samples per pixel, as Mitsuba counts them. "
              "[default: what the scene says]", show_default=False)
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=0, help="Seed of the samples.")
@click.option("--crop", type=Numbers("X,Y,W,H", ",", 4, least=0), help="Render only this window of the image, in pixels.")
@click.option("--exposure", type=float, default=0.0, metavar="STOPS",
              help="Makes the PNG brighter by so many factors of two; negative: darker.")
@translation
def render(scene: Path, output: Path | None, mode: str | None, definitions: tuple[tuple[str, str], ...], sensor: int,
           threads: int | None, verbose: int, spp: int | None, seed: int, crop: tuple[int, ...] | None, exposure: float,
           resolution: tuple[int, ...] | None, samples: int | None, **language: Any) -> None:
    """Render SCENE, a file in the thesis's scene language (any name) or a Mitsuba scene (.xml).

    Writes a linear EXR (with how it was made as metadata) and a tone-mapped PNG. Existing files are replaced when the
    new ones are complete. Ctrl-C ends the render and keeps the image so far.
    """
    choose_variant(mode)
    with tempfile.TemporaryDirectory(prefix="prosim-") as folder, log(verbose), session.threads(threads):
        try:
            stem = image_stem(scene, output)
            loaded = opening.SceneFile(scene, folder, definitions=dict(definitions), resolution=resolution, crop=crop,
                                       samples=samples, **language).load()
            chosen = opening.pick_sensor(loaded, sensor)
        except prosim_scene.SceneError as error:
            raise InputError(str(error)) from None
        except (RuntimeError, TypeError, ValueError) as error:
            raise InputError(session.message(error)) from None

        integrator, start = loaded.integrator(), time.perf_counter()
        with progress_bar(integrator) as tell, interruptible(integrator) as interrupted:
            rendering.render(loaded, chosen, seed, spp or 0, tell)
        seconds = time.perf_counter() - start

    facts = {"prosim.scene": str(scene), "prosim.version": version("mitsuba-prosim"), "prosim.variant": mi.variant(),
             "prosim.integrator": str(integrator), "prosim.seed": str(seed), "prosim.seconds": f"{seconds:.3f}"}
    try:
        encoded = images.encode(chosen.film().bitmap(), facts, exposure)
        written = writing.write({stem.with_name(stem.name + suffix): image for suffix, image in encoded.items()})
    except (RuntimeError, OSError) as error:
        raise click.ClickException(f"the image could not be written: {error}") from None
    width, height = chosen.film().crop_size()
    click.echo(f"{' and '.join(map(str, written))}: {width} x {height} pixels, {mi.variant()}, {seconds:.2f} s"
               + (", interrupted" if interrupted else ""))
    if interrupted:
        sys.exit(1)


def image_stem(scene: Path, output: Path | None) -> Path:
    """Path of the images without suffix: the output's, or the name that the scene gives itself, beside the scene."""
    if output:
        return output.with_suffix("") if output.suffix.lower() in (".exr", ".png") else output
    if scene.suffix.lower() == ".xml":
        return scene.with_suffix("")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the translation gives them again
        name = prosim_scene.parse(prosim_scene.read(scene), scene).name
    return scene.with_name(Path(name).name or scene.stem)


@contextmanager
def progress_bar(integrator: mi.Integrator) -> Iterator[Callable[[float], None] | None]:
    """Shows how far a render is, with the time left, if the integrator tells and a person watches.

    Yields the function to be told the part done, 0 to 1, or None.
    """
    if not rendering.tells_progress(integrator):
        yield None
        return
    with tqdm(total=100, unit="%", bar_format="{l_bar}{bar}| {elapsed}, {remaining} left", disable=None,
              file=sys.stderr, leave=False) as bar:
        yield lambda done: bar.update(100 * done - bar.n)


@contextmanager
def interruptible(integrator: mi.Integrator) -> Iterator[list[bool]]:
    """Lets the first Ctrl-C end the render, so that the film keeps what it has; yields a list, empty until then."""
    seen = []

    def stop(*_):
        seen.append(True)
        integrator.cancel()
        signal.signal(signal.SIGINT, before)

    before = signal.signal(signal.SIGINT, stop)
    try:
        yield seen
    finally:
        signal.signal(signal.SIGINT, before)
