"""Options and argument types that several commands share, and what they make of them."""

import functools
import math
import re
import warnings
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import mitsuba as mi
import prosim_scene
from click.core import ParameterSource

from ..engine.part import Part
from ..scene import scene_file, session
from ..scene.errors import pointed, with_nearest

#: More than any machine has processors.
MOST_THREADS = 1024

#: More would have less than a tile each, of an image of usual size.
MOST_PARTS = 4096

#: More than one machine has use for.
MOST_WORKERS = 256

#: Beyond these factors of two, single precision ends.
STOPS = 64


class InputError(click.ClickException):
    """The scene is wrong; nothing has been written."""

    exit_code = 2


@contextmanager
def wrong_input() -> Iterator[None]:
    """Turns whatever is raised where a scene is read and made into an InputError."""
    try:
        yield
    except prosim_scene.SceneError as error:
        raise InputError(str(error)) from None
    except (RuntimeError, TypeError, ValueError, OSError) as error:
        raise InputError(pointed(with_nearest(session.message(error)))) from None


def choose_variant(name: str | None) -> str:
    """Sets the variant that ``-m`` gives, or the default one, and loads all plugins; returns its name."""
    if name and name not in mi.variants():
        raise click.BadParameter(f"{name!r}: this Mitsuba has {', '.join(mi.variants())}.", param_hint="-m")
    try:
        return session.set_variant(name)
    except (ImportError, RuntimeError) as error:
        raise click.ClickException(session.message(error)) from None


class Resolution(click.ParamType):
    """A size such as 640x480."""

    name = "WxH"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """Width and height, as large as a film can be."""
        try:
            width, height = (int(word) for word in value.lower().split("x"))
        except ValueError:
            self.fail(f"{value!r} is not of the form {self.name}, such as 640x480", param, ctx)
        try:
            scene_file.check_size(width, height)
        except ValueError as error:
            self.fail(str(error), param, ctx)
        return width, height


class Crop(click.ParamType):
    """A window such as 10,20,64,48."""

    name = "X,Y,W,H"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, int, int, int]:
        """Its left upper corner, from 0, and its width and height, from 1."""
        try:
            x, y, width, height = (int(word) for word in value.split(","))
        except ValueError:
            self.fail(f"{value!r} is not of the form {self.name}, such as 10,20,64,48", param, ctx)
        if min(x, y) < 0 or min(width, height) < 1:
            self.fail(f"{value!r}: X and Y are 0 or more, W and H are 1 or more", param, ctx)
        return x, y, width, height


class Share(click.ParamType):
    """A part such as 3/16."""

    name = "K/M"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Part:
        """The part, counted from 1."""
        try:
            number, of = (int(word) for word in value.split("/"))
        except ValueError:
            self.fail(f"{value!r} is not of the form {self.name}, such as 3/16", param, ctx)
        if not 1 <= number <= of <= MOST_PARTS:
            self.fail(f"{value!r}: K is 1 to M, and M at most {MOST_PARTS}", param, ctx)
        return Part(number, of)


class Whole(click.IntRange):
    """A whole number in a range."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """The number."""
        try:
            int(value)
        except ValueError:
            self.fail(f"{value!r} is not a whole number", param, ctx)
        return int(super().convert(value, param, ctx))


class Finite(click.FloatRange):
    """A number in a range, and not "nan", which no range keeps out."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number."""
        try:
            float(value)
        except ValueError:
            self.fail(f"{value!r} is not a number, such as 0.01 or 90", param, ctx)
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number", param, ctx)
        return number


class Definition(click.ParamType):
    """A pair ``key=value``."""

    name = "key=value"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, str]:
        """The two."""
        key, equals, text = value.partition("=")
        if not key or not equals:
            self.fail(f"{value!r} is not of the form key=value, such as angle=30", param, ctx)
        return key, text


