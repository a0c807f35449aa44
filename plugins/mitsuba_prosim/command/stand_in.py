"""Building and finding stand-ins for plugins (see ``stand_in.c``); standard library only, as the build uses it too."""

import importlib.util
import os
import re
import shutil
import subprocess
from pathlib import Path

SOURCE = Path(__file__).with_name("stand_in.c")

#: What tells a stand-in, of this or another version, from a true plugin.
MARK = b"mitsuba-prosim stand-in for a Python plugin"

#: The plugins of Mitsuba 3.9 itself that are written in Python, which its command can't run either.
BUNDLED = ("prb", "prb_basic", "prb_projective", "prbvolpath", "direct_projective", "volprim_rf_basic", "flat_sensor")

#: What to install where there is none.
COMPILER = "a C compiler (on Debian and Ubuntu: apt install gcc libc6-dev)"

REGISTERED = re.compile(r'^@plugin\("\w+", "(\w+)"\)', re.MULTILINE)


def plugin_folder() -> Path:
    """Mitsuba's folder of plugins."""
    spec = importlib.util.find_spec("mitsuba")
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError("there is no Mitsuba for this Python")
    return Path(spec.origin).with_name("plugins")


def is_stand_in(path: Path) -> bool:
    """Whether a file is a stand-in (of any version), not a plugin of Mitsuba's."""
    return path.stat().st_size < 2**16 and MARK in path.read_bytes()


def stand_ins() -> dict[str, Path]:
    """Plugin name -> path, of every stand-in that is in place."""
    return {path.stem: path for path in plugin_folder().glob("*.so") if is_stand_in(path)}


def names_in_source(package: str | Path) -> list[str]:
    """Names of the plugins that the modules of a package define, by their text alone."""
    return sorted(
        name
        for module in Path(package).glob("*/*.py")
        for name in REGISTERED.findall(module.read_text(encoding="utf-8"))
    )


def compiler() -> list[str] | None:
    """The C compiler's command line, as a list, or None."""
    if named := os.environ.get("CC"):
        return named.split()
    found = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    return [found] if found else None


def compile_stand_in(path: str | Path, python: str | None = None) -> None:
    """Compiles a stand-in to ``path``, which starts ``python`` or, by default, the interpreter beside Mitsuba.

    Raises RuntimeError where there is no compiler, or it fails.
    """
    command = compiler()
    if command is None:
        raise RuntimeError(f"there is no C compiler; install {COMPILER}")
    define = [f'-DPYTHON="{python}"'] if python else []
    try:
        subprocess.run(
            [*command, "-O2", "-shared", "-fPIC", "-fvisibility=hidden", "-s", *define, "-o", str(path), str(SOURCE)],
            check=True,
            capture_output=True,
            text=True,
        )
    except (OSError, subprocess.CalledProcessError) as error:
        raise RuntimeError(f"the C compiler failed: {getattr(error, 'stderr', None) or error}") from None
