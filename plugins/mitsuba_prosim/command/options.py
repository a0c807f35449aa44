"""Options and argument types that several commands share, and what they make of them."""

import functools
import warnings
from collections.abc import Callable
from pathlib import Path

import click
import mitsuba as mi
import prosim_scene

from ..scene_files import session

SCENE = click.Path(exists=True, dir_okay=False, readable=True, path_type=Path)


class InputError(click.ClickException):
    """The scene is wrong; nothing has been written."""

    exit_code = 2


def choose_variant(name: str | None) -> None:
    """Sets the variant that ``-m`` gives, or the default one, and loads all plugins."""
    if name and name not in mi.variants():
        raise click.BadParameter(f"{name!r}: this Mitsuba has {', '.join(mi.variants())}.", param_hint="-m")
    try:
        session.set_variant(name)
    except (ImportError, RuntimeError) as error:
        raise click.ClickException(str(error)) from None


class Numbers(click.ParamType):
    """Whole numbers with a separator, such as 640x480: ``count`` of them, each at least ``least``."""

    def __init__(self, name, separator, count, least=1):
        self.name, self.separator, self.count, self.least = name, separator, count, least

    def convert(self, value, param, ctx):
        try:
            numbers = tuple(int(word) for word in value.lower().split(self.separator))
        except ValueError:
            numbers = ()
        if len(numbers) != self.count or min(numbers) < self.least:
            self.fail(f"{value!r} is not of the form {self.name}", param, ctx)
        return numbers


class Definition(click.ParamType):
    """A pair ``key=value``."""

    name = "key=value"

    def convert(self, value, param, ctx):
        key, equals, text = value.partition("=")
        if not key or not equals:
            self.fail(f"{value!r} is not of the form key=value", param, ctx)
        return key, text


def translation(command: Callable) -> Callable:
    """Decorator: the options for scenes in the thesis's language, whose warnings are all shown."""
    @functools.wraps(command)
    def warning(*args, **options):
        warnings.simplefilter("always", prosim_scene.SceneWarning)
        return command(*args, **options)

    for option in reversed([
        click.option("--light-units", type=click.Choice(["calibrated", "radiance", "unattenuated"]),
                     default="calibrated", help="What a light's intensity means."),
        click.option("--tolerance", type=click.FloatRange(min=0, min_open=True), metavar="PIXELS", show_default=False,
                     help="How far a mesh may be from the curved face that it stands for. [default: 0.1]"),
        click.option("--resolution", type=Numbers("WxH", "x", 2), help="Size of the image in pixels, such as 640x480."),
        click.option("--samples", type=click.IntRange(min=1), metavar="N",
                     help="N of the N-rook sampling: N samples a pass, at most N*N a pixel."),
        click.option("--allow-outside", is_flag=True, help="Let the scene use images from outside its folder."),
    ]):
        warning = option(warning)
    return warning
