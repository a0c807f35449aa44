"""The files of commands: scenes, states and parts that they read; places that they check before the work, and write."""

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

#: The first bytes of files that are no text, and their kinds.
MAGIC = {b"v/1\x01": EXR, b"\x89PNG": "a PNG image", b"\xff\xd8\xff": "a JPEG image", b"PK\x03\x04": ARCHIVE}

#: Advice for a file of another kind than a command needs.
USES = {
    XML: "To render it: prosim render {}",
    STATE: "To continue it: prosim resume {}",
    PART: "To merge all parts: prosim merge {}",
}

#: The suffixes of a state and of a part, after the name of the image.
STATE_SUFFIXES = re.compile(r"(\.state|\.\d+-of-(?P<of>\d+))\.npz$")


class InputFile(click.Path):
    """A file that exists, of one of these ``kinds``, all of which messages call ``what``.

    ``patterns``: names of such files; ``writer``: the command that writes one.
    """

    def __init__(self, what: str, kinds: Collection[str], patterns: Collection[str], writer: str = "") -> None:
        super().__init__(exists=True, dir_okay=False, path_type=Path)
        self.what, self.kinds, self.patterns = what, kinds, patterns
        self.writes = writer and f" {writer} writes one."

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Returns the path of the file."""
        path = Path(os.fsdecode(value))
        try:
            super().convert(value, param, ctx)
        except click.BadParameter as error:
            self.fail(error.message + self.suggestion(path), param, ctx)
        if (found := kind(path)) not in self.kinds:
            hint = f" {USES[found].format(quoted_path(path))}" if found in USES else self.suggestion(path)
            self.fail(f"'{path}' is {found}, not {self.what}.{hint or self.writes}", param, ctx)
        return path

    def suggestion(self, path: Path) -> str:
        """A question for the file of this kind in the same folder whose name is most like that of ``path``."""
        found = chain.from_iterable(map(path.parent.glob, self.patterns))
        files = {file.name.partition(".")[0]: file for file in found if file != path}
        near = difflib.get_close_matches(path.name.partition(".")[0], files, n=1)
        return f" Did you mean {quoted_path(files[near[0]])}?" if near else ""


SCENE_FILE = InputFile("a scene", (TEXT, XML), ("*.xml", "*.scn"))
LANGUAGE_FILE = InputFile("a scene in the thesis's language", (TEXT,), ("*.scn",))
STATE_FILE = InputFile(STATE, (STATE, PART), ("*.state.npz", "*.*-of-*.npz"), "prosim render --checkpoint")
PART_FILE = InputFile(PART, (PART,), ("*.*-of-*.npz",), "prosim render --part 1/4")


def image_stem(path: Path) -> Path:
    """The path of a state or a part without its suffixes, and of another file without its last one."""
    name = STATE_SUFFIXES.sub("", path.name)
    return path.with_name(name if name != path.name else path.stem)


def quoted_path(path: Path) -> str:
    """The path as an argument of a shell; for a part, a pattern of all parts of its image: ``night.*-of-4.npz``."""
    found = STATE_SUFFIXES.search(path.name)
    return f"{image_stem(path)}.*-of-{found['of']}.npz" if found and found["of"] else shlex.quote(str(path))


def kind(path: Path) -> str:
    """The kind of a file, by its first bytes and its suffix."""
    begin = b""
    if path.is_file():  # a pipe could not be read again
        with open(path, "rb") as file:
            begin = file.read(1 << 10)
        if not begin:
            return "an empty file"
    what = next((what for known, what in MAGIC.items() if begin.startswith(known)), None)
    if what == ARCHIVE:
        try:
            return STATE if checkpoint.read(path, arrays=False).part is None else PART
        except checkpoint.NotACheckpointError:
            return what
        except (checkpoint.CheckpointError, OSError):  # its command reports the error
            return STATE
    return what or (XML if path.suffix.lower() == ".xml" else TEXT)


# ---------------------------------------------------------------- output

#: Suffixes of files. One that is not written is a mistake, not a part of the name.
FILE_SUFFIXES = re.compile(
    r"\.(avi|bmp|csv|exr|gif|hdr|html|jpe?g|json|mov|mp4|npz|pdf|pfm|ply|png|ppm|rgbe|scn|svg|tga|tiff?|txt|web[mp]|xml)"
)


def output_stem(output: str | None, default: Path, suffixes: Collection[str]) -> Path:
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
    elif FILE_SUFFIXES.fullmatch(suffix) or output == "-" or (os.path.exists(path) and not path.is_file()):
        raise click.BadParameter(
            f"'{output}': the command writes {' and '.join(suffixes)} files; give their name, or a folder.",
            param_hint="-o",
        )
    else:
        path = path.with_name(path.name.rstrip(".") or path.name)  # a name that ends before its suffix
    return path


def output_folder(output: str | None) -> Path | None:
    """The folder of that name, which is the value of ``-o``. Raises BadParameter as :func:`output_stem` does."""
    if output is None:
        return None
    path = _expanded(output)
    if FILE_SUFFIXES.fullmatch(path.suffix.lower()) and not path.exists():
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
