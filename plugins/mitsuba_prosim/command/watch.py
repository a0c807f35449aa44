"""``prosim watch``: a scene's picture on a local page, rendered anew whenever the scene is saved."""

from __future__ import annotations

import os
import sys
import webbrowser
from functools import partial
from pathlib import Path
from typing import Any

import click
from prosim_scene import Document, Kept

from ..denoising import oidn
from ..scene import atomic, images, session
from ..scene.scene_file import SceneFile
from .arguments import SCENE
from .developed import metadata
from .interrupts import interruptible
from .job import Job
from .log import log
from .making import refuse_waves
from .options import Whole, choose_variant, defines, running, translation
from .sampled import one_of, parameters, sampled, sampling


@click.command()
@click.argument("scene", type=SCENE)
@click.option(
    "-m",
    "--mode",
    metavar="VARIANT",
    help="Mitsuba variant, not a scalar one. [default: cuda_ad_rgb, metal_ad_rgb or llvm_ad_rgb, the first that this "
    "machine can run]",
    show_default=False,
)
@defines
@click.option("-s", "--sensor", type=Whole(min=0), default=0, help="Which sensor of the scene.")
@running
@click.option("--port", type=Whole(0, 65535), default=0, help="Port of the page on this machine; 0: any that is free.")
@click.option("--browser/--no-browser", default=True, help="Open the page in a browser, or only print its address.")
@sampled
@click.option(
    "--denoise",
    is_flag=True,
    help="Denoise the image in the end, as far as two halves of its samples agree that this makes it better.",
)
@partial(translation, of_xml=["allow_outside"])
def watch(
    scene: Path,
    mode: str | None,
    definitions: tuple[tuple[str, str], ...],
    sensor: int,
    threads: int | None,
    verbose: int,
    port: int,
    browser: bool,
    spp: int | None,
    seed: int,
    paths: bool,
    caustics: bool | None,
    max_level: int | None,
    threshold: float | None,
    noise: float | None,
    noise_99: float | None,
    time: float | None,
    max_samples: int | None,
    adaptive: str | None,
    denoise: bool,
    resolution: tuple[int, int] | None,
    samples: int | None,
    **language: Any,
) -> None:
    """Show the picture of SCENE on a page in the browser, and render it anew whenever the file is saved.

    The page is for this machine alone; its address, which has a secret in it, is printed. Nothing is written but what
    is saved there, and a scene of either kind can name files in its folder alone. Ctrl-C ends it.
    """
    one_of(spp, samples)
    try:
        from ..watch import changes, server, studio
    except ImportError as error:
        raise click.ClickException(
            f"the page needs {error.name}, which is not installed: pip install 'mitsuba-prosim[watch]'"
        ) from None
    ends = {"noise": noise, "noise_99": noise_99, "time": time}
    asked = sampling(threshold, ends, max_samples, adaptive)
    variant = choose_variant(mode)
    refuse_waves(["prosim watch"], variant)
    job = Job(
        scene=str(scene),
        variant=variant,
        definitions=dict(definitions),
        sensor=sensor,
        seed=seed,
        spp=spp or 0,
        resolution=resolution,
        crop=None,
        samples=samples,
        integrator=parameters(paths, max_level, caustics) | asked,
        language=language,
        exposure=0.0,
    )
    if denoise:
        try:
            oidn.load()
        except oidn.MissingError as error:
            raise click.ClickException(f"--denoise: {error}") from None
    try:
        sock = server.bound(port)
    except OSError as error:
        raise click.ClickException(
            f"port {port}: {error.strerror}. Choose another with --port, or leave it out for any that is free."
        ) from None
    with atomic.scratch() as folder:
        kept, confined = Kept(), not language["allow_outside"]

        def opened(document: Document | None = None) -> tuple[SceneFile, Any, Any]:
            return job.open(folder, kept, confined, document)

        shown = studio.Studio(scene, opened, job.spp, job.seed, denoise)

        def encode(exposure: float) -> dict[str, bytes]:
            state, bitmap, integrator = shown.result()
            facts = metadata(job, integrator, state.doing != "done", state.seconds)
            return images.encode(bitmap, facts, exposure)

        with server.served(shown, encode, sock) as address:
            click.echo(f"{scene} is shown at {address} (Ctrl-C ends it)")
            if browser and has_windows():
                webbrowser.open(address)
            with (
                log(verbose),
                session.threads(threads),
                changes.watched(shown.files.known, shown.desk.saved, shown.files.missing),
                interruptible(shown.desk.leave),
            ):
                shown.run()


def has_windows() -> bool:
    """Whether a browser would open a window: one in the terminal, at the other end of a tunnel for example, is no good
    for this page.
    """
    return sys.platform == "darwin" or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))
