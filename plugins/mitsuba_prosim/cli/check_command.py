"""``prosim check``: tests whether a plugin, or each plugin of a scene, is right."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import mitsuba as mi

from ..parameters import from_text
from .job import Command, Job, job_options
from .option_types import DEFINITION, input_errors, option


@click.command(cls=Command)
@click.argument("plugin")
@option(
    "Scene", "-p", "--parameter", "parameters", type=DEFINITION, multiple=True, help="Such as alpha=0.2; repeatable."
)
@option(
    "Scene", "--import", "modules", multiple=True, metavar="MODULE", help="Module or .py file with plugins; repeatable."
)
@job_options("variant")
def check(job: Job, plugin: str, parameters: tuple[tuple[str, str], ...], modules: tuple[str, ...]) -> None:
    """Test whether PLUGIN is right: the name of a type, or a scene file, whose plugins are all tested.

    The tests compare the methods of the plugin with each other and with the laws of physics. Each plugin is tested in
    a process of its own. A note is a property that does no harm to images. The exit code is 1 if a test fails.
    """
    from ..check import check_apart

    right = True
    with input_errors():
        for source, node in list(subjects(plugin, dict(parameters), modules)):
            report = check_apart(job.variant, source, node=node, modules=modules)
            right &= report.ok
            click.echo(report.table())
    sys.exit(not right)


def subjects(plugin: str, parameters: dict[str, str], modules: tuple[str, ...]) -> Iterator[tuple[Any, int]]:
    """Yields the source and the node of each plugin that the command line names; loads each of them once."""
    from ..check.subject import Subject, import_module

    for module in modules:
        import_module(module)
    source: Any = {"type": plugin, **{k: from_text(v) for k, v in parameters.items()}}
    if Path(plugin).suffix:
        if parameters or not Path(plugin).is_file():
            raise ValueError(
                f"{plugin}: no such file, or a file with -p; give a file alone, or a plugin's type with -p"
            )
        source = Path(plugin)
    subject = Subject(source, modules=modules)
    if subject.state.root.type == mi.ObjectType.Scene:
        yield from ((source, node) for node in subject.nodes())
    else:
        subject.load()
        yield source, 0
