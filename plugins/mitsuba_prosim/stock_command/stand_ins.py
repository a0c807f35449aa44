"""The command ``prosim link``: compiles, installs, finds and removes the stand-ins for plugins in Python
(``stand_in.c``).
"""

import os
import subprocess
import sys
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

import click
import mitsuba as mi

from .. import atomic, registry
from ..compat import PLUGINS_IN_PYTHON
from ..scene import session

SOURCE = Path(__file__).with_name("stand_in.c")

#: Text that identifies the stand-ins of all versions.
MARK = b"mitsuba-prosim stand-in for a Python plugin"


def plugin_folder() -> Path:
    """Returns Mitsuba's folder of plugins."""
    return Path(mi.__file__).with_name("plugins")


def is_stand_in(path: Path) -> bool:
    """Tells whether the file ``path`` is a stand-in, not a native plugin of Mitsuba."""
    return path.stat().st_size < 2**16 and MARK in path.read_bytes()


def installed() -> dict[str, Path]:
    """Returns all stand-ins in Mitsuba's folder of plugins: plugin name -> path."""
    return {path.stem: path for path in plugin_folder().glob("*.so") if is_stand_in(path)}


def plugin_names() -> list[str]:
    """Returns the names of the plugins in Python of Mitsuba and of installed packages, in the variant ``scalar_rgb``.

    The functions ``mi.register_...``, which packages call, are replaced for the rest of the process, to record the
    names.
    """
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
    """Returns the words of the command that starts the C compiler: the environment variable CC, or ``cc``."""
    return (os.environ.get("CC") or "cc").split()


def compile_stand_in(path: Path) -> None:
    """Compiles a stand-in that starts this Python interpreter. Raises RuntimeError if that fails."""
    command = [*compiler(), "-O2", "-shared", "-fPIC", "-fvisibility=hidden", "-s", f'-DPYTHON="{sys.executable}"']
    try:
        subprocess.run([*command, "-o", str(path), str(SOURCE)], check=True, capture_output=True, text=True)
    except (OSError, subprocess.CalledProcessError) as error:
        why = getattr(error, "stderr", None) or error
        advice = "install one (on Debian and Ubuntu: apt install gcc libc6-dev), or name it by the variable CC"
        raise RuntimeError(f"the C compiler failed: {why}; {advice}") from None


def install(names: Iterable[str], folder: Path) -> list[Path]:
    """Writes a stand-in for each of the ``names`` that no native plugin has to ``folder``; returns the paths.

    Raises RuntimeError if the compiler fails, and OSError if a file cannot be written.
    """
    paths = [path for name in names if not (path := folder / f"{name}.so").exists() or is_stand_in(path)]
    with atomic.scratch() as scratch:
        compile_stand_in(scratch / "stand_in.so")
        return atomic.write(dict.fromkeys(paths, (scratch / "stand_in.so").read_bytes()))


@click.command()
@click.option("--remove", is_flag=True, help="Remove the stand-ins.")
def link(remove: bool) -> None:
    """Let the `mitsuba` command run plugins that are written in Python.

    The command writes a stand-in, a small library that starts Python, to Mitsuba's folder of plugins. Each plugin in
    Python of Mitsuba (such as prb) and of all installed packages gets a stand-in. The command needs Linux and a C
    compiler. Run `prosim link` once after each installation of a package with plugins, and `prosim link --remove`
    before you uninstall mitsuba-prosim.
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
            click.echo(f"{len(paths)} stand-ins in {folder}: {', '.join(path.stem for path in paths)}")
    except (RuntimeError, OSError) as error:
        raise click.ClickException(str(error)) from None
