"""``prosim render --frames``: the images of a film, each of the scene with other values of $frame and $time."""

from __future__ import annotations

import hashlib
import json
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import click
import OpenEXR
import prosim_scene
from prosim_scene import FPS, FRAME, TIME

from ..engine import environment
from ..scene import scene_file
from .interrupts import interruptible
from .job import Job
from .option_types import input_errors
from .progress import Progress
from .render_task import RenderTask, Resources, render_image

#: The metadata of a frame's EXR that has its :func:`digest`.
DIGEST = "prosim.digest"


class Film:
    """The frames of one job, rendered in their order; existing ones are left."""

    def __init__(self, job: Job, stem: Path) -> None:
        self.job, self.stem, self.frames = job, stem, job.frames or range(0)
        self.cache = prosim_scene.TranslationCache()
        self.rendered = self.left = self.black = 0
        self.bar = Progress("film", len(self.frames))
        with input_errors():
            self.names = scene_file.used_names(job.scene, {**job.definitions, **self.definitions(0)}, (FRAME, TIME))
            if not self.names and len(self.frames) > 1:
                raise ValueError(
                    f"{job.scene} uses neither ${FRAME} nor ${TIME}, so all frames would be alike; use one where the "
                    f"scene moves, such as {{360 * ${FRAME} / {len(self.frames)}}}"
                )

    def render(self) -> str | None:
        """Renders the missing frames; returns the cause of an interruption, in words. Raises ClickException."""
        with Resources(self.job) as resources, self.bar:
            signals = resources.enter_context(interruptible(lambda: None))  # until the workers have ended
            for number in self.frames:
                if signals:
                    return "interrupted"
                try:
                    interruption = self.render_frame(number, resources, signals)
                except click.ClickException as error:
                    raise type(error)(f"frame {number}: {error.message}") from None
                if interruption:
                    return interruption
            return "interrupted" if signals else None

    def render_frame(self, number: int, resources: Resources, signals: list[int]) -> str | None:
        """Renders a frame, if it is missing; returns the cause of an interruption. Raises ClickException."""
        self.bar.begin(number)
        own = {name: value for name, value in self.definitions(number).items() if name in self.names}
        job = replace(self.job, definitions={**self.job.definitions, **own}, seed=(self.job.seed + number) % 2**32)
        with input_errors():
            file = job.read_scene(resources.folder, cache=self.cache)
            facts = {DIGEST: digest(job, file), "prosim.frame": str(number)}
            task = RenderTask(job, file, self.path(number), facts=facts)
            if not job.overwrite and is_rendered(task):
                self.left += 1
                self.bar.leave_out()
                return None
            task.check()
            if job.checkpoint and not job.overwrite:
                task.begin = task.unfinished()
        image = render_image(task, self.bar, resources, signals)
        if image.interruption:
            return image.interruption
        self.rendered += 1
        self.bar.finish()
        if image.black and self.black == 0:
            warnings.warn(f"frame {number}: {image.black}", stacklevel=2)
        self.black += bool(image.black)
        self.bar.write(image.report, file=sys.stderr)
        return None

    def definitions(self, number: int) -> dict[str, str]:
        """The values of a frame's names."""
        return {FRAME: str(number), TIME: repr(number / (self.job.fps or FPS))}

    def path(self, number: int) -> Path:
        """Path of a frame without its suffix: ``name.0007``."""
        return self.stem.with_name(f"{self.stem.name}.{number:04d}")

    def report(self) -> str:
        """How many frames were rendered, and where they are."""
        first, last = self.path(self.frames[0]), self.path(self.frames[-1])
        names = f"{first}.exr" if len(self.frames) == 1 else f"{first}.exr to {last.name}.exr"
        left = f", {self.left} had been rendered before" if self.left else ""
        black = f", {self.black} of them black" if self.black else ""
        return f"{names}, and .png: {self.rendered} of {len(self.frames)} frames rendered{black}{left}"


def digest(job: Job, file: scene_file.SceneFile) -> str:
    """SHA-256 of all that the bytes of a frame depend on: the scene's content, its changes, and the
    :mod:`..engine.environment`. It does not depend on the folder of the scene.
    """
    here = environment.this_environment()
    versions = [here[name] for name in environment.MUST_AGREE]
    # The content has the definitions.
    parts = job.image() | {"scene": "", "definitions": {}, "digest": file.digest(), "environment": versions}
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def is_rendered(task: RenderTask) -> bool:
    """Whether the disk has the frame, finished, with the same digest."""
    image = Path(f"{task.stem}.exr")
    if not image.is_file():  # OpenEXR would print an error
        return False
    try:
        header = OpenEXR.File(str(image), header_only=True).parts[0].header
    except (RuntimeError, ValueError):
        return False
    return bool(header.get(DIGEST) == task.facts[DIGEST])


def render(job: Job, stem: Path) -> None:
    """Renders the frames of ``job`` and prints a report; ends the process where it was interrupted.

    Raises UsageError, InputError and ClickException; finished frames stay.
    """
    if given := {FRAME, TIME} & set(job.definitions):
        raise click.UsageError(f"-D {min(given)}=... and --frames both define ${min(given)}; give one of them.")
    film = Film(job, stem)
    interruption = film.render()
    end = f"; {interruption}. The same command continues with the others." if interruption else ""
    click.echo(film.report() + end)
    if interruption:
        sys.exit(1)
