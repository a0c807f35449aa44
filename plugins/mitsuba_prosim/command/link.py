"""``prosim link``: the stand-ins by which the native ``mitsuba`` command finds plugins that are written in Python."""

import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import click
import mitsuba as mi

from .. import registry
from ..scene import session
from .stand_in import BUNDLED, compile_stand_in, is_stand_in, plugin_folder


def misplaced_folder() -> Path | None:
    """A folder ``mitsuba`` beside this package that is not Mitsuba, or None.

    It arises when the package is installed to another place than Mitsuba is (with ``pip install --user``, say), and
    keeps Mitsuba's launcher from finding its program.
    """
    folder = Path(str(distribution("mitsuba-prosim").locate_file("mitsuba")))
    return folder if folder.is_dir() and not (folder / "__init__.py").exists() else None


def remove_stand_ins(folder: Path) -> int:
    """Removes the stand-ins in a folder, and nothing else; returns how many."""
    present = [path for path in folder.glob("*.so") if is_stand_in(path)]
    for path in present:
        path.unlink()
    return len(present)


def plugin_names() -> list[str]:
    """Names of the plugins that the installed packages register, and of Mitsuba's own that are written in Python."""
    names = set(BUNDLED)
    mi.set_variant(session.default_variant())
    names.update(registry.PLUGINS)

    def recording(register: Callable) -> Callable:
        def record(name: str, *args: Any) -> Any:
            names.add(name)
            return register(name, *args)

        return record

    for attribute in [a for a in dir(mi) if a.startswith("register_")]:
        setattr(mi, attribute, recording(getattr(mi, attribute)))
    session.load_plugins()
    return sorted(names)


def record(paths: Iterable[Path]) -> None:
    """Adds files to the list of what pip removes when this package is uninstalled."""
    own = distribution("mitsuba-prosim")
    files = own.files or []
    listing = next(Path(str(file.locate())) for file in files if file.name == "RECORD")
    site = listing.parents[1]
    known = {file.as_posix() for file in files}
    with listing.open("a", encoding="utf-8") as file:
        file.writelines(f"{path},,\n" for path in (os.path.relpath(path, site) for path in paths) if path not in known)


@click.command()
@click.option("--remove", is_flag=True, help="Take the stand-ins away instead.")
def link(remove: bool) -> None:
    """Let the `mitsuba` command run plugins that are written in Python.

    Puts a stand-in for each plugin of every installed package that offers some (this one, and Mitsuba's own prb and
    its kin) into Mitsuba's folder of plugins. Installing this package does so already where there is a C compiler;
    run this when there was none, or after installing another package with plugins. Uninstalling takes them away.
    """
    if sys.platform != "linux":
        raise click.ClickException("the stand-ins exist for Linux only; use prosim render.")
    try:
        if remove:
            click.echo(f"{remove_stand_ins(plugin_folder())} stand-ins removed from {plugin_folder()}")
            return
        if misplaced := misplaced_folder():
            remove_stand_ins(misplaced / "plugins")
            (misplaced / "plugins").rmdir()
            misplaced.rmdir()
        wanted = [plugin_folder() / f"{name}.so" for name in plugin_names()]
        with tempfile.TemporaryDirectory() as folder:
            built = Path(folder, "stand_in.so")
            compile_stand_in(built, sys.executable)
            for path in wanted:
                if not path.exists() or is_stand_in(path):
                    part = path.with_suffix(f".{os.getpid()}")
                    shutil.copyfile(built, part)
                    part.replace(path)
        record(wanted)
    except (RuntimeError, OSError) as error:
        raise click.ClickException(str(error)) from None
    click.echo(f"{len(wanted)} stand-ins in {plugin_folder()}: {', '.join(path.stem for path in wanted)}")
