"""Checks before the work whether a command can write its files, and rescues them if writing fails later."""

import os
import re
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path

import click

from .. import atomic
from .option_types import InputError

#: Suffixes of files. One that is not written is a mistake, not a part of the name.
KNOWN = re.compile(
    r"\.(avi|bmp|csv|exr|gif|hdr|html|jpe?g|json|mov|mp4|npz|pdf|pfm|ply|png|ppm|rgbe|scn|svg|tga|tiff?|txt|web[mp]|xml)"
)


def stem(output: str | None, default: Path, suffixes: Collection[str]) -> Path:
    """The path, without suffix, of the files with all of ``suffixes``.

    ``output``: the value of ``-o``, a file with one of them or without, or a folder; None for ``default``. Raises
    BadParameter where it is empty, another kind of file, or a device.
    """
    if output is None:
        return default
    path = _expanded(output)
    suffix = path.suffix.lower()
    if output.endswith(("/", os.sep)) or os.path.isdir(path):
        path /= default.name
    elif suffix in suffixes:
        while path.suffix.lower() in suffixes:  # image.exr.png
            path = path.with_suffix("")
    elif KNOWN.fullmatch(suffix) or output == "-" or (os.path.exists(path) and not path.is_file()):
        raise click.BadParameter(
            f"'{output}': the command writes {' and '.join(suffixes)} files; give their name, or a folder.",
            param_hint="-o",
        )
    else:
        path = path.with_name(path.name.rstrip(".") or path.name)  # a name that ends before its suffix
    return path


def folder(output: str | None) -> Path | None:
    """The folder of that name, which is the value of ``-o``. Raises BadParameter as :func:`stem` does."""
    if output is None:
        return None
    path = _expanded(output)
    if KNOWN.fullmatch(path.suffix.lower()) and not path.exists():
        raise click.BadParameter(f"'{output}': give a folder; its files get the scene's name.", param_hint="-o")
    return path


def _expanded(output: str) -> Path:
    """The path, with the user's folder for ``~``, which the shell does not replace in quotes and after ``=``."""
    if not output:
        raise click.BadParameter("expected a name or a folder, found nothing.", param_hint="-o")
    return Path(os.path.expanduser(output))


def with_suffixes(stem: Path, suffixes: Iterable[str]) -> list[Path]:
    """The paths that are written."""
    return [stem.with_name(stem.name + suffix) for suffix in suffixes]


def check(stem: Path, suffixes: Collection[str], size: int, sources: Iterable[Path]) -> None:
    """Raises InputError if files of ``size`` bytes in all could not be written, or one of the ``sources`` would be
    overwritten.
    """
    try:
        atomic.check(with_suffixes(stem, suffixes), size)
    except OSError as error:
        raise InputError(f"the result can't be written: {reason(error)}. Choose another place with -o.") from None
    existing = [path for path in sources if path.exists()]
    for path in with_suffixes(stem, suffixes):
        if path.exists() and any(path.samefile(source) for source in existing):
            raise InputError(f"{path} is an input of this command; choose another name with -o.")


def save(stem: Path, contents: Mapping[str, atomic.Content]) -> list[Path]:
    """Writes suffix -> content; returns the paths. Files that can't be written there are written to another folder.

    Raises ClickException, which says where that is.
    """
    files = dict(zip(with_suffixes(stem, contents), contents.values()))
    try:
        return atomic.write(files)
    except OSError as error:
        failure = f"{' and '.join(map(str, files))} could not be written: {reason(error)}"
    try:
        rescued = atomic.rescue(files)
    except OSError as error:
        raise click.ClickException(f"{failure}; nor could anything else: {reason(error)}") from None
    raise click.ClickException(f"{failure}. The result is in {' and '.join(map(str, rescued))}") from None


def reason(error: OSError) -> str:
    """The file and the message of an error of the system."""
    return ": ".join(map(str, filter(None, (error.filename, error.strerror)))) or str(error)
