"""The files that commands are given (scenes, states, parts), and what is said where one is of another kind."""

from __future__ import annotations

import difflib
import os
import re
import shlex
from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from ..scene import scene_file

EXR = "an EXR image"

#: What a file begins with that is no scene, and what it is.
BEGINNINGS = {
    scene_file.EXR: EXR,
    b"\x89PNG": "a PNG image",
    b"\xff\xd8\xff": "a JPEG image",
    b"GIF8": "a GIF image",
    b"II*\0": "a TIFF image",
    b"MM\0*": "a TIFF image",
    b"ply\n": "a mesh",
    b"ply\r": "a mesh",
    b"%PDF": "a PDF",
    b"PK\x03\x04": "an archive",
    b"\x1f\x8b": "a compressed file",
}

#: Suffixes of scenes, the likeliest first; those in the thesis's language may have any other, or none.
SCENES = (".scn", ".xml")

#: Name of a part without its number.
PART_NAME = re.compile(r"^(?P<stem>.+)\.\d+-of-(?P<of>\d+)\.exr$")


class Existing(click.Path, ABC):
    """A file that is there. A subclass says what kind it has to be of, and which others may have been meant."""

    def __init__(self) -> None:
        super().__init__(exists=True, dir_okay=False, readable=True, path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Its path."""
        path = Path(os.fsdecode(value))
        if path.is_dir():
            self.fail(f"'{path}' is a folder.{did_you_mean(self.within(path))}", param, ctx)
        if not os.path.lexists(path):
            nor = "" if path.parent.is_dir() else f" (nor does the folder '{path.parent}')"
            self.fail(f"File '{path}' does not exist{nor}.{did_you_mean(self.near(path))}", param, ctx)
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        if (what := self.wrong(path)) is not None:
            self.fail(f"'{path}' is {what}", param, ctx)
        return path

    @abstractmethod
    def wrong(self, path: Path) -> str | None:
        """What a file is that is of another kind, and what to do; None where it may be of the right one."""

    @abstractmethod
    def within(self, folder: Path) -> Iterator[str]:
        """What may be meant in a folder, the likeliest first."""

    @abstractmethod
    def meant(self, stem: Path) -> Iterator[str]:
        """What may be meant by a path without its suffixes, the likeliest first."""

    def near(self, path: Path) -> Iterator[str]:
        """What may be meant by a path, the likeliest first."""
        stem = path.name
        while stem:
            yield from (found for found in self.meant(path.with_name(stem)) if found != str(path))
            stem = stem.rpartition(".")[0]
        if path.parent.is_dir():
            likeliest_last = [found for found in self.within(path.parent) if found != str(path)][::-1]
            there = {Path(found).stem: found for found in likeliest_last}
            yield from (there[stem] for stem in difflib.get_close_matches(path.stem, there, n=1))


class SceneFile(Existing):
    """A scene, in the thesis's language or XML."""

    def wrong(self, path: Path) -> str | None:
        """What a file is that is no scene, and what to do; None where it may be one."""
        what = beginning(path)
        state = state_of(path) if what == EXR else None
        if state:
            return f"a part of an image, not a scene. To put all of them together: prosim merge {pattern(path)}"
        if state is not None:
            return f"the state of a render, not a scene. To go on with it: prosim resume {shlex.quote(str(path))}"
        return what and f"{what}, not a scene.{did_you_mean(self.near(path))}"

    def within(self, folder: Path) -> Iterator[str]:
        """Its scenes."""
        for suffix in SCENES:
            yield from map(str, sorted(folder.glob(f"*{suffix}")))

    def meant(self, stem: Path) -> Iterator[str]:
        """The scene of that name."""
        for suffix in SCENES:
            if (path := stem.with_name(stem.name + suffix)).is_file():
                yield str(path)


class LanguageFile(SceneFile):
    """A scene in the thesis's language."""

    def wrong(self, path: Path) -> str | None:
        """What a file is that is of another kind, and what to do; None where it may be of this one."""
        if path.suffix.lower() == ".xml":
            return f"a scene of Mitsuba's already. To render it: prosim render {shlex.quote(str(path))}"
        return super().wrong(path)


class State(Existing):
    """The state of a render, or a part of one."""

    #: What it has to be, and what writes it.
    kind, writes = "the state of a render", "prosim render --keep"

    def wrong(self, path: Path) -> str | None:
        """What a file is that is no state, and what to do; None where it may be one."""
        what = beginning(path)
        if what == EXR and state_of(path) is not None:
            return None
        if what is None and path.suffix.lower() in SCENES:
            what = "a scene"
        hint = did_you_mean(self.near(path)) or f" {self.writes} writes one."
        return f"{what + ', ' if what else ''}not {self.kind}.{hint}"

    def within(self, folder: Path) -> Iterator[str]:
        """Its states, and parts."""
        yield from map(str, sorted(folder.glob("*.state.exr")))
        yield from map(str, sorted(path for path in folder.glob("*-of-*.exr") if PART_NAME.match(path.name)))

    def meant(self, stem: Path) -> Iterator[str]:
        """The state of that name."""
        for suffix in (".state.exr", ".exr"):
            path = stem.with_name(stem.name + suffix)
            if path.is_file() and state_of(path) is not None:
                yield str(path)


class PartFile(State):
    """A part of an image."""

    kind, writes = "a part of an image", "prosim render --part 1/4"

    def within(self, folder: Path) -> Iterator[str]:
        """Its parts, all of an image by one pattern."""
        found = (path for path in sorted(folder.glob("*-of-*.exr")) if PART_NAME.match(path.name))
        yield from dict.fromkeys(map(pattern, found))

    def meant(self, stem: Path) -> Iterator[str]:
        """The parts of that name."""
        for found in self.within(stem.parent) if stem.parent.is_dir() else ():
            if Path(found).name.startswith(stem.name + ".*-of-"):
                yield found


#: Types of arguments.
SCENE, LANGUAGE, STATE, PART = SceneFile(), LanguageFile(), State(), PartFile()


def did_you_mean(paths: Iterator[str]) -> str:
    """The first of them as a question; empty where there is none."""
    first = next(paths, None)
    return f" Did you mean {first}?" if first else ""


def beginning(path: Path) -> str | None:
    """What a file is, by its first bytes; None where these are of nothing that is known."""
    if not path.is_file():  # a pipe could not be read again
        return None
    with open(path, "rb") as file:
        begin = file.read(4)
    return next((what for known, what in BEGINNINGS.items() if begin.startswith(known)), None)


def state_of(path: Path) -> bool | None:
    """Whether an EXR file is the state of a part of an image alone; None where it is none at all."""
    from .. import saved

    try:
        return saved.about(path)["facts"]["part"] is not None
    except saved.NoStateError:
        return None
    except (saved.StateError, OSError):
        return False


def pattern(path: Path) -> str:
    """What the shell makes all parts of the image of: ``night.*-of-4.exr``."""
    return PART_NAME.sub(r"\g<stem>.*-of-\g<of>.exr", str(path))
