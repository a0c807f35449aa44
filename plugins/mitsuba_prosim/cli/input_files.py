"""The files that commands take: scenes, states of a render, parts of an image."""

from __future__ import annotations

import difflib
import os
import re
import shlex
from abc import ABC, abstractmethod
from itertools import chain
from pathlib import Path
from typing import Any

import click

from ..engine import checkpoint

EXR, ARCHIVE = "an EXR image", "an archive"

#: The first bytes of files that are no scenes, and their kinds.
MAGIC = {
    b"v/1\x01": EXR,
    b"\x89PNG": "a PNG image",
    b"\xff\xd8\xff": "a JPEG image",
    b"ply": "a mesh",
    b"%PDF": "a PDF file",
    b"PK\x03\x04": ARCHIVE,
}

#: What follows the name of an image in that of its state, or of a part.
SUFFIXES = re.compile(r"(\.state|\.\d+-of-(?P<of>\d+))\.npz$|\.exr$")


class InputFile(click.Path, ABC):
    """A file that exists; a subclass says which kind it has to be of."""

    #: Patterns of the names of such files, the likeliest first.
    patterns: tuple[str, ...] = ()

    def __init__(self) -> None:
        super().__init__(exists=True, readable=True, path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Returns the path of the file."""
        path = Path(os.fsdecode(value))
        if path.is_dir():
            self.fail(f"'{path}' is a folder.{self.suggestion(path)}", param, ctx)
        if not os.path.lexists(path):
            nor = "" if path.parent.is_dir() else f" (nor does the folder '{path.parent}')"
            self.fail(f"File '{path}' does not exist{nor}.{self.suggestion(path)}", param, ctx)
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        if (wrong := self.wrong(path)) is not None:
            self.fail(f"'{path}' is {wrong}", param, ctx)
        return path

    @abstractmethod
    def wrong(self, path: Path) -> str | None:
        """The kind of a file of the wrong kind, and what to do; None for any other file."""

    def suggestion(self, path: Path) -> str:
        """A question for the file of this kind in the same folder, or in one below it, whose name is like ``path``."""
        folder = path if path.is_dir() else path.parent
        found = chain.from_iterable(folder.glob(below + one) for below in ("", "*/") for one in self.patterns)
        files: dict[str, Path] = {}
        for file in filter(lambda file: file != path, found):
            files.setdefault(stem(file).name, file)
        begin = path.name.partition(".")[0]
        likely = [*files] if path == folder else [begin] * (begin in files)
        likely += difflib.get_close_matches(path.stem, files, n=1)
        return f" Did you mean {parts(files[likely[0]])}?" if likely else ""


class SceneFile(InputFile):
    """A scene, in the thesis's language (any name) or XML."""

    patterns = ("*.scn", "*.xml")

    def wrong(self, path: Path) -> str | None:
        """As :meth:`InputFile.wrong`."""
        what = kind(path)
        part = is_part(path) if what in (EXR, ARCHIVE) else None
        if part:
            return f"a part of an image, not a scene. To merge all parts: prosim merge {parts(path)}"
        if part is not None:
            return f"the state of a render, not a scene. To continue it: prosim resume {shlex.quote(str(path))}"
        return what and f"{what}, not a scene.{self.suggestion(path)}"


class LanguageFile(SceneFile):
    """A scene in the thesis's language."""

    def wrong(self, path: Path) -> str | None:
        """As :meth:`InputFile.wrong`."""
        if path.suffix.lower() == ".xml":
            return f"a Mitsuba scene already. To render it: prosim render {shlex.quote(str(path))}"
        return super().wrong(path)


class StateFile(InputFile):
    """The state of a render, or a part of an image."""

    patterns: tuple[str, ...] = ("*.state.npz", "*.*-of-*.npz")
    described, writer = "the state of a render", "prosim render --keep"

    def wrong(self, path: Path) -> str | None:
        """As :meth:`InputFile.wrong`."""
        what = kind(path)
        if what in (EXR, ARCHIVE) and is_part(path) is not None:
            return None
        what = f"{what or 'a text file'}, not {self.described}."
        return what + (self.suggestion(path) or f" {self.writer} writes one.")


class PartFile(StateFile):
    """A part of an image."""

    patterns = ("*.*-of-*.npz",)
    described, writer = "a part of an image", "prosim render --part 1/4"


def stem(path: Path) -> Path:
    """The path of a state or a part without its suffixes, and of another file without its last."""
    name = SUFFIXES.sub("", path.name)
    return path.with_name(name if name != path.name else path.stem)


def parts(path: Path) -> str:
    """A pattern for all parts of the image of one: ``night.*-of-4.npz``; another path as it is."""
    found = SUFFIXES.search(path.name)
    return f"{stem(path)}.*-of-{found['of']}.npz" if found and found["of"] else str(path)


def kind(path: Path) -> str | None:
    """The kind of a file by its first bytes; None if they are unknown."""
    if not path.is_file():  # a pipe could not be read again
        return None
    with open(path, "rb") as file:
        begin = file.read(4)
    return next((what for known, what in MAGIC.items() if begin.startswith(known)), None)


def is_part(path: Path) -> bool | None:
    """Whether a file is the state of a part of an image; None if it is no state."""
    try:
        return checkpoint.about(path)["facts"]["part"] is not None
    except checkpoint.NotACheckpointError:
        return None
    except (checkpoint.CheckpointError, OSError):
        return False
