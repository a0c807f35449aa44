"""``prosim doctor``: what was found on this machine, and what to do about what is missing."""

import os
import platform
import sys
from importlib.metadata import version
from pathlib import Path

import click
import drjit as dr
import mitsuba as mi

from .. import llvm
from . import session
from .link import misplaced_folder
from .stand_in import compiler, names_in_source

BACKENDS = {"scalar": None, "llvm": dr.JitBackend.LLVM, "cuda": dr.JitBackend.CUDA, "metal": dr.JitBackend.Metal}


@click.command(short_help="Print what was found on this machine.")
def doctor():
    """Print what was found: versions, variants, LLVM, the `mitsuba` command; and what to do where something is amiss.

    Exit code 0 if all is well, else 1.
    """
    troubles = []
    say("Python", f"{platform.python_version()}, {sys.executable}")
    for name in ("mitsuba-prosim", "mitsuba", "drjit", "numpy", "manifold3d"):
        say(name, version(name))
    say("platform", f"{platform.platform()}, {os.cpu_count()} processors")

    usable = [v for v in mi.variants() if has_backend(v)]
    say("variants", f"{', '.join(usable)} (default {session.default_variant()})")
    if missing := sorted({v.partition("_")[0] for v in mi.variants()} - {v.partition("_")[0] for v in usable}):
        say("", f"no device or library for {', '.join(missing)}")

    found = llvm.version()
    say("LLVM", f"{'.'.join(map(str, found))}, {llvm.library()}, {origin()}" if found else "none")
    if problem := llvm.problem():
        troubles.append(problem)

    if sys.platform == "linux":
        stand_ins, folder = session.stand_ins(), session.plugin_folder()
        say("mitsuba", f"{len(stand_ins)} stand-ins for plugins written in Python in {folder}")
        if misplaced := misplaced_folder():
            troubles.append(f"{misplaced} keeps the mitsuba command from starting, because Mitsuba itself is in "
                            f"{folder.parent}. Run: prosim link")
        elif missing := sorted(set(names_in_source(Path(llvm.__file__).parent)) - set(stand_ins)):
            advice = "Run: prosim link" if compiler() else "Install a C compiler, then run: prosim link"
            troubles.append(f"The mitsuba command can't run {', '.join(missing)} (prosim render can). {advice}")
    else:
        say("mitsuba", "the mitsuba command can run plugins written in Python on Linux only; use prosim render")

    for trouble in troubles:
        click.echo(f"\n{trouble}")
    if not troubles:
        click.echo("\nAll is well.")
    sys.exit(bool(troubles))


def say(label, text):
    """Prints a line of two columns."""
    click.echo(f"{label:<16}{text}")


def has_backend(variant):
    """Whether this machine can run a variant."""
    backend = BACKENDS[variant.partition("_")[0]]
    return backend is None or dr.has_backend(backend)


def origin():
    """How Dr.Jit came to its LLVM."""
    path = os.environ.get("DRJIT_LIBLLVM_PATH")
    if not path:
        return "found in the system's folders"
    return "chosen by mitsuba_prosim_llvm.pth" if path.endswith(f"/lib/{llvm.packaged()}") else "chosen by DRJIT_LIBLLVM_PATH"
