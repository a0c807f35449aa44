"""``prosim watch``: shows a scene on a page in the browser, and renders the scene again when its file is saved."""

import os
import socket
import sys
import webbrowser
from pathlib import Path
from typing import Any

import click
from prosim_scene import TranslationCache

from .. import atomic
from ..explaining.verdict import end_cause
from ..scene import images, session
from .job import OPTIONS, Command, Job, job_options, refuse_scalar
from .option_types import SCENE_FILE, Integer, option, require_extra
from .render_task import metadata
from .terminal import interruptible, log

#: Options of prosim render that prosim watch does not have: options for output files, other processes, and animations.
LEFT_OUT = ("output", "exposure", "checkpoint", "snapshots", "crop", "workers", "cluster", "part", "frames")


@click.command(cls=Command)
@click.argument("scene", type=SCENE_FILE)
@job_options(*(name for name in OPTIONS if name not in LEFT_OUT))
@option("Page", "--port", type=Integer(0, 65535), default=0, help="Port of the page; 0: any free port.")
@option("Page", "--browser/--no-browser", default=True, help="Open the page in a browser, or only print its address.")
def watch(job: Job, port: int, browser: bool) -> None:
    """Show SCENE on a page in the browser, and render SCENE again when its file is saved.

    Only this machine can open the page; the command prints the address of the page, which contains a secret. The
    command writes no image files: to save an image, click Save on the page. Without --allow-outside, SCENE can use only
    files in the folder of SCENE. Ctrl-C ends the command.
    """
    require_extra("watch", "prosim watch")
    from ..live import loaded_scene, server, viewer
    from .mix import factors_in_words

    refuse_scalar("prosim watch", job.variant)
    if job.denoise:
        require_extra("denoise", "--denoise")
    try:
        sock = socket.create_server(("127.0.0.1", port))
    except OSError as error:
        raise click.ClickException(
            f"port {port}: {error.strerror}. Give another port by --port, or leave out --port for any free port."
        ) from None
    with atomic.scratch() as folder:
        cache = TranslationCache()

        def open_scene() -> loaded_scene.LoadedScene:
            file = job.read_scene(folder, cache=cache, confined=not job.allow_outside)
            return loaded_scene.LoadedScene(file, job.sensor)

        view = viewer.Viewer(Path(job.scene), open_scene, job.spp or 0, job.seed, job.denoise)

        def encode(exposure: float, factors: Any) -> dict[str, bytes]:
            state, bitmap, image, reached = view.result(factors)
            ended = end_cause(image.render, state.status != "done")
            facts = metadata(job, image.integrator, reached, ended, state.seconds)
            if factors:
                lamps = {name.partition(".")[2]: factor for name, factor in factors.items()}
                facts["prosim.mix"] = factors_in_words(lamps)
            return images.encode(bitmap, facts, exposure)

        with server.served(view, encode, sock) as address:
            click.echo(f"{job.scene} is shown at {address} (Ctrl-C ends it)")
            if browser and has_windows():
                webbrowser.open(address)
            with log(job.verbose, folder), session.threads(job.threads), interruptible(view.close):
                view.run()


def has_windows() -> bool:
    """Tells whether a browser opens in its own window, not as a text browser in the terminal."""
    return sys.platform in ("darwin", "win32") or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))
