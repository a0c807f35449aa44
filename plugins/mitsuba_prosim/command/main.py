"""The ``prosim`` command and its parts."""

import warnings

import click
import prosim_scene

from .compare import compare
from .doctor import doctor
from .link import link
from .render import render
from .translate import format_scene, translate


@click.group(context_settings={"help_option_names": ["-h", "--help"], "show_default": True})
@click.version_option(None, "-V", "--version", package_name="mitsuba-prosim")
def main() -> None:
    """Stochastic ray tracing after Besuievsky (1992), in Mitsuba 3.

    Exit codes: 0 done; 2 wrong use or wrong input, nothing written; 1 anything else.
    """
    warnings.simplefilter("always", prosim_scene.SceneWarning)
    warnings.showwarning = lambda message, *_: click.echo(f"warning: {message}", err=True)


for command in (render, compare, translate, format_scene, doctor, link):
    main.add_command(command)
