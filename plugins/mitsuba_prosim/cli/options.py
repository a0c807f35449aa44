"""The options of the commands, in the groups in which the help shows them, and the types of their values."""

import math
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import click
import mitsuba as mi
import prosim_scene

from ..engine.policies import POLICIES
from ..engine.tiles import Part
from ..scene import overrides, session
from ..scene.errors import pointed, with_nearest

#: Where the viewer tev listens by default.
TEV_HOST, TEV_PORT = "127.0.0.1", 14158

#: More than any machine has processors.
MOST_THREADS = 1024

#: More would have less than a tile each, of an image of usual size.
MOST_PARTS = 4096

#: More than one machine has use for.
MOST_WORKERS = 256

#: The exposure beyond which single precision ends.
STOPS = 64

#: The last frame that a film may have: an hour and a half at 24 frames a second. Beyond it a film is a mistake.
LAST_FRAME = 2**17 - 1


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


# ---------------------------------------------------------------- types


class Pattern(click.ParamType):
    """A value of one form: ``parse`` makes it of the text, and raises ValueError, with a message where the text has the
    form and the value is wrong all the same.
    """

    def __init__(self, name: str, example: str, parse: Callable[[str], Any]) -> None:
        self.name, self.example, self.parse = name, example, parse

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The value."""
        try:
            return self.parse(value) if isinstance(value, str) else value
        except RefusedError as error:
            self.fail(f"'{value}': {error}", param, ctx)
        except ValueError:
            self.fail(f"'{value}' is not of the form {self.name}, such as {self.example}", param, ctx)


class RefusedError(ValueError):
    """A value of the right form that is wrong; its message says why."""


def whole_numbers(text: str, separator: str, count: int | None = None) -> list[int]:
    """The ``count`` numbers of a text (any: None). Raises ValueError."""
    numbers = [int(word) for word in text.split(separator)]
    if count is not None and len(numbers) != count:
        raise ValueError
    return numbers


def resolution(text: str) -> tuple[int, int]:
    """Width and height of an image, as large as a film can be."""
    width, height = whole_numbers(text.lower(), "x", 2)
    try:
        overrides.check_size(width, height)
    except ValueError as error:
        raise RefusedError(str(error)) from None
    return width, height


def crop(text: str) -> tuple[int, int, int, int]:
    """A window: its upper left corner, from 0, and its width and height, from 1."""
    x, y, width, height = whole_numbers(text, ",", 4)
    if min(x, y) < 0 or min(width, height) < 1:
        raise RefusedError("X and Y are 0 or more, W and H are 1 or more")
    return x, y, width, height


def part(text: str) -> Part:
    """A part of an image, counted from 1."""
    number, of = whole_numbers(text, "/", 2)
    if not 1 <= number <= of <= MOST_PARTS:
        raise RefusedError(f"K is 1 to M, and M at most {MOST_PARTS}")
    return Part(number, of)


def frames(text: str) -> range:
    """The numbers of frames, at least one, from 0; counted as Python's slices are, without the last."""
    numbers = whole_numbers(text, ":")
    if len(numbers) > 3:
        raise ValueError
    frames = range(*numbers) if len(numbers) > 1 else range(numbers[0], numbers[0] + 1)
    if not frames or min(frames) < 0 or max(frames) > LAST_FRAME or frames.step < 0:
        raise RefusedError(
            "A is 0 or more, B is more than A (frame B is not rendered), STEP is 1 or more, and no frame is beyond "
            f"{LAST_FRAME}"
        )
    return frames


def definition(text: str) -> tuple[str, str]:
    """A name and its value."""
    key, equals, value = text.partition("=")
    if not key or not equals:
        raise ValueError
    return key, value


def address(text: str) -> str:
    """The address of a scheduler; it has a port, because Dask would wait for one without."""
    if not re.fullmatch(r"(\w+://)?[^/]+:\d{1,5}/?", text):
        raise ValueError
    return text


def viewer(text: str) -> tuple[str, int]:
    """Host and port of tev."""
    found = re.fullmatch(r"tev(?:=(?P<host>.+):(?P<port>\d{1,5}))?", text)
    if not found:
        raise ValueError
    return (found["host"], int(found["port"])) if found["port"] else (TEV_HOST, TEV_PORT)


class Text(click.types.StringParamType):
    """Any text; ``name``: what it is in the help."""

    def __init__(self, name: str) -> None:
        self.name = name


class Whole(click.IntRange):
    """A whole number in a range."""

    name = "integer"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """The number."""
        try:
            int(value)
        except ValueError:
            self.fail(f"'{value}' is not a whole number", param, ctx)
        return int(super().convert(value, param, ctx))


