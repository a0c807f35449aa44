"""Checks the input files of commands (scenes, states, parts), checks before a render that the output files can be
written, and writes the output files.
"""

from __future__ import annotations

import difflib
import os
import re
import shlex
from collections.abc import Collection, Iterable, Mapping
from itertools import chain
from pathlib import Path
from typing import Any

import click

from .. import atomic
from ..engine import checkpoint
from .option_types import InputError

TEXT, XML, EXR, ARCHIVE, DEVICE = "a text file", "a Mitsuba scene", "an EXR image", "an archive", "a device or a pipe"
STATE, PART = "the state of a render", "a part of an image"

#: The first bytes of a binary file -> the kind of the file.
MAGIC = {b"v/1\x01": EXR, b"\x89PNG": "a PNG image", b"\xff\xd8\xff": "a JPEG image", b"PK\x03\x04": ARCHIVE}

#: Kind of a file that a command does not accept -> advice which command accepts it.
USES = {
    XML: "To render it: prosim render {}",
    STATE: "To continue it: prosim resume {}",
    PART: "To merge all parts: prosim merge {}",
}

#: Matches the suffixes of a state or of a part, which follow the name of the image.
STATE_SUFFIXES = re.compile(r"(\.state|\.\d+-of-(?P<of>\d+))\.npz$")


class InputFile(click.Path):
    """The click type of an argument that names an existing file of one of ``kinds``, see :func:`kind`.

    In error messages, ``what`` names the allowed files, and ``writer`` is the prosim command that writes them.
    ``patterns`` match their names.
    """

    def __init__(self, what: str, kinds: Collection[str], patterns: Collection[str], writer: str = "") -> None:
        super().__init__(exists=True, dir_okay=False, path_type=Path)
        self.what, self.kinds, self.patterns = what, kinds, patterns
        self.writes = writer and f" {writer} writes one."  # the end of a message

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Returns the path of the file; raises BadParameter for a file that is missing or not allowed."""
        path = Path(os.fsdecode(value))
        try:
            super().convert(value, param, ctx)
        except click.BadParameter as error:
            self.fail(error.message + self.suggestion(path), param, ctx)
        if (actual := kind(path)) not in self.kinds:
            hint = f" {USES[actual].format(quoted_path(path))}" if actual in USES else self.suggestion(path)
            self.fail(f"'{path}' is {actual}, not {self.what}.{hint or self.writes}", param, ctx)
        return path

    def suggestion(self, path: Path) -> str:
        """Returns " Did you mean FILE?", with the most similar name in the folder that matches a pattern, or "". Only
        the parts of the names before the first dot are compared.
        """
        candidates = chain.from_iterable(map(path.parent.glob, self.patterns))
        files = {file.name.partition(".")[0]: file for file in candidates if file != path}
        near = difflib.get_close_matches(path.name.partition(".")[0], files, n=1)
        return f" Did you mean {quoted_path(files[near[0]])}?" if near else ""


SCENE_FILE = InputFile("a scene", (TEXT, XML), ("*.xml", "*.scn"))
LANGUAGE_FILE = InputFile("a scene in the thesis's language", (TEXT,), ("*.scn",))
STATE_FILE = InputFile(STATE, (STATE, PART), ("*.state.npz", "*.*-of-*.npz"), "prosim render --checkpoint")
IMAGE_FILE = InputFile("an EXR image", (EXR,), ("*.exr",), "prosim render --layers")
PART_FILE = InputFile(PART, (PART,), ("*.*-of-*.npz",), "prosim render --part 1/4")


def image_stem(path: Path) -> Path:
    """Returns the path of an image without suffix, from the path of its state, of a part, or of another file."""
    name = STATE_SUFFIXES.sub("", path.name)
    return path.with_name(name if name != path.name else path.stem)


def quoted_path(path: Path) -> str:
    """Returns the path as an argument of a shell command; for a part of an image, a pattern for all its parts."""
    part = STATE_SUFFIXES.search(path.name)
    if part and part["of"]:
        return f"{shlex.quote(str(image_stem(path)))}.*-of-{part['of']}.npz"
    return shlex.quote(str(path))


def kind(path: Path) -> str:
    """Returns the kind of a file, such as "an EXR image", by its first bytes and its suffix.

    An unknown file or a pipe is a text, or a Mitsuba scene if its suffix is .xml. A checkpoint that cannot be read
    counts as the state of a render. Raises OSError if the file cannot be opened.
    """
    if not path.is_file() and (not path.is_fifo() or path.suffix.lower() == ".xml"):  # XML is read several times
        return DEVICE
    begin = b""
    if path.is_file():  # the content of a pipe can be read only once
        with open(path, "rb") as file:
            begin = file.read(1 << 10)
        if not begin:
            return "an empty file"
    name = next((name for known, name in MAGIC.items() if begin.startswith(known)), None)
    if name == ARCHIVE:
        try:
            return STATE if checkpoint.read(path, arrays=False).part is None else PART
        except checkpoint.NotACheckpointError:
            return name
        except (checkpoint.CheckpointError, OSError):  # the command that reads the state reports the error
            return STATE
    return name or (XML if path.suffix.lower() == ".xml" else TEXT)


# ---------------------------------------------------------------- output

#: Known suffixes of files. A known suffix that the command does not write is a mistake, not a part of the file's name.
FILE_SUFFIXES = re.compile(
    r"\.(avi|bmp|csv|exr|gif|hdr|html|jpe?g|json|mov|mp4|npz|pdf|pfm|ply|png|ppm|rgbe|scn|svg|tga|tiff?|txt|web[mp]|xml)"
)


def output_stem(output: str | None, default: Path, suffixes: Collection[str]) -> Path:
    """Returns the common path of a command's output files, without suffix.

    ``output`` is the value of the option ``-o``: None for ``default``, a folder for the name of ``default`` in it, or a
    file name, with or without one of the ``suffixes`` of the output files. Raises the errors of :func:`output_path`.
    """
    if output is None:
        return default
    path = output_path(output, suffixes)
    if output.endswith(("/", os.sep)) or os.path.isdir(path):
        return path / default.name
    while path.suffix.lower() in suffixes:  # image.exr.png
        path = path.with_suffix("")
    return path.with_name(path.name.rstrip(".") or path.name)  # without a dot at the end of the name


def output_path(output: str, suffixes: Collection[str] = ()) -> Path:
    """Returns ``output``, the value of the option ``-o``, as a path, with the user's home folder for ``~``, which the
    shell does not replace in quotes and after ``=``.

    Raises BadParameter unless ``output`` names a folder, or a file with one of the ``suffixes`` or no known suffix
    (:data:`FILE_SUFFIXES`). Without ``suffixes``, it must name a folder.
    """
    path = Path(os.path.expanduser(output))
    suffix, is_device = path.suffix.lower(), os.path.exists(path) and not path.is_file()
    is_other_file = suffix not in suffixes and FILE_SUFFIXES.fullmatch(suffix)
    if not output or ((is_other_file or is_device or output == "-") and not os.path.isdir(path)):
        named = f"expected a name or a folder for {' and '.join(suffixes)} files"
        wanted = named if suffixes else "give a folder; its files get the scene's name"
        raise click.BadParameter(f"'{output}': {wanted}.", param_hint="-o")
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
