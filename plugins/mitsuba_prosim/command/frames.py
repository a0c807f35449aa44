"""``prosim render --frames``: the pictures of a film, each of the scene with other values of $frame and $time."""

from __future__ import annotations

import hashlib
import json
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import click
import mitsuba as mi
import OpenEXR
import prosim_scene
from prosim_scene.language.definitions import FPS, FRAME, TIME
from tqdm.auto import tqdm

from .. import saved
from ..rendering.record import Record
from ..saved import origin
from ..scene_files import opening, rendering, session, writing
from .helping import Helping, pack
from .job import Job
from .log import log
from .making import STATE, refuse_to_keep, refuse_waves, warn
from .making import render as render_image
from .options import Helpers, wrong_input

#: What a frame's EXR says of what it was made of; see :func:`digest`.
DIGEST = "prosim.digest"

#: What is said of a film that was ended by a signal.
INTERRUPTED = "interrupted"

#: Beyond this a film is a mistake: an hour and a half at 24 frames a second.
LAST = 2**17


class Frames(click.ParamType):
    """Frames such as 0:48, 0:48:2 or 7, counted as Python's slices are: the last one is not among them."""

    name = "A:B[:STEP]"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> range:
        """The numbers of the frames, one at least, from 0."""
        try:
            numbers = [int(word) for word in value.split(":")]
            frames = range(*numbers) if len(numbers) > 1 else range(numbers[0], numbers[0] + 1)
        except (TypeError, ValueError):
            self.fail(f"{value!r} is not of the form {self.name}, such as 0:48, 0:48:2 or 7", param, ctx)
        if not frames or min(frames) < 0 or max(frames) >= LAST or frames.step < 0:
            self.fail(
                f"{value!r}: A is 0 or more, B is more than A (frame B is not rendered), STEP is 1 or more, and no "
                f"frame is beyond {LAST - 1}",
                param,
                ctx,
            )
        return frames


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


