"""``prosim link``: compiles, installs, finds and removes the stand-ins for plugins in Python (see ``stand_in.c``)."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterable
from functools import partial
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import click
import mitsuba as mi

from .. import atomic, registry
from ..compat import PLUGINS_IN_PYTHON
from ..scene import session

SOURCE = Path(__file__).with_name("stand_in.c")

#: Marks the stand-ins of all versions.
MARK = b"mitsuba-prosim stand-in for a Python plugin"


def plugin_folder() -> Path:
    """Mitsuba's folder of plugins."""
    return Path(mi.__file__).with_name("plugins")


def is_stand_in(path: Path) -> bool:
    """Whether a file is a stand-in, not a plugin of Mitsuba's."""
    return path.stat().st_size < 2**16 and MARK in path.read_bytes()


def installed() -> dict[str, Path]:
    """Plugin name -> path, of every stand-in in Mitsuba's folder."""
    return {path.stem: path for path in plugin_folder().glob("*.so") if is_stand_in(path)}


def plugin_names() -> list[str]:
    """Names of the plugins in Python: those that the installed packages register, and Mitsuba's own."""
    mi.set_variant("scalar_rgb")
    names = {*PLUGINS_IN_PYTHON, *registry.PLUGINS}

    def record(register: Callable, name: str, *args: Any) -> Any:
        names.add(name)
        return register(name, *args)

    for attribute in [a for a in dir(mi) if a.startswith("register_")]:
        setattr(mi, attribute, partial(record, getattr(mi, attribute)))
    session.load_plugins()
    return sorted(names)


def compiler() -> list[str]:
    """The command line of the C compiler."""
    return (os.environ.get("CC") or "cc").split()


def compile_stand_in(path: Path) -> None:
    """Compiles a stand-in that starts this interpreter. Raises RuntimeError where that fails."""
    command = [*compiler(), "-O2", "-shared", "-fPIC", "-fvisibility=hidden", "-s", f'-DPYTHON="{sys.executable}"']
    try:
        subprocess.run([*command, "-o", str(path), str(SOURCE)], check=True, capture_output=True, text=True)
    except (OSError, subprocess.CalledProcessError) as error:
        why = getattr(error, "stderr", None) or error
        advice = "install one (on Debian and Ubuntu: apt install gcc libc6-dev), or name it by the variable CC"
        raise RuntimeError(f"the C compiler failed: {why}; {advice}") from None


def install(names: Iterable[str], folder: Path) -> list[Path]:
    """Writes a stand-in for each name to ``folder``, but for those of native plugins; returns their paths.

    Raises RuntimeError and OSError.
    """
    paths = [path for name in names if not (path := folder / f"{name}.so").exists() or is_stand_in(path)]
    with atomic.scratch() as scratch:
        compile_stand_in(scratch / "stand_in.so")
        return atomic.write(dict.fromkeys(paths, (scratch / "stand_in.so").read_bytes()))


def add_to_pip_record(paths: Iterable[Path]) -> None:
    """Adds files to those that pip removes together with this package: the lines of its file RECORD."""
    files = distribution("mitsuba-prosim").files or []
    listing = next(Path(str(file.locate())) for file in files if file.name == "RECORD")
    known = {file.as_posix() for file in files}
    new = [name for path in paths if (name := os.path.relpath(path, listing.parents[1])) not in known]
    with listing.open("a", encoding="utf-8") as file:
        file.writelines(f"{name},,\n" for name in new)


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
    folder = plugin_folder()
    try:
        if remove:
            paths = list(installed().values())
            for path in paths:
                path.unlink()
            click.echo(f"{len(paths)} stand-ins removed from {folder}")
        else:
            paths = install(plugin_names(), folder)
            add_to_pip_record(paths)
            click.echo(f"{len(paths)} stand-ins in {folder}: {', '.join(path.stem for path in paths)}")
    except (RuntimeError, OSError) as error:
        raise click.ClickException(str(error)) from None
