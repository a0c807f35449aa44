"""The frames of a film: which, where, and of what each is made."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import OpenEXR
from prosim_scene import FRAME, TIME

from .. import saved
from ..engine.record import Record
from ..saved import origin
from ..scene import scene_file
from .job import Job
from .making import STATE

#: What a frame's EXR says of what it was made of; see :func:`digest`.
DIGEST = "prosim.digest"


@dataclass(frozen=True)
class Frame:
    """A frame that is to be made. ``stem``: its path without suffix; ``made_of``: its :func:`digest`."""

    number: int
    job: Job
    stem: Path
    file: scene_file.SceneFile
    made_of: str

    @property
    def facts(self) -> dict[str, str]:
        """Its metadata, beside those of every image."""
        return {DIGEST: self.made_of, "prosim.frame": str(self.number)}

    def sources(self) -> list[Path]:
        """The files that it is made of, but for the scene itself."""
        return [path.resolve() for _, path in self.file.named_files()]


@contextmanager
def naming(number: int) -> Iterator[None]:
    """Says of which frame an error is."""
    try:
        yield
    except click.ClickException as error:
        raise type(error)(f"frame {number}: {error.message}") from None


def path(stem: Path, number: int) -> Path:
    """Path of a frame without its suffix: ``name.0007``."""
    return stem.with_name(f"{stem.name}.{number:04d}")


def definitions(number: int, fps: float) -> dict[str, str]:
    """What the names of a frame stand for."""
    return {FRAME: str(number), TIME: repr(number / fps)}


def of_frame(job: Job, number: int, fps: float, names: set[str]) -> Job:
    """The job of one frame: with the values of those ``names`` that the scene uses, and a seed of its own."""
    own = {name: value for name, value in definitions(number, fps).items() if name in names}
    return replace(job, definitions={**job.definitions, **own}, seed=(job.seed + number) % 2**32)


def digest(job: Job, file: scene_file.SceneFile) -> str:
    """What is the same for frames of the same bytes, wherever the scene lies: SHA-256 of the scene's content, of what
    is changed in it, and of what makes its samples.
    """
    here = origin.here()
    own = job if file.xml == file.path else replace(job, definitions={})  # said in the translation
    said = replace(own, scene="").image() | {
        "digest": file.digest(),
        "denoise": job.denoise,
        "origin": [here[name] for name in origin.EXACT],
    }
    return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()


def is_there(stem: Path, made_of: str) -> bool:
    """Whether a frame is on the disk already, finished, and made of just this."""
    image = Path(f"{stem}.exr")
    if not image.is_file():  # of which OpenEXR would complain aloud
        return False
    try:
        header = OpenEXR.File(str(image), header_only=True).parts[0].header
    except (RuntimeError, ValueError):
        return False
    return bool(header.get(DIGEST) == made_of)


def unfinished(stem: Path, about: dict[str, Any]) -> Record | None:
    """The record of a frame that was interrupted, where its state was kept and is of this job; None otherwise."""
    try:
        record = saved.load(f"{stem}{STATE}")
    except (OSError, ValueError):
        return None
    return record if json.dumps(record.about, sort_keys=True) == json.dumps(about, sort_keys=True) else None
