"""Checks the input files of commands (scenes, states, parts), checks before the work that the output can be written,
and writes the output.
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

TEXT, XML, EXR, ARCHIVE = "a text file", "a Mitsuba scene", "an EXR image", "an archive"
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
    """The type of an argument that is an existing file. ``kinds`` are the kinds of files that are allowed.

    ``what`` is the name of the allowed files in messages. ``patterns`` match the names of allowed files. ``writer`` is
    the command that writes allowed files.
    """

    def __init__(self, what: str, kinds: Collection[str], patterns: Collection[str], writer: str = "") -> None:
        super().__init__(exists=True, dir_okay=False, path_type=Path)
        self.what, self.kinds, self.patterns = what, kinds, patterns
        self.writes = writer and f" {writer} writes one."  # the end of a message

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Returns the path of the file. Fails for a missing file, and for a file of another kind."""
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
        """Returns " Did you mean FILE?", or "" if there is no such file.

        FILE is in the folder of ``path``, matches one of ``patterns``, and has the name most similar to that of
        ``path``.
        """
        candidates = chain.from_iterable(map(path.parent.glob, self.patterns))
        files = {file.name.partition(".")[0]: file for file in candidates if file != path}
        near = difflib.get_close_matches(path.name.partition(".")[0], files, n=1)
        return f" Did you mean {quoted_path(files[near[0]])}?" if near else ""


SCENE_FILE = InputFile("a scene", (TEXT, XML), ("*.xml", "*.scn"))
LANGUAGE_FILE = InputFile("a scene in the thesis's language", (TEXT,), ("*.scn",))
STATE_FILE = InputFile(STATE, (STATE, PART), ("*.state.npz", "*.*-of-*.npz"), "prosim render --checkpoint")
PART_FILE = InputFile(PART, (PART,), ("*.*-of-*.npz",), "prosim render --part 1/4")


def image_stem(path: Path) -> Path:
    """Returns the path of the image without suffix, for the path of a state, of a part, or of any other file."""
    name = STATE_SUFFIXES.sub("", path.name)
    return path.with_name(name if name != path.name else path.stem)


def quoted_path(path: Path) -> str:
    """Returns the path as an argument of a shell.

    The path of a part becomes a pattern that matches all parts of its image, such as ``night.*-of-4.npz``.
    """
    match = STATE_SUFFIXES.search(path.name)
    return (
        f"{shlex.quote(str(image_stem(path)))}.*-of-{match['of']}.npz"
        if match and match["of"]
        else shlex.quote(str(path))
    )


def kind(path: Path) -> str:
    """Returns the kind of a file in words, such as "an EXR image"; the first bytes and the suffix decide."""
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
    """Returns the path of the output files without suffix. ``suffixes`` are the suffixes that this function removes.

    ``output`` is the value of ``-o``: a file name with or without one of the suffixes, a folder, or None. If ``output``
    is None, the result is ``default``. If ``output`` is a folder, the name of ``default`` is appended. Raises the
    errors of :func:`output_path`.
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
    """Returns the value of ``-o`` as a path, and replaces ``~`` by the user's home folder.

    The shell does not replace ``~`` in quotes and after ``=``. The path is a folder, or the name of files with
    ``suffixes``; without ``suffixes``, only a folder. Raises BadParameter if ``output`` is empty, names a file of
    another kind, or names a device.
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
    """Returns the paths of the output files: ``stem`` with each suffix."""
    return [stem.with_name(stem.name + suffix) for suffix in suffixes]


def check(stem: Path, suffixes: Collection[str], size: int, sources: Iterable[Path]) -> None:
    """Raises InputError if the output files, which together have ``size`` bytes, cannot be written.

    Raises InputError, too, if an output file would overwrite an input file, one of the ``sources``.
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
    """Writes the output files, whose ``contents`` are given by suffix; returns the paths.

    If a file cannot be written, this function writes all files to another folder. It then raises a ClickException,
    which names the files in that folder, or tells that they could not be written either.
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
    """Returns the file name and the message of an error of the operating system."""
    return ": ".join(map(str, filter(None, (error.filename, error.strerror)))) or str(error)
