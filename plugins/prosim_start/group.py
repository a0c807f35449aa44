"""The commands of ``prosim`` by name; each is imported when it is called."""

import importlib
import os
import sys
import warnings

import click

from . import guesses

#: Name -> (where the command is, what it does).
COMMANDS = {
    "compare": ("compare:compare", "Compare two integrators or samplers on a scene."),
    "doctor": ("doctor:doctor", "Print what was found on this machine."),
    "format": ("translate:format_scene", "Rewrite scenes in tidy form."),
    "language-server": ("prosim_scene.language_server:language_server", "Help an editor with scenes."),
    "link": ("mitsuba_prosim.stock_command.link:link", "Let the mitsuba command run plugins in Python."),
    "merge": ("merge:merge", "Make the image of parts that were rendered one by one."),
    "render": ("render:render", "Render a scene to an EXR and a PNG image."),
    "resume": ("resume:resume", "Go on with a render from its saved state."),
    "translate": ("translate:translate", "Translate the scene language to Mitsuba's XML."),
    "watch": ("watch:watch", "Show a scene's picture while the scene is written."),
}

#: What may be meant by words that are no commands.
MEANT = {
    "continue": "prosim resume STATE",
    "denoise": "prosim render SCENE --denoise",
    "film": "prosim render SCENE --frames 0:48",
    "frames": "prosim render SCENE --frames 0:48",
    "help": "prosim -h",
    "keep": "prosim render SCENE --keep",
    "part": "prosim render SCENE --part 1/4",
    "version": "prosim -V",
}


class Commands(click.Group):
    """A group that lists its commands without importing them."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """All names."""
        return sorted(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of that name, or None."""
        if cmd_name not in COMMANDS:
            return None
        module, _, name = COMMANDS[cmd_name][0].partition(":")
        module = module if "." in module else f"mitsuba_prosim.command.{module}"
        command: click.Command = getattr(importlib.import_module(module), name)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The command that the first of the words names; for a name that there is not, an error with the nearest."""
        name = args[0]
        if name not in COMMANDS and not name.startswith("-") and not ctx.resilient_parsing:
            import difflib  # slow to import, and seldom needed
            import shlex

            if os.path.isfile(name):
                ctx.fail(f"No such command {name!r}. To render that file: prosim render {shlex.quote(name)}")
            if name.lower() in MEANT:
                ctx.fail(f"No such command {name!r}. Did you mean {MEANT[name.lower()]}?")
            near = difflib.get_close_matches(name.lower(), COMMANDS, n=1)
            ctx.fail(
                f"No such command {name!r}. "
                + (f"Did you mean {near[0]}?" if near else f"There are {', '.join(COMMANDS)}.")
            )
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> object:
        """Runs the command; where that has not an option which it is given, the error says which may be meant."""
        try:
            return super().invoke(ctx)
        except click.UsageError as error:
            if error.ctx is not None:
                known = {name for option in error.ctx.command.params for name in option.opts}
                message, said = error.message, None
                if isinstance(error, click.NoSuchOption):
                    said = guesses.meant(error.option_name, known)
                elif said := guesses.meant_by_plus(error.message, known):
                    message = f"{error.format_message().rstrip('.')}."
                if said:
                    raise click.UsageError(f"{message} {said}", error.ctx) from None
            raise

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Writes the list of commands."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, COMMANDS[name][1]) for name in self.list_commands(ctx)])


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "show_default": True})
@click.version_option(None, "-V", "--version", package_name="mitsuba-prosim")
def prosim() -> None:
    """Stochastic ray tracing after Besuievsky (1992), in Mitsuba 3.

    Exit codes: 0 done; 2 wrong use or wrong input, nothing written; 130 Ctrl-C, nothing kept; 1 anything else.
    """
    said = set()

    def show(text: str) -> None:
        if text not in said:
            said.add(text)
            if "tqdm" in sys.modules:  # out of a progress bar's way
                sys.modules["tqdm"].tqdm.write(text, file=sys.stderr)
            else:
                click.echo(text, err=True)

    # Python itself forgets what it has said whenever its filters change.
    warnings.showwarning = lambda message, *_: show(f"warning: {message}")
