"""``prosim translate`` and ``prosim format``: the scene language, to Mitsuba's or to its tidy form."""

import os
import sys
from pathlib import Path
from typing import Any

import click
import prosim_scene

from ..stock_command import stand_ins
from .input_files import LanguageFile
from .job import Job, takes_job
from .options import Command, InputError, option
from .output import KNOWN, expanded, refuse_folders


class Folder(click.Path):
    """A folder, to be made in one that is there if need be, whose name is not that of another kind of file."""

    def __init__(self):
        super().__init__(file_okay=False, path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The folder's path."""
        path = Path(os.fsdecode(super().convert(str(expanded(os.fsdecode(value))), param, ctx)))
        if KNOWN.fullmatch(path.suffix.lower()) and not path.exists():
            self.fail(f"'{path}': name the folder; the file in it is called after the scene.", param, ctx)
        refuse_folders(path)
        return path


@click.command(cls=Command)
@click.argument("scene", type=LanguageFile())
@takes_job("definitions", "resolution", "allow_outside", "samples", "light_units", "tolerance")
@option("Output", "-o", "--output", type=Folder(), help="Folder to write to. [default: the scene's]")
@option(
    "Output",
    "--target",
    type=click.Choice(["prosim", "stock"]),
    default="prosim",
    help="Plugins that the XML names: this package's, or only those that Mitsuba brings.",
)
@option("Output", "--check", is_flag=True, help="Write nothing; only print errors and warnings.")
def translate(job: Job, output: Path | None, target: str, check: bool) -> None:
    """Translate SCENE, in the thesis's scene language, to a Mitsuba scene (.xml) and its meshes (.ply)."""
    options: dict[str, Any] = {
        "target": target,
        "define": job.definitions,
        "resolution": job.resolution,
        "samples": job.samples,
        **job.language,
    }
    try:
        if check:
            prosim_scene.check(job.scene, **options)
            return
        click.echo(prosim_scene.translate(job.scene, output, **options))
    except prosim_scene.SceneError as error:
        raise InputError(str(error)) from None
    if target == "prosim" and sys.platform == "linux" and not stand_ins.installed():
        click.echo("prosim render can render this scene; for the mitsuba command, run once: prosim link", err=True)


@click.command("format")
@click.argument("scenes", type=LanguageFile(), nargs=-1, required=True)
@click.option("--check", is_flag=True, help="Write nothing; exit with 1 if a file is not tidy.")
def format_scene(scenes: tuple[Path, ...], check: bool) -> None:
    """Rewrite SCENES in the thesis's scene language in tidy form; what they mean stays the same."""
    tidy = {}
    for scene in scenes:
        try:
            before = prosim_scene.read(scene)
            after = prosim_scene.format(before, str(scene))
        except prosim_scene.SceneError as error:
            raise InputError(str(error)) from None
        if before != after:
            tidy[scene] = after
    for scene, text in tidy.items():
        if not check:
            try:
                prosim_scene.rewrite(scene, text)
            except prosim_scene.SceneError as error:
                raise click.ClickException(str(error)) from None
        click.echo(f"{scene}: {'not tidy' if check else 'tidied'}")
    if check and tidy:
        sys.exit(1)
