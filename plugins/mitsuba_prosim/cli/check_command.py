"""``prosim check``: tests whether a plugin, or each plugin of a scene, is right."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import click
import mitsuba as mi

from .job import Command, Job, job_options
from .option_types import DEFINITION, InputError, input_errors, option

#: What pictures show of plugins that sample directions.
AXES = dict.fromkeys(
    ("bsdf", "emitter", "phase"), "; down: cosine of the polar angle, right: azimuth from -180° to 180°"
)

FOLDER = click.Path(file_okay=False, path_type=Path)


@click.command(cls=Command)
@click.argument("plugin")
@option(
    "Scene", "-p", "--parameter", "parameters", type=DEFINITION, multiple=True, help="Such as alpha=0.2; repeatable."
)
@option(
    "Scene", "--import", "modules", multiple=True, metavar="MODULE", help="Module or .py file with plugins; repeatable."
)
@option("Output", "--json", "as_json", is_flag=True, help="Print JSON instead of tables.")
@option("Output", "--pictures", type=FOLDER, default=".", help="Folder for pictures of failed tests.")
@job_options("variant")
def check(
    job: Job,
    plugin: str,
    parameters: tuple[tuple[str, str], ...],
    modules: tuple[str, ...],
    as_json: bool,
    pictures: Path,
) -> None:
    """Test whether PLUGIN is right: the name of a type, XML text, or a scene file, whose plugins are all tested.

    The tests compare the methods of the plugin with each other and with the laws of physics. Each plugin is tested in
    a process of its own. A note is a property that integrators can live with. The exit code is 1 if a test fails.
    """
    from ..check import check_apart

    with input_errors():
        jobs = list(subjects(plugin, dict(parameters), modules))
        reports = []
        for source, node in jobs:
            report = check_apart(job.variant, source, node=node, modules=modules)
            reports.append(report)
            if not as_json:
                click.echo(report.table())
                for path in report.write_pictures(pictures):
                    click.echo(f"  {path}: density, samples, difference{AXES.get(report.kind, '')}")
    if as_json:
        click.echo(json.dumps([report.json() for report in reports], indent=1))
    sys.exit(not all(report.ok for report in reports))


def subjects(plugin: str, parameters: dict[str, str], modules: tuple[str, ...]) -> Iterator[tuple[Any, int]]:
    """Yields the source and the node of each plugin that the command line names; loads each of them once."""
    from ..check.subject import Subject, import_module

    for module in modules:
        import_module(module)
    is_text = plugin.lstrip().startswith("<")
    is_scene = not is_text and Path(plugin).suffix != ""
    if is_scene and not Path(plugin).is_file():
        raise ValueError(f"{plugin}: no such file; give the name of a plugin's type, or a scene file")
    if parameters and (is_text or is_scene):
        raise InputError("-p is for the name of a type; write the parameters into the XML.")
    source: Any = plugin if is_text else Path(plugin)
    if not (is_text or is_scene):
        source = {"type": plugin, **{k: value(v) for k, v in parameters.items()}}
    subject = Subject(source, modules=modules)
    if subject.state.root.type == mi.ObjectType.Scene:
        yield from ((source, node) for node in subject.nodes())
    else:
        subject.load()
        yield source, 0


def value(text: str) -> Any:
    """Converts the text of a parameter: a number, true or false, a colour R,G,B, a dictionary in JSON, or a text."""
    with suppress(ValueError):
        if text.count(",") == 2 and not text.startswith("{"):
            return {"type": "rgb", "value": [float(part) for part in text.split(",")]}
        if isinstance(parsed := json.loads(text), (int, float, dict)):
            return parsed
    return text
