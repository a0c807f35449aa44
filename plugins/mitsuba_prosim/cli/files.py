"""The output files of commands: checks before a render that they can be written, and writes them."""

import os
import re
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path

import click

from .. import atomic
from .option_types import InputError

#: Suffixes of files that a user might want, but no command writes.
FOREIGN = re.compile(r"\.(bmp|exr|gif|hdr|html|jpe?g|json|mp4|npz|pdf|pfm|ply|png|ppm|scn|svg|tga|tiff?|txt|webp|xml)")


def image_stem(path: Path) -> Path:
    """Returns the path of an image without suffix, from the path of its state, of a part, or of another file."""
    name = re.sub(r"(\.state|\.\d+-of-\d+)\.npz$", "", path.name)
    return path.with_name(name if name != path.name else path.stem)


def output_stem(output: str | None, default: Path, suffixes: Collection[str]) -> Path:
    """Returns the common path of a command's output files, without suffix.

    ``output`` is the value of the option ``-o``: None for ``default``, a folder for the name of ``default`` in it, or a
    file name, with or without one of the ``suffixes`` of the output files. ``~`` is the user's home folder, which the
    shell does not insert in quotes and after ``=``. Raises BadParameter for the suffix of another kind of file and for
    a device or a pipe.
    """
    if output is None:
        return default
    path = Path(os.path.expanduser(output))
    if output and (output.endswith(("/", os.sep)) or os.path.isdir(path)):
        return path / default.name
    suffix = path.suffix.lower()
    if suffix in suffixes:
        return path.with_suffix("")
    if FOREIGN.fullmatch(suffix) or path.name in ("", "-") or (os.path.exists(path) and not os.path.isfile(path)):
        raise click.BadParameter(f"'{output}': give a name or a folder for {' and '.join(suffixes)}.", param_hint="-o")
    return path


def with_suffixes(stem: Path, suffixes: Iterable[str]) -> list[Path]:
    """Returns the paths of the output files."""
    return [stem.with_name(stem.name + suffix) for suffix in suffixes]


def check(stem: Path, suffixes: Collection[str], size: int, sources: Iterable[Path]) -> None:
    """Raises InputError if the output files, which together have ``size`` bytes, cannot be written, or if one of them
    is one of the input files ``sources``.
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
    """Writes the output files, suffix -> content, and returns their paths.

    If a file cannot be written, all files are written to another folder, and a ClickException tells which.
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
    """Returns a text with the file name and the message of an error of the operating system."""
    return ": ".join(map(str, filter(None, (error.filename, error.strerror)))) or str(error)
