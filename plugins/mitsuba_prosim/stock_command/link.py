"""The command ``prosim link``: lets the script ``mitsuba`` ask the module ``launcher``."""

from importlib.metadata import distributions
from pathlib import Path

import click
import prosim_scene

#: What the script imports, and what it imports after ``prosim link``.
THEIRS = "from mitsuba.cli import _main"
OURS = f"""try:
    from mitsuba_prosim.stock_command.launcher import _main
except ImportError:  # mitsuba-prosim was uninstalled
    {THEIRS}"""


def script() -> Path | None:
    """Returns the script ``mitsuba``; None if the command is a program of another kind, as on Windows."""
    named = (file for one in distributions(name="mitsuba") for file in one.files or () if file.name == "mitsuba")
    paths = filter(Path.is_file, (Path(file.locate()).resolve() for file in named))
    return next((path for path in paths if THEIRS.encode() in path.read_bytes()), None)


def is_linked() -> bool:
    """Tells whether the command ``mitsuba`` runs plugins in Python."""
    path = script()
    return path is not None and OURS in path.read_text("utf-8")


@click.command()
@click.option("--remove", is_flag=True, help="Let the command be as before.")
def link(remove: bool) -> None:
    """Let the `mitsuba` command run plugins that are written in Python.

    The command adds three lines to the script `mitsuba` that pip has installed. Then plugins in Python of Mitsuba (such
    as prb) and of all installed packages work. Run `prosim link` once after each installation of Mitsuba.
    """
    path = script()
    if path is None:
        raise click.ClickException("the mitsuba command of this machine is not a script by pip; use prosim render.")
    text = path.read_text("utf-8").replace(OURS, THEIRS)
    try:
        prosim_scene.rewrite(path, text if remove else text.replace(THEIRS, OURS))
    except prosim_scene.SceneError as error:  # the file could not be written
        raise click.ClickException(str(error)) from None
    click.echo(f"{path} {'is as before' if remove else 'runs plugins in Python'}")