class Finite(click.FloatRange):
    """A number in a range, and not "nan", which no range keeps out; ``name``: what it is in the help."""

    def __init__(
        self, name: str, low: float | None = None, high: float | None = None, open_below: bool = False
    ) -> None:
        super().__init__(low, high, open_below)
        self.name = name

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number."""
        try:
            float(value)
        except ValueError:
            self.fail(f"'{value}' is not a number{meant(str(value)) or ', such as 0.01 or 90'}", param, ctx)
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"'{value}' is not a finite number", param, ctx)
        return number


def meant(text: str) -> str:
    """What to write in the place of a number in per cent, or with a comma; empty where it is neither."""
    found = re.fullmatch(r"([\d.,]+) *(%?)", text)
    try:
        number = float(found[1].replace(",", ".")) if found else math.nan
    except ValueError:
        return ""
    return "" if math.isnan(number) else f"; write {number / 100 if found and found[2] else number:g}"


# ---------------------------------------------------------------- groups of the help


class Option(click.Option):
    """An option in a ``group`` of the help. ``old``: names that it had before, which the help leaves out."""

    def __init__(self, names: Sequence[str], *, group: str, old: Sequence[str] = (), **settings: Any) -> None:
        super().__init__([*names, *old], **settings)
        self.group, self.old = group, old

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        """The names and the text of the help."""
        every = self.opts
        self.opts = [name for name in every if name not in self.old]
        try:
            return super().get_help_record(ctx)
        finally:
            self.opts = every


#: The groups in the order of the help; the last has the options of no group.
GROUPS = ("Quality", "Output", "Scene", "Film", "Comparison", "Page", "Distribution", "Advanced", "Others")


class Command(click.Command):
    """A command whose help shows its options by groups."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Writes them."""
        groups: dict[str, list[tuple[str, str]]] = {}
        for param in self.get_params(ctx):
            if isinstance(param, click.Option) and (record := param.get_help_record(ctx)) is not None:
                groups.setdefault(getattr(param, "group", GROUPS[-1]), []).append(record)
        for group, records in sorted(groups.items(), key=lambda item: GROUPS.index(item[0])):
            with formatter.section(group):
                formatter.write_dl(records)


def option(group: str, *names: str, **settings: Any) -> Callable[[Callable], Callable]:
    """Decorator: an :class:`Option`."""
    return click.option(*names, cls=Option, group=group, **settings)


PATH, VARIANT = Text("path"), Text("variant")
SECONDS = Finite("seconds", low=0, open_below=True)
ERROR = Finite("error", low=0, open_below=True)
EXPOSURE = Finite("stops", -STOPS, STOPS)
ADDRESS = Pattern("ADDRESS", "tcp://machine:8786, the address that `dask scheduler` prints", address)
UNITS = click.Choice(["calibrated", "radiance", "unattenuated"])

