"""The files that commands take: scenes, states of a render, parts of an image."""

from __future__ import annotations

import difflib
import os
import re
import shlex
from collections.abc import Collection
from itertools import chain
from pathlib import Path
from typing import Any

import click

from ..engine import checkpoint

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

#: The suffixes of the files of a state, or of a part, after the name of the image.
SUFFIXES = re.compile(r"(\.state|\.\d+-of-(?P<of>\d+))\.npz$|\.exr$")


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
            hint = f" {USES[found].format(parts(path))}" if found in USES else self.suggestion(path)
            self.fail(f"'{path}' is {found}, not {self.what}.{hint or self.writes}", param, ctx)
        return path

    def suggestion(self, path: Path) -> str:
        """A question for the file of this kind in the same folder whose name begins like that of ``path``."""
        found = chain.from_iterable(map(path.parent.glob, self.patterns))
        files = {file.name.partition(".")[0]: file for file in found if file != path}
        near = difflib.get_close_matches(path.name.partition(".")[0], files, n=1)
        return f" Did you mean {parts(files[near[0]])}?" if near else ""


SCENE_FILE = InputFile("a scene", (TEXT, XML), ("*.xml", "*.scn"))
LANGUAGE_FILE = InputFile("a scene in the thesis's language", (TEXT,), ("*.scn",))
STATE_FILE = InputFile(STATE, (STATE, PART), ("*.state.npz", "*.*-of-*.npz"), "prosim render --checkpoint")
PART_FILE = InputFile(PART, (PART,), ("*.*-of-*.npz",), "prosim render --part 1/4")


def stem(path: Path) -> Path:
    """The path of a state or a part without its suffixes, and of another file without its last."""
    name = SUFFIXES.sub("", path.name)
    return path.with_name(name if name != path.name else path.stem)


def parts(path: Path) -> str:
    """A pattern for all parts of the image of one: ``night.*-of-4.npz``; another path, in quotes if need be."""
    found = SUFFIXES.search(path.name)
    return f"{stem(path)}.*-of-{found['of']}.npz" if found and found["of"] else shlex.quote(str(path))


def kind(path: Path) -> str:
    """The kind of a file, by its first bytes and its suffix."""
    if path.is_file():  # a pipe could not be read again
        with open(path, "rb") as file:
            begin = file.read(4)
        what = next((what for known, what in MAGIC.items() if begin.startswith(known)), None)
        if what == ARCHIVE:
            try:
                return STATE if checkpoint.read(path, arrays=False).part is None else PART
            except checkpoint.NotACheckpointError:
                return what
            except (checkpoint.CheckpointError, OSError):  # its command reports the error
                return STATE
        if what:
            return what
    return XML if path.suffix.lower() == ".xml" else TEXT
