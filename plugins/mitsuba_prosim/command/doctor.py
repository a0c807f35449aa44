"""``prosim doctor``: what was found on this machine, and what to do about what is missing."""

import os
import platform
import sys
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import click
import mitsuba as mi

from .. import llvm
from ..denoising import oidn
from ..scene import session
from . import stand_in
from .compare import missing_packages
from .link import misplaced_folder

#: What only some need, and the modules that it brings.
EXTRAS = {
    "cluster": ["distributed"],
    "editors": ["pygls"],
    "watch": ["starlette", "uvicorn", "watchfiles"],
    "tev": ["tevclient"],
    "notebooks": ["ipywidgets"],
}


@click.command()
def doctor() -> None:
    """Print what was found: versions, variants, LLVM, the `mitsuba` command; and what to do where something is amiss.

    Exit code 0 if all is well, else 1.
    """
    troubles = []
    say("Python", f"{platform.python_version()}, {sys.executable}")
    for name in ("mitsuba-prosim", "mitsuba", "drjit", "numpy", "OpenEXR", "manifold3d"):
        say(name, version(name))
    say("platform", f"{platform.platform()}, {os.cpu_count()} processors")

    usable = [v for v in mi.variants() if session.has_backend(v)]
    say("variants", f"{', '.join(usable)} (default {session.default_variant()})")
    for kind, (_, need) in session.BACKENDS.items():
        if (unusable := [v for v in mi.variants() if v.startswith(f"{kind}_")]) and unusable[0] not in usable:
            say("", f"not {', '.join(unusable)}, which need {need}")

    found = llvm.version()
    say("LLVM", f"{'.'.join(map(str, found))}, {llvm.library()}, {origin()}" if found else "none")
    if problem := llvm.problem():
        troubles.append(problem)

    if sys.platform == "linux":
        stand_ins, folder = stand_in.stand_ins(), stand_in.plugin_folder()
        say("mitsuba", f"{len(stand_ins)} stand-ins for plugins written in Python in {folder}")
        compiler = stand_in.compiler()
        say("C compiler", " ".join(compiler) if compiler else "none (only to build stand-ins)")
        if misplaced := misplaced_folder():
            troubles.append(
                f"{misplaced} keeps the mitsuba command from starting, because Mitsuba itself is in "
                f"{folder.parent}. Run: prosim link"
            )
        elif missing := sorted(set(stand_in.names_in_source(Path(llvm.__file__).parent)) - set(stand_ins)):
            advice = "Run: prosim link" if compiler else f"Install {stand_in.COMPILER}, then run: prosim link"
            troubles.append(f"The mitsuba command can't run {', '.join(missing)} (prosim render can). {advice}")
    else:
        say("mitsuba", "the mitsuba command runs plugins written in Python on Linux only; use prosim render")

    lacking = missing_packages()
    say(
        "compare",
        f"lacks {', '.join(lacking)}; to get them: pip install 'mitsuba-prosim[compare]'" if lacking else "ready",
    )
    try:
        say("denoise", f"Open Image Denoise {oidn.load().oidn_version()}")
    except oidn.MissingError:
        say("denoise", "lacks mitsuba-oidn; to get it: pip install 'mitsuba-prosim[denoise]'")
    for extra, modules in EXTRAS.items():
        lacking = [name for name in modules if find_spec(name) is None]
        say(
            extra,
            f"lacks {', '.join(lacking)}; to get it: pip install 'mitsuba-prosim[{extra}]'" if lacking else "ready",
        )

    for trouble in troubles:
        click.echo(f"\n{trouble}")
    if not troubles:
        click.echo("\nAll is well.")
    sys.exit(bool(troubles))


def say(label: str, text: str) -> None:
    """Prints a line of two columns."""
    click.echo(f"{label:<16}{text}")


def origin() -> str:
    """How Dr.Jit came to its LLVM."""
    path = os.environ.get("DRJIT_LIBLLVM_PATH")
    if not path:
        return "found in the system's folders"
    return (
        "chosen by mitsuba_prosim_llvm.pth"
        if path.endswith(f"/lib/{llvm.packaged()}")
        else "chosen by DRJIT_LIBLLVM_PATH"
    )
