"""``prosim render --frames``: the pictures of a film, each of the scene with other values of $frame and $time."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import click
import mitsuba as mi
import prosim_scene
from prosim_scene import FPS, FRAME, TIME
from tqdm.auto import tqdm

from ..scene import atomic, rendering, scene_file, session
from .apart import Apart
from .frames import Frame, definitions, digest, is_there, naming, of_frame, path, unfinished
from .helping import Helping, pack
from .interrupts import interruptible
from .job import Job
from .log import log
from .making import refuse_to_keep, size_of_image, warn
from .making import render as render_image
from .options import wrong_input

#: What is said of a film that was ended by a signal.
INTERRUPTED = "interrupted"


class Film:
    """The frames of one job, rendered in their order; finished ones that are there already are left."""

    def __init__(self, job: Job, stem: Path, frames: Sequence[int]) -> None:
        self.job, self.stem, self.frames, self.fps = job, stem, frames, job.fps or FPS
        self.kept = prosim_scene.Kept()
        self.made = self.left = self.black = 0
        #: Why frames are black; each reason is said once.
        self.reasons: set[str] = set()
        self.text = Path(job.scene).read_bytes()
        with wrong_input():
            self.names = scene_file.uses(job.scene, {**job.definitions, **definitions(0, self.fps)}, (FRAME, TIME))
            if not self.names and len(frames) > 1:
                raise ValueError(
                    f"{job.scene} says neither ${FRAME} nor ${TIME}, so all frames would be alike; say where it moves, "
                    f"such as {{360 * ${FRAME} / {len(frames)}}}"
                )

    def render(self) -> str | None:
        """Renders what is missing, or lets workers do so; returns by what it was interrupted, in words."""
        helping = Helping(self.job, warn)
        with (
            log(self.job.verbose),
            session.threads(self.job.threads),
            atomic.scratch() as folder,
            interruptible(lambda: None) as signals,
            helping,
            self.bar() as bar,
        ):
            missing = self.missing(folder, bar, signals)
            for frame in missing:
                with naming(frame.number):
                    apart, interruption = self.frame(frame, helping, bar, signals)
                if apart is not None and not interruption:
                    interruption = self.frames_apart(apart, missing, bar, signals)
                if interruption:
                    return interruption
            return INTERRUPTED if signals else None

    def missing(self, folder: Path, bar: tqdm, signals: list[int]) -> Iterator[Frame]:
        """The frames that are to be made, each read when it is asked for, until a signal has come. Raises
        ClickException.
        """
        for number in self.frames:
            if signals:
                return
            bar.set_description_str(f"frame {number}")
            job, stem = of_frame(self.job, number, self.fps, self.names), path(self.stem, number)
            with naming(number), wrong_input():
                file = job.file(folder, self.kept)
                self.see_changes(number)
                made_of = digest(job, file)
            if job.overwrite or not is_there(stem, made_of):
                yield Frame(number, job, stem, file, made_of)
                continue
            self.left += 1
            bar.total -= 100
            bar.refresh()

    def frame(self, frame: Frame, helping: Helping, bar: tqdm, signals: list[int]) -> tuple[Apart | None, str | None]:
        """Renders one frame. Returns those who should make the next ones, if each had better be made by one worker; and
        by what it was interrupted, in words.
        """
        job = frame.job
        with wrong_input():
            scene = frame.file.load()
            opened = frame.file, scene, scene_file.pick_sensor(scene, job.sensor)
            about = job.about(frame.file) if job.keep else None
            if job.keep:
                refuse_to_keep(scene.integrator())
            parcel = pack(job, frame.file, scene.integrator())
        begin = None if about is None or job.overwrite else unfinished(frame.stem, about)
        if signals:  # from here on the render listens itself
            return None, INTERRUPTED
        before = helping.spent()
        made = render_image(
            job,
            opened,
            frame.stem,
            begin,
            about,
            frame=frame.facts,
            bar=lambda *_: progress(scene, bar),
            by=partial(helping, parcel),
            sources=frame.sources(),
        )
        if made.interrupted:
            return None, made.lost or INTERRUPTED
        self.see_black(frame.number, made.black)
        tqdm.write(made.said, file=sys.stderr)
        self.made += 1
        integrator = scene.integrator()
        # A state is kept here, so that nothing is lost with a worker; and a time is that of all of them.
        if helping.taker is None or job.keep or integrator.time or (job.denoise and helping.elsewhere):
            return None, None
        seconds, work = (now - then for now, then in zip(helping.spent(), before))
        size = size_of_image(integrator, opened[2].film(), job.denoise)
        return Apart(helping.taker, size, seconds, int(work)), None

    def frames_apart(self, apart: Apart, frames: Iterator[Frame], bar: tqdm, signals: list[int]) -> str | None:
        """Lets each worker make some of the next frames, as long as they are small; returns by what it was interrupted,
        in words.
        """
        for frame, made, said in apart.write(frames, lambda: bool(signals)):
            self.see_black(frame.number, made.black)
            tqdm.write(said, file=sys.stderr)
            self.made += 1
            bar.update(100)
        return INTERRUPTED if signals else apart.taker.gone

    def see_changes(self, number: int) -> None:
        """Says so where the scene is another than at the frame before, which is as it was then."""
        text = Path(self.job.scene).read_bytes()
        if text != self.text:
            self.text = text
            warn(
                f"{self.job.scene} was changed meanwhile: frame {number} is of what it says now, frames before it are "
                "not; the same command renders these anew"
            )

    def see_black(self, number: int, why: str | None) -> None:
        """Counts a frame that is black, and says ``why`` it is."""
        self.black += why is not None
        if why is not None and why not in self.reasons:
            self.reasons.add(why)
            warn(f"frame {number}: {why}")

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
        black = f", {self.black} of them black" if self.black else ""
        return f"{names}, and .png: {self.made} of {len(self.frames)} frames rendered{black}{left}"


@contextmanager
def progress(scene: mi.Scene, bar: tqdm) -> Iterator[rendering.Tell | None]:
    """Yields what is to be told the part of a frame that is done, or None; at the end all of it is."""
    begun = bar.n

    def tell(done: float, _: Any) -> None:
        bar.update(max(begun + 100 * done - bar.n, 0))

    yield tell if rendering.keeps(scene.integrator()) else None
    bar.update(begun + 100 - bar.n)


def render(job: Job, stem: Path) -> None:
    """Renders the frames of ``job`` and says what was done; ends the process where it was interrupted.

    Raises UsageError, InputError and ClickException; what is finished by then is kept.
    """
    if given := {FRAME, TIME} & set(job.definitions):
        raise click.UsageError(f"-D {min(given)}=... and --frames both say what ${min(given)} stands for; give one.")
    if "%" in stem.name:
        raise click.BadParameter(
            f"'{stem.name}': frames number themselves, such as name.0007.exr; give the name alone.", param_hint="-o"
        )
    film = Film(job, stem, job.frames or ())
    interruption = film.render()
    if interruption:
        click.echo(f"{film.said()}; {interruption}. The same command continues with the others.")
        sys.exit(1)
    click.echo(film.said())
