"""``prosim translate`` and ``prosim format``: translate and format scenes in the scene language."""

import sys
from pathlib import Path
from typing import Any

import click
import prosim_scene

from ..stock_command.link import is_linked, script
from .files import FOREIGN
from .job import Command, Job, job_options
from .option_types import LANGUAGE_FILE, input_errors, option

TARGETS = click.Choice(["prosim", "stock"])


@click.command(cls=Command)
@click.argument("scene", type=LANGUAGE_FILE)
@job_options("definitions", "resolution", "allow_outside", "samples", "light_units", "tolerance")
@option(
    "Output", "-o", "--output", type=click.Path(file_okay=False), help="Folder to write to.", show_default="the scene's"
)
@option(
    "Output", "--target", type=TARGETS, default="prosim", help="Plugins in the XML: this package's, or only Mitsuba's."
)
@option("Output", "--check", is_flag=True, help="Write nothing; only print errors and warnings.")
def translate(job: Job, target: str, check: bool) -> None:
    """Translate SCENE, in the thesis's scene language, to a Mitsuba scene (.xml) and its meshes (.ply)."""
    folder = None if job.output is None else Path(job.output).expanduser()
    if folder and (folder.name == "-" or FOREIGN.fullmatch(folder.suffix.lower())) and not folder.is_dir():
        raise click.BadParameter(f"'{folder}': give a folder; its files get the scene's name.", param_hint="-o")
    options: dict[str, Any] = {"define": job.definitions, "resolution": job.resolution, "samples": job.samples}
    options |= job.language | {"target": target}
    with input_errors():
        if check:
            prosim_scene.check(job.scene, **options)
            return
        click.echo(prosim_scene.translate(job.scene, folder, **options))
    if target == "prosim" and script() and not is_linked():
        click.echo("Render it by prosim render; for the mitsuba command, run once: prosim link", err=True)


@click.command("format")
@click.argument("scenes", type=LANGUAGE_FILE, nargs=-1, required=True)
@click.option("--check", is_flag=True, help="Write nothing; exit with 1 if a layout is not canonical.")
def format_scene(scenes: tuple[Path, ...], check: bool) -> None:
    """Rewrite SCENES, in the thesis's scene language, in canonical layout; words and numbers stay as they are."""
    untidy = {}
    for scene in scenes:
        with input_errors():
            text = prosim_scene.read(scene)
            tidy = prosim_scene.format(text, str(scene))
        if text != tidy:
            untidy[scene] = tidy
    for scene, tidy in untidy.items():
        if not check:
            try:
                prosim_scene.rewrite(scene, tidy)
            except prosim_scene.SceneError as error:  # the file could not be written
                raise click.ClickException(str(error)) from None
        name = f"{scene}, a link to {scene.resolve()}" if scene.is_symlink() else scene
        click.echo(f"{name}: {'not tidy' if check else 'tidied'}")
    sys.exit(bool(check and untidy))
