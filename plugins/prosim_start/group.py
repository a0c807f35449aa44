"""The commands of ``prosim`` by name; the module of a command is imported when the command is called."""

import gc
import os
import pkgutil
import sys
import warnings
from contextlib import suppress
from typing import Any

import click

#: Name of a command -> (its module and function, its description).
COMMANDS = {
    "check": ("mitsuba_prosim.cli.check_command:check", "Test whether a plugin is right."),
    "compare": ("mitsuba_prosim.cli.pages:compare", "Compare two integrators or samplers on a scene."),
    "doctor": ("mitsuba_prosim.cli.doctor:doctor", "Print versions, backends and problems."),
    "explain": ("mitsuba_prosim.cli.pages:explain", "Explain why a pixel of a scene has its value."),
    "format": ("mitsuba_prosim.cli.translate:format_scene", "Rewrite scenes in canonical layout."),
    "language-server": ("prosim_scene.editor.language_server:language_server", "Help an editor with scenes."),
    "link": ("mitsuba_prosim.stock_command.link:link", "Let the mitsuba command run plugins in Python."),
    "merge": ("mitsuba_prosim.cli.render_commands:merge", "Merge the separately rendered parts of an image."),
    "mix": ("mitsuba_prosim.cli.mix:mix", "Dim and colour the lamps of a rendered image."),
    "render": ("mitsuba_prosim.cli.render_commands:render", "Render a scene to an EXR and a PNG image."),
    "resume": ("mitsuba_prosim.cli.render_commands:resume", "Continue a render from its saved state."),
    "translate": ("mitsuba_prosim.cli.translate:translate", "Translate the scene language to Mitsuba's XML."),
    "watch": ("mitsuba_prosim.cli.watch:watch", "Show a scene on a page while you edit it."),
}


class Commands(click.Group):
    """A group of commands that lists and suggests commands without importing them."""

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Imports the module of the command with this name, and returns the command; None for an unknown name."""
        if cmd_name not in COMMANDS:
            return None
        command: click.Command = pkgutil.resolve_name(COMMANDS[cmd_name][0])
        if not gc.isenabled():  # :func:`.main` has disabled it
            gc.freeze()  # modules stay until the end
            gc.enable()
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Returns the command that the first argument names.

        Raises UsageError for an unknown command; if the first argument is a file, the error message tells how to render
        this file.
        """
        if args[0] not in COMMANDS and os.path.isfile(args[0]) and not ctx.resilient_parsing:
            ctx.fail(f"No such command '{args[0]}'. To render that file: prosim render {args[0]}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Writes the list of commands to the help."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, COMMANDS[name][1]) for name in self.list_commands(ctx)])


@click.group(
    cls=Commands,
    commands=dict.fromkeys(COMMANDS),
    context_settings={"help_option_names": ["-h", "--help"], "show_default": True},
)
@click.version_option(None, "-V", "--version", package_name="mitsuba-prosim")
def prosim() -> None:
    """Renders scenes with Mitsuba 3 until their error is what you ask for.

    Exit codes: 0: success. 2: wrong use or wrong input; no file was written. 130: Ctrl-C before the first sample; no
    file was written. 1: any other error, or Ctrl-C later; the unfinished image was written.
    """
    shown_warnings = set()

    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        """Prints each warning once, above the progress bar."""
        from tqdm import tqdm  # imported only if there is a warning

        if str(message) not in shown_warnings:  # Python would show a message again after a change of its filters
            shown_warnings.add(str(message))
            with suppress(OSError):  # the terminal was closed, and the image must not be lost
                tqdm.write(f"warning: {message}", file=sys.stderr)

    warnings.showwarning = show
    warnings.simplefilter("always", UserWarning, append=True)
