"""``prosim link``: lets the ``mitsuba`` command run plugins that are written in Python."""

import sys

import click

from . import stand_ins


@click.command()
@click.option("--remove", is_flag=True, help="Remove the stand-ins.")
def link(remove: bool) -> None:
    """Let the `mitsuba` command run plugins that are written in Python.

    Writes a stand-in for each plugin of every installed package (this one, and Mitsuba's own prb and the like) to
    Mitsuba's folder of plugins. Needs Linux and a C compiler. Run it once after each installation of a package with
    plugins. Uninstalling removes the stand-ins.
    """
    if sys.platform != "linux":
        raise click.ClickException("the stand-ins exist for Linux only; use prosim render.")
    folder = stand_ins.plugin_folder()
    try:
        if remove:
            paths = list(stand_ins.installed().values())
            for path in paths:
                path.unlink()
            click.echo(f"{len(paths)} stand-ins removed from {folder}")
        else:
            paths = stand_ins.install(stand_ins.plugin_names(), folder)
            stand_ins.record(paths)
            click.echo(f"{len(paths)} stand-ins in {folder}: {', '.join(path.stem for path in paths)}")
    except (RuntimeError, OSError) as error:
        raise click.ClickException(str(error)) from None
