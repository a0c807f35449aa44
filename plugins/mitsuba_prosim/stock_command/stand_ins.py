"""The stand-ins for plugins written in Python (see ``stand_in.c``): compiled, put into place, found and removed."""

import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import mitsuba as mi

from .. import registry
from ..scene import session

SOURCE = Path(__file__).with_name("stand_in.c")

#: What tells a stand-in, of this or another version, from a true plugin.
MARK = b"mitsuba-prosim stand-in for a Python plugin"

#: The plugins of Mitsuba 3.9 itself that are written in Python, which its command can't run either.
BUNDLED = ("prb", "prb_basic", "prb_projective", "prbvolpath", "direct_projective", "volprim_rf_basic", "flat_sensor")


def plugin_folder() -> Path:
    """Mitsuba's folder of plugins."""
    spec = importlib.util.find_spec("mitsuba")
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError("there is no Mitsuba for this Python")
    return Path(spec.origin).with_name("plugins")


def is_stand_in(path: Path) -> bool:
    """Whether a file is a stand-in (of any version), not a plugin of Mitsuba's."""
    return path.stat().st_size < 2**16 and MARK in path.read_bytes()


def installed() -> dict[str, Path]:
    """Plugin name -> path, of every stand-in in Mitsuba's folder."""
    return {path.stem: path for path in plugin_folder().glob("*.so") if is_stand_in(path)}


def plugin_names() -> list[str]:
    """Names of the plugins that the installed packages register, and of Mitsuba's own that are written in Python."""
    names = set(BUNDLED)
    mi.set_variant("scalar_rgb")
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


def compiler() -> list[str] | None:
    """The C compiler's command line, as a list, or None."""
    if named := os.environ.get("CC"):
        return named.split()
    found = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    return [found] if found else None


def compile_stand_in(path: Path) -> None:
    """Compiles a stand-in to ``path``, which starts this interpreter.

    Raises RuntimeError where there is no compiler, or it fails.
    """
    command = compiler()
    if command is None:
        raise RuntimeError("there is no C compiler; install one (on Debian and Ubuntu: apt install gcc libc6-dev)")
    define = f'-DPYTHON="{sys.executable}"'
    try:
        subprocess.run(
            [*command, "-O2", "-shared", "-fPIC", "-fvisibility=hidden", "-s", define, "-o", str(path), str(SOURCE)],
            check=True,
            capture_output=True,
            text=True,
        )
    except (OSError, subprocess.CalledProcessError) as error:
        raise RuntimeError(f"the C compiler failed: {getattr(error, 'stderr', None) or error}") from None


def install(names: Iterable[str], folder: Path) -> list[Path]:
    """Puts a stand-in for each name into ``folder``, but for those of native plugins; returns their paths.

    Raises RuntimeError and OSError.
    """
    paths = [path for name in names if not (path := folder / f"{name}.so").exists() or is_stand_in(path)]
    with tempfile.TemporaryDirectory() as scratch:
        built = Path(scratch, "stand_in.so")
        compile_stand_in(built)
        for path in paths:
            part = path.with_suffix(f".{os.getpid()}")
            shutil.copyfile(built, part)
            part.replace(path)
    return paths


def record(paths: Iterable[Path]) -> None:
    """Adds files to the list of what pip removes when this package is uninstalled."""
    own = distribution("mitsuba-prosim")
    files = own.files or []
    listing = next(Path(str(file.locate())) for file in files if file.name == "RECORD")
    site = listing.parents[1]
    known = {file.as_posix() for file in files}
    with listing.open("a", encoding="utf-8") as file:
        file.writelines(f"{path},,\n" for path in (os.path.relpath(path, site) for path in paths) if path not in known)
