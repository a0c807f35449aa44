"""``prosim doctor``: prints what is installed on this machine, and how to install what is missing."""

import os
import platform
import sys
from importlib.metadata import version

import click
import mitsuba as mi
from prosim_scene import extras

from .. import llvm
from ..scene import session
from ..stock_command.link import is_linked


@click.command()
def doctor() -> None:
    """Print versions, variants, LLVM, extras, the state of the `mitsuba` command, and remedies for problems.

    The exit code is 1 if there is a problem, else 0.
    """
    row("Python", f"{platform.python_version()}, {sys.executable}")
    for name in ("mitsuba-prosim", "mitsuba", "drjit", "numpy", "OpenEXR", "manifold3d"):
        row(name, version(name))
    row("platform", f"{platform.platform()}, {os.cpu_count()} processors")

    usable = [v for v in mi.variants() if session.has_backend(v)]
    row("variants", f"{', '.join(usable)} (default {session.default_variant()})")
    for kind, (_, need) in session.BACKENDS.items():
        if (unusable := [v for v in mi.variants() if v.startswith(f"{kind}_")]) and unusable[0] not in usable:
            row("", f"not {', '.join(unusable)}, which need {need}")

    llvm_version = llvm.version()
    row("LLVM", f"{'.'.join(map(str, llvm_version))}, {llvm.library()}" if llvm_version else "none")
    linked = "runs plugins in Python" if is_linked() else "can't run plugins in Python; to enable this: prosim link"
    row("mitsuba", f"the mitsuba command {linked}")

    for extra in sorted(extras.EXTRAS):
        row(extra, extras.needs("", extra).strip() if extras.missing(extra) else "ready")

    problem = llvm.problem()
    click.echo(f"\n{problem or 'All is well.'}")
    sys.exit(bool(problem))


def row(label: str, text: str) -> None:
    """Prints a line with two columns."""
    click.echo(f"{label:<16}{text}")
