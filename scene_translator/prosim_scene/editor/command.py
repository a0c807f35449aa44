"""``prosim language-server``."""

import click

from .. import extras


@click.command("language-server")
def language_server() -> None:
    """Help an editor with scenes: errors while you write, completion, meanings, renaming, layout.

    An editor starts it, and speaks with it by standard input and output.
    """
    try:
        from .server import serve
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in ("pygls", "lsprotocol"):
            raise
        raise click.ClickException(extras.needs("the language server", "editors")) from None
    serve()
