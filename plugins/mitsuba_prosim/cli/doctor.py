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
from ..stock_command import stand_ins


@click.command()
def doctor() -> None:
    """Print versions, variants, LLVM, extras, the state of the `mitsuba` command, and remedies for problems.

    The exit code is 1 if there are problems, else 0.
    """
    problems = []
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
    if problem := llvm.problem():
        problems.append(problem)

    if sys.platform == "linux":
        installed = stand_ins.installed()
        if not installed:
            row("mitsuba", "the mitsuba command can't run plugins in Python; to enable this: prosim link")
        elif missing := sorted(set(stand_ins.plugin_names()) - set(installed)):
            problems.append(f"The mitsuba command can't run {', '.join(missing)} (prosim render can). Run: prosim link")
        else:
            row("mitsuba", f"{len(installed)} stand-ins for plugins in Python in {stand_ins.plugin_folder()}")
    else:
        row("mitsuba", "the mitsuba command runs plugins in Python on Linux only; use prosim render")

    for extra in sorted(extras.EXTRAS):
        row(extra, extras.needs("", extra).strip() if extras.missing(extra) else "ready")

    for problem in problems:
        click.echo(f"\n{problem}")
    if not problems:
        click.echo("\nAll is well.")
    sys.exit(bool(problems))


def row(label: str, text: str) -> None:
    """Prints a line with two columns."""
    click.echo(f"{label:<16}{text}")