def digest(job: Job, file: opening.SceneFile, denoise: bool) -> str:
    """What is the same for frames of the same bytes, wherever the scene lies: SHA-256 of the scene's content, of what
    is changed in it, and of what makes its samples.
    """
    here = origin.here()
    own = job if file.xml == file.path else replace(job, definitions={})  # said in the translation
    said = asdict(replace(own, scene="")) | {
        "digest": file.digest(),
        "denoise": denoise,
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


class Film:
    """The frames of one job, rendered one after the other; finished ones that are there already are left."""

    def __init__(self, job: Job, stem: Path, frames: Sequence[int], fps: float, keep: bool, denoise: bool, anew: bool):
        """``keep``, ``denoise``: as for :func:`.making.make`; ``anew``: whether frames that are there are not left."""
        self.job, self.stem, self.frames, self.fps = job, stem, frames, fps
        self.keep, self.denoise, self.anew = keep, denoise, anew
        self.kept = prosim_scene.Kept()
        self.made = self.left = 0
        with wrong_input():
            self.names = opening.uses(job.scene, {**job.definitions, **definitions(0, fps)}, (FRAME, TIME))
            if not self.names and len(frames) > 1:
                raise ValueError(
                    f"{job.scene} says neither ${FRAME} nor ${TIME}, so all frames would be alike; say where it moves, "
                    f"such as {{360 * ${FRAME} / {len(frames)}}}"
                )

    def render(self, threads: int | None, verbose: int, helpers: Helpers | None = None) -> str | None:
        """Renders what is missing, or lets ``helpers`` do so; returns by what it was interrupted, in words."""
        helping = Helping(helpers, threads, warn)
        with log(verbose), session.threads(threads), writing.scratch() as folder, helping, self.bar() as bar:
            for number in self.frames:
                bar.set_description_str(f"frame {number}")
                try:
                    if interruption := self.frame(number, folder, helping, bar):
                        return interruption
                except KeyboardInterrupt:
                    return INTERRUPTED
                except click.ClickException as error:
                    raise type(error)(f"frame {number}: {error.message}") from None
        return None

    def frame(self, number: int, folder: Path, helping: Helping, bar: tqdm) -> str | None:
        """Renders one frame, if need be; returns by what it was interrupted, in words."""
        job, stem = of_frame(self.job, number, self.fps, self.names), path(self.stem, number)
        with wrong_input():
            file = job.file(folder, self.kept)
            made_of = digest(job, file, self.denoise)
            if not self.anew and is_there(stem, made_of):
                self.left += 1
                bar.total -= 100
                bar.refresh()
                return None
            scene = file.load()
            opened = file, scene, opening.pick_sensor(scene, job.sensor)
            about = job.about(file) if self.keep else None
            if self.keep:
                refuse_to_keep(scene.integrator())
            sources = [path.resolve() for _, path in file.named_files()]
            parcel = pack(helping.helpers, file, scene.integrator(), job.sensor)
        begin = None if about is None or self.anew else unfinished(stem, about)
        facts = {DIGEST: made_of, "prosim.frame": str(number)}
        made = render_image(
            job,
            opened,
            stem,
            begin,
            about,
            denoise=self.denoise,
            frame=facts,
            bar=lambda *_: progress(scene, bar),
            by=partial(helping, parcel),
            sources=sources,
        )
        if made.interrupted:
            return made.lost or INTERRUPTED
        tqdm.write(made.said, file=sys.stderr)
        self.made += 1
        return None

    def bar(self) -> tqdm:
        """The progress over all frames."""
        form = "{l_bar}{bar}| {elapsed}, {remaining} left"
        total = 100 * len(self.frames)
        return tqdm(total=total, bar_format=form, disable=None, file=sys.stderr, leave=False)

    def said(self) -> str:
        """What has been done, in words."""
        first, last = path(self.stem, self.frames[0]), path(self.stem, self.frames[-1])
        names = f"{first}.exr" if len(self.frames) == 1 else f"{first}.exr to {last.name}.exr"
        left = f", {self.left} had been rendered before" if self.left else ""
        return f"{names}, and .png: {self.made} of {len(self.frames)} frames rendered{left}"


@contextmanager
def progress(scene: mi.Scene, bar: tqdm) -> Iterator[Callable[[float], None] | None]:
    """Yields what is to be told the part of a frame that is done, or None; at the end all of it is."""
    begun = bar.n

    def tell(done: float) -> None:
        bar.update(max(begun + 100 * done - bar.n, 0))

    yield tell if rendering.tells_progress(scene.integrator()) else None
    bar.update(begun + 100 - bar.n)


def render(
    job: Job,
    stem: Path,
    frames: Sequence[int],
    fps: float | None,
    threads: int | None,
    verbose: int,
    keep: bool,
    denoise: bool,
    anew: bool,
    helpers: Helpers | None = None,
) -> None:
    """Renders the frames of ``job`` and says what was done; ends the process where it was interrupted.

    Raises UsageError, InputError and ClickException; what is finished by then is kept.
    """
    if given := {FRAME, TIME} & set(job.definitions):
        raise click.UsageError(f"-D {min(given)}=... and --frames both say what ${min(given)} stands for; give one.")
    if helpers is not None:
        refuse_waves([str(helpers)], job.variant)
    if "%" in stem.name:
        raise click.BadParameter(
            f"{stem.name!r}: frames number themselves, such as name.0007.exr; give the name alone.", param_hint="-o"
        )
    with warnings.catch_warnings():
        warnings.simplefilter("once", prosim_scene.SceneWarning)  # not for every frame
        film = Film(job, stem, frames, fps or FPS, keep, denoise, anew)
        interruption = film.render(threads, verbose, helpers)
    if interruption:
        click.echo(f"{film.said()}; {interruption}. The same command goes on with the others.")
        sys.exit(1)
    click.echo(film.said())
