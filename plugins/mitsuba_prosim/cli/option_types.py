"""The types of the values of command-line options and of input files; options that the help text shows in groups."""

import difflib
import math
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import click
import prosim_scene
from prosim_scene import extras

from ..engine.tiles import Part
from ..scene import session
from ..scene.errors import with_line, with_suggestion


class InputError(click.ClickException):
    """The scene or another input of a command is wrong. The command ends with exit code 2, and has written no file."""

    exit_code = 2


@contextmanager
def input_errors() -> Iterator[None]:
    """Converts an exception inside the ``with`` block, which reads and loads a scene, to an InputError."""
    try:
        yield
    except prosim_scene.SceneError as error:
        raise InputError(str(error)) from None
    except (ImportError, RuntimeError, TypeError, ValueError, OSError) as error:
        raise InputError(with_line(with_suggestion(session.message(error)))) from None


def require_extra(extra: str, what: str) -> None:
    """Raises ClickException, which says how to install them, if packages of the ``extra``, which ``what`` needs, are
    missing.
    """
    if extras.missing(extra):
        raise click.ClickException(extras.needs(what, extra))


# ---------------------------------------------------------------- types


class PatternType(click.ParamType):
    """The click type of an option whose text must match the regular expression ``pattern``.

    ``make`` converts the groups of the match to the value; the user sees the message of its ValueError. ``name`` and
    ``example`` show the form of the text in error messages.
    """

    def __init__(self, name: str, example: str, pattern: str, make: Callable[..., Any]) -> None:
        self.name, self.example, self.pattern, self.make = name, example, pattern, make

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Returns the value of the option; raises BadParameter for a text that is not allowed."""
        match = re.fullmatch(self.pattern, value, re.DOTALL)
        if not match:
            self.fail(f"'{value}' is not of the form {self.name}, such as {self.example}", param, ctx)
        try:
            return self.make(*match.groups())
        except ValueError as error:
            self.fail(f"'{value}': {error}", param, ctx)


class Integer(click.IntRange):
    """An integer in a range."""

    name = "integer"


class Number(click.FloatRange):
    """A finite number in a range."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Returns the number; raises BadParameter if the text is not a finite number in the range."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"'{value}' is not a finite number.", param, ctx)
        return number


def integers(*texts: str) -> tuple[int, ...]:
    """Converts texts to integers."""
    return tuple(map(int, texts))


def _frames(begin: str, end: str | None, step: str | None) -> range:
    frames = range(int(begin), int(begin) + 1 if end is None else int(end), int(step or 1))
    if not frames:
        raise ValueError("frame B is not rendered, so B must be greater than A")
    return frames


def _snapshots(text: str) -> tuple[str, ...]:
    snapshots = tuple(text.split(","))
    if len({snapshot.endswith("s") for snapshot in snapshots}) > 1:
        raise ValueError("give errors or times, not both")
    if not all(float(snapshot.removesuffix("s")) > 0 for snapshot in snapshots):
        raise ValueError("give errors and times above 0")
    return snapshots


RESOLUTION = PatternType("WxH", "640x480", r"(\d+)[xX](\d+)", integers)
CROP = PatternType("X,Y,W,H", "10,20,64,48", r"(\d+),(\d+),0*([1-9]\d*),0*([1-9]\d*)", integers)
PART = PatternType("K/M", "3/16", r"(\d{1,4})/(\d{1,4})", lambda number, of: Part(int(number), int(of)))
FRAMES = PatternType("A:B[:STEP]", "0:48, 0:48:2 or 7", r"(\d{1,6})(?::(\d{1,6})(?::0*([1-9]\d*))?)?", _frames)
SNAPSHOTS = PatternType("X,X,...", "0.04,0.02 or 1s,4s", r"(\d*\.?\d+s?(?:,\d*\.?\d+s?)*)", _snapshots)
DEFINITION = PatternType("key=value", "angle=30", "([^=]+)=(.*)", lambda *pair: pair)
#: The port is required, because Dask would wait for ever for a scheduler without a port.
ADDRESS = PatternType("ADDRESS", "tcp://machine:8786, as `dask scheduler` says", r"((?:\w+://)?[^/]+:\d{1,5}/?)", str)


# ---------------------------------------------------------------- input files

#: Suffix of a file that a command does not read -> what the file is, and which command reads it.
USES = {
    ".npz": "the state or a part of a render; continue it by prosim resume, or merge all parts by prosim merge",
    ".exr": "an image; prosim mix changes the lamps of its layers, and prosim resume continues its .state.npz",
    ".xml": "a Mitsuba scene; render it by prosim render",
    ".scn": "a scene in the thesis's language; render it by prosim render",
}


class InputFile(click.Path):
    """The click type of an argument that names an existing file with one of the suffixes ``read``, or with another one
    that is not in :data:`USES`.
    """

    def __init__(self, *read: str) -> None:
        super().__init__(exists=True, dir_okay=False, path_type=Path)
        self.read = read

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Returns the path of the file; raises BadParameter for a file that is missing or not allowed."""
        path = Path(os.fsdecode(value))
        try:
            super().convert(value, param, ctx)
        except click.BadParameter as error:
            files = list[str]()
            with suppress(OSError):  # the folder cannot be read
                files = os.listdir(path.parent) if path.parent.is_dir() and not path.exists() else []
            near = [f" Did you mean {path.with_name(name)}?" for name in difflib.get_close_matches(path.name, files, 1)]
            self.fail("".join([error.message, *near]), param, ctx)
        suffix = path.suffix.lower()
        if suffix in USES and suffix not in self.read:
            self.fail(f"'{path}' is {USES[suffix]}.", param, ctx)
        if not path.is_file():
            self.fail(f"'{path}' is a device or a pipe; give a file.", param, ctx)
        return path


SCENE_FILE, LANGUAGE_FILE = InputFile(".scn", ".xml"), InputFile(".scn")
STATE_FILE, IMAGE_FILE = InputFile(".npz"), InputFile(".exr")


# ---------------------------------------------------------------- groups of the help


class Option(click.Option):
    """A command-line option that the help text shows in the group ``group``."""

    def __init__(self, *names: Any, group: str, **settings: Any) -> None:
        super().__init__(*names, **settings)
        self.group = group


def option(group: str, *names: str, **settings: Any) -> Callable[[Callable], Callable]:
    """Returns a decorator that adds an :class:`Option` of the group ``group`` to a command."""
    return click.option(*names, cls=Option, group=group, **settings)
