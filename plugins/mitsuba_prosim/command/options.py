"""Options and argument types that several commands share."""

from pathlib import Path

import click

SCENE = click.Path(exists=True, dir_okay=False, readable=True, path_type=Path)


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


def translation(command):
    """Decorator: the options for scenes in the thesis's language."""
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
        command = option(command)
    return command