class Address(click.ParamType):
    """The address of a scheduler."""

    name = "ADDRESS"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The address, which has a port, as Dask would wait for one without."""
        if not re.fullmatch(r"(\w+://)?[^/]+:\d{1,5}/?", value):
            self.fail(
                f"{value!r} is not of the form tcp://machine:8786, as `dask scheduler` says its address", param, ctx
            )
        return str(value)


#: Decorator: the option for what $names stand for in scenes of either kind.
defines = click.option(
    "-D",
    "--define",
    "definitions",
    type=Definition(),
    multiple=True,
    help="Value that replaces $key in the scene. May be repeated.",
)


@dataclass(frozen=True)
class Helpers:
    """Who takes the samples: the workers of the cluster at this address, or so many processes of this machine."""

    cluster: str | None
    workers: int | None

    def __str__(self) -> str:
        return "--cluster" if self.cluster else "--workers"


def running(command: Callable) -> Callable:
    """Decorator: the options of a process that renders."""
    threads = click.option(
        "-t", "--threads", type=Whole(1, MOST_THREADS), show_default=False, help="Number of threads. [default: all]"
    )
    return threads(click.option("-v", "--verbose", count=True, help="Say more; twice: still more.")(command))


def helped(command: Callable) -> Callable:
    """Decorator: the options for other processes that take the samples; the command gets :class:`.Helpers`."""

    @functools.wraps(command)
    def helping(cluster: str | None, workers: int | None, **options: Any) -> Any:
        if cluster and workers:
            raise click.UsageError(
                "--workers begins a cluster on this machine, and --cluster names one that is there; give one of them."
            )
        if (cluster or workers) and options.get("part"):
            raise click.UsageError("--part is for processes that know nothing of each other; leave it to the cluster.")
        return command(helpers=Helpers(cluster, workers) if cluster or workers else None, **options)

    cluster = click.option(
        "--cluster",
        type=Address(),
        show_default=False,
        help="Render by the workers of a Dask cluster, of which this is the scheduler's address, such as "
        "tcp://machine:8786.",
    )
    workers = click.option(
        "--workers",
        type=Whole(1, MOST_WORKERS),
        show_default=False,
        help="Render by so many processes of this machine.",
    )
    return cluster(workers(helping))


def aims(*, noise: str, noise_99: str, time: str, max_samples: str) -> Callable[[Callable], Callable]:
    """Decorator: the options that say when an image is good enough, with what the help says of each."""
    above_0 = Finite(min=0, min_open=True)

    def decorate(command: Callable) -> Callable:
        for option in reversed(
            [
                click.option("--noise", type=above_0, show_default=False, help=noise),
                click.option("--noise-99", type=above_0, show_default=False, help=noise_99),
                click.option("--time", type=above_0, metavar="SECONDS", show_default=False, help=time),
                click.option("--max-samples", type=Whole(1, 2**20), show_default=False, help=max_samples),
            ]
        ):
            command = option(command)
        return command

    return decorate


def translation(command: Callable, of_xml: Collection[str] = ()) -> Callable:
    """Decorator: the options for scenes in the thesis's language, whose warnings are all shown; ``of_xml``: those that
    are for XML as well.
    """

    @functools.wraps(command)
    def warning(scene: Path, **options: Any) -> Any:
        warnings.simplefilter("always", prosim_scene.SceneWarning)
        if scene.suffix.lower() == ".xml":
            context = click.get_current_context()
            for name in (name for name in ("light_units", "tolerance", "allow_outside") if name not in of_xml):
                if context.get_parameter_source(name) is ParameterSource.COMMANDLINE:
                    option = "--" + name.replace("_", "-")
                    free = " It may name any file without that option." if name == "allow_outside" else ""
                    raise click.UsageError(
                        f"{option} is for scenes in the thesis's language, and {scene} is XML.{free}"
                    )
        return command(scene=scene, **options)

    for option in reversed(
        [
            click.option(
                "--light-units",
                type=click.Choice(["calibrated", "radiance", "unattenuated"]),
                default="calibrated",
                help="What a light's intensity means.",
            ),
            click.option(
                "--tolerance",
                type=Finite(min=0, min_open=True),
                metavar="PIXELS",
                show_default=False,
                help="How far a mesh may be from the curved face that it stands for. [default: 0.1]",
            ),
            click.option("--resolution", type=Resolution(), help="Size of the image in pixels, such as 640x480."),
            click.option(
                "--samples",
                type=Whole(1, 2**12),
                metavar="N",
                help="N of the N-rook sampling: N samples a pass, at most N*N a pixel.",
            ),
            click.option("--allow-outside", is_flag=True, help="Let the scene use files from outside its folder."),
        ]
    ):
        warning = option(warning)
    return warning