#: Group of the help -> parameter -> (type, None for a flag; help; names, if they are not that of the parameter).
TABLE: dict[str, dict[str, tuple[Any, ...]]] = {
    "Quality": {
        "noise": (ERROR, "Stop when the RMS error of the displayed image is below this (white = 1); 0.01 is usual."),
        "time": (SECONDS, "Stop after this time; with --noise: at the latest."),
        "spp": (Whole(1, 2**24), "Samples per pixel. [default: those of the scene]"),
        "denoise": (None, "Denoise the image, as far as two halves of its samples agree that this improves it."),
    },
    "Output": {
        "output": (
            PATH,
            "File or folder to write; all kinds are written. [default: beside the input]",
            "-o",
            "--output",
        ),
        "exposure": (EXPOSURE, "Exposure of the PNG in stops."),
        "keep": (None, "Write checkpoints, NAME.state.npz, from which prosim resume continues."),
        "view": (
            Pattern("tev[=HOST:PORT]", "tev=127.0.0.1:14158", viewer),
            "Show the image in tev while it is rendered.",
        ),
        "verbose": (None, "Verbose output; repeat for more.", "-v", "--verbose"),
    },
    "Scene": {
        "definitions": (
            Pattern("key=value", "angle=30", definition),
            "Replace $key in the scene; may be repeated.",
            "-D",
            "--define",
        ),
        "sensor": (Whole(min=0), "Which sensor of the scene.", "-s", "--sensor"),
        "resolution": (Pattern("WxH", "640x480", resolution), "Size of the image in pixels, such as 640x480."),
        "crop": (Pattern("X,Y,W,H", "10,20,64,48", crop), "Render only this window of the image, in pixels."),
        "paths": (None, "Path tracing: follow diffuse reflections too, in place of the ambient term."),
        "caustics": (
            None,
            "Light that glass and mirrors gather. [default: what the scene says]",
            "--caustics/--no-caustics",
        ),
        "max_level": (Whole(-1, 2**16), "Maximum depth of rays; -1, with --paths: any. [default: what the scene says]"),
        "allow_outside": (None, "Let the scene use files from outside its folder."),
    },
    "Film": {
        "frames": (
            Pattern("A:B[:STEP]", "0:48, 0:48:2 or 7", frames),
            "Render a film: an image for each $frame, A to B-1, or one.",
        ),
        "fps": (Finite("number", low=0, open_below=True), "Frames per second, for $time. [default: 24]"),
        "overwrite": (None, "Render existing frames again.", "--overwrite"),
    },
    "Distribution": {
        "threads": (Whole(1, MOST_THREADS), "Number of threads. [default: all]", "-t", "--threads"),
        "workers": (Whole(1, MOST_WORKERS), "Use this many local processes."),
        "cluster": (ADDRESS, "Use the workers of the Dask cluster with this scheduler."),
        "part": (Pattern("K/M", "3/16", part), "Render only part K of M, to NAME.K-of-M.npz; see prosim merge."),
    },
    "Advanced": {
        "mode": (
            VARIANT,
            "Mitsuba variant. [default: the first of cuda, metal, llvm and scalar that works here]",
            "-m",
            "--mode",
        ),
        "seed": (Whole(0, 2**32 - 1), "Seed of the samples."),
        "samples": (Whole(1, 2**12), "N of the thesis's N-rook sampling: N samples a pass, at most N*N per pixel."),
        "threshold": (Finite("error", low=0), "Standard error of a pixel that needs no more samples (white = 1)."),
        "noise_99": (ERROR, "Also require 99 % of the pixels to be within this error."),
        "noise_999": (
            ERROR,
            "Also require 99.9 % of the pixels, bright specks with them, to be within it.",
            "--noise-99.9",
        ),
        "max_samples": (Whole(1, 2**20), "Maximum number of samples per pixel. [default with --noise, --time: any]"),
        "adaptive": (
            click.Choice(tuple(POLICIES)),
            "Which pixels get how many samples. [default with --noise, --time: graded]",
        ),
        "light_units": (UNITS, "What a light's intensity means in the thesis's language. [default: calibrated]"),
        "tolerance": (
            Finite("pixels", low=0, open_below=True),
            "Maximum tessellation error in the thesis's language. [default: 0.1]",
        ),
    },
}

#: What else there is to say of some.
SETTINGS: dict[str, dict[str, Any]] = {
    "caustics": {"default": None},
    "definitions": {"multiple": True},
    "overwrite": {"old": ["--anew"]},
    "seed": {"default": 0},
    "sensor": {"default": 0},
    "verbose": {"is_flag": False, "count": True, "show_default": False},
}


def options() -> Iterator[tuple[str, Callable[[Callable], Callable]]]:
    """The parameter and the decorator of each row of the table."""
    for group, rows in TABLE.items():
        for name, (type_, text, *names) in rows.items():
            settings = {"is_flag": True} if type_ is None else {"type": type_}
            names = names or [f"--{name.replace('_', '-')}"]
            yield name, option(group, *names, name, help=text, **settings | SETTINGS.get(name, {}))


#: Parameter -> decorator, in the order of the help.
OPTIONS = dict(options())


def choose_variant(name: str | None) -> str:
    """Sets the variant that ``-m`` names, or the default one, and loads all plugins; returns its name."""
    if name and name not in mi.variants():
        raise click.BadParameter(f"'{name}': this Mitsuba has {', '.join(mi.variants())}.", param_hint="-m")
    try:
        variant = session.set_variant(name)
    except (ImportError, RuntimeError) as error:
        raise click.ClickException(session.message(error)) from None
    if variant.startswith("scalar_"):
        click.echo(
            f"{variant}: plugins written in Python, as ours are, take hundreds of times as long as in an llvm variant",
            err=True,
        )
    return variant


def refuse_waves(names: Sequence[str], variant: str) -> None:
    """Raises InputError where something of these names was asked of a scalar variant, which renders pixel by pixel."""
    if variant.startswith("scalar_") and names:
        raise InputError(
            f"{', '.join(names)}: {variant} finishes one pixel after the other, each with the samples of the scene's "
            "sampler, and knows nothing of the whole image. Take another variant, such as -m llvm_ad_rgb (prosim "
            "doctor says which this machine can run), or --spp."
        )
