"""``prosim watch``: a scene's picture on a local page, rendered anew whenever the scene is saved."""

from __future__ import annotations

import os
import sys
import webbrowser
from pathlib import Path
from typing import Any

import click
from prosim_scene import Document, Kept, extras

from .. import atomic
from ..denoising import oidn
from ..scene import images, scene_file, session
from .image import metadata
from .input_files import SceneFile
from .interrupts import interruptible
from .job import Job, refuse_for_xml, takes_job
from .log import log
from .options import OPTIONS, Command, Whole, option, refuse_waves

#: Options of files, films and other processes, which it has not.
LEFT_OUT = ("output", "exposure", "keep", "view", "crop", "frames", "fps", "overwrite", "workers", "cluster", "part")


@click.command(cls=Command)
@click.argument("scene", type=SceneFile())
@takes_job(*(name for name in OPTIONS if name not in LEFT_OUT))
@option("Page", "--port", type=Whole(0, 65535), default=0, help="Port of the page on this machine; 0: any free one.")
@option("Page", "--browser/--no-browser", default=True, help="Open the page in a browser, or only print its address.")
def watch(job: Job, port: int, browser: bool) -> None:
    """Show the picture of SCENE on a page in the browser, and render it again whenever the file is saved.

    The page is for this machine alone; its address, which has a secret in it, is printed. Nothing is written but what
    is saved there, and a scene of either kind can name files in its folder alone. Ctrl-C ends it.
    """
    if extras.missing("watch"):
        raise click.ClickException(extras.needs("prosim watch", "watch"))
    from ..live import server, viewer

    refuse_for_xml(job, "light_units", "tolerance")
    refuse_waves(["prosim watch"], job.variant)
    if job.denoise:
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
        kept, confined = Kept(), not job.language.get("allow_outside")

        def opened(document: Document | None = None) -> tuple[scene_file.SceneFile, Any, Any]:
            file = job.file(folder, kept=kept, confined=confined, document=document)
            scene = file.load()
            return file, scene, scene_file.pick_sensor(scene, job.sensor)

        shown = viewer.Viewer(Path(job.scene), opened, job.spp, job.seed, job.denoise)

        def encode(exposure: float) -> dict[str, bytes]:
            state, bitmap, integrator, reached = shown.result()
            facts = metadata(job, integrator, reached, state.doing != "done", state.seconds)
            return images.encode(bitmap, facts, exposure)

        with server.served(shown, encode, sock) as address:
            click.echo(f"{job.scene} is shown at {address} (Ctrl-C ends it)")
            if browser and has_windows():
                webbrowser.open(address)
            with (
                log(job.verbose),
                session.threads(job.threads),
                shown.files.watched(shown.requests.saved),
                interruptible(shown.requests.close),
            ):
                shown.run()


def has_windows() -> bool:
    """Whether a browser would open a window: one in the terminal, at the other end of a tunnel for example, is no good
    for this page.
    """
    return sys.platform in ("darwin", "win32") or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))
