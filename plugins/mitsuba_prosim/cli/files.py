"""The files of commands: finds the input files, checks before a render that the output files can be written, and writes
them.
"""

import difflib
import os
import re
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import click

from .. import atomic
from .option_types import InputError

#: Suffix of a file that a command does not read -> what the file is, and which command reads it.
USES = {
    ".npz": "the state or a part of a render; continue it by prosim resume, or merge all parts by prosim merge",
    ".exr": "an image; prosim mix changes the lamps of an image with layers",
    ".xml": "a Mitsuba scene; render it by prosim render",
    ".scn": "a scene in the thesis's language; render it by prosim render",
}


class InputFile(click.Path):
    """The click type of an argument that names an existing file with one of the suffixes ``read``, or with another one
    that is not in :data:`USES`. A scene may be a pipe, but not one with XML, which Mitsuba reads several times.
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
        if not path.is_file() and not (path.is_fifo() and ".scn" in self.read and suffix != ".xml"):
            self.fail(f"'{path}' is a device or a pipe; give a file.", param, ctx)
        return path


SCENE_FILE, LANGUAGE_FILE = InputFile(".scn", ".xml"), InputFile(".scn")
STATE_FILE, IMAGE_FILE = InputFile(".npz"), InputFile(".exr")

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
    if output and (output.endswith(("/", os.sep)) or path.is_dir()):
        return path / default.name
    suffix = path.suffix.lower()
    if suffix in suffixes:
        return path.with_suffix("")
    if FOREIGN.fullmatch(suffix) or path.name in ("", "-") or (path.exists() and not path.is_file()):
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
