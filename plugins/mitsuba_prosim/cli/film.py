"""``prosim render --frames``: the images of a film, each of the scene with other values of $frame and $time."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

import click
import mitsuba as mi
import OpenEXR
import prosim_scene
from prosim_scene import FPS, FRAME, TIME
from tqdm.auto import tqdm

from .. import atomic
from ..engine import origin
from ..scene import scene_file, session
from . import output
from .image import SUFFIXES, Image, Result, Task, finish, start, unfinished
from .image import render as render_image
from .interrupts import interruptible
from .job import Job
from .log import log
from .options import wrong_input
from .progress import FilmBar, warn
from .workers import Workers, bundled

if TYPE_CHECKING:
    from ..parallel.executor import DaskExecutor, ImageTask

#: What a frame's EXR says of what it was made of; see :func:`digest`.
DIGEST = "prosim.digest"

#: Seconds that one worker takes for a frame, at most. Where it is more, all workers share each frame: it is sooner
#: there, and less is lost with it.
SMALL = 30.0


@dataclass(frozen=True)
class Frame:
    """A frame that is to be rendered. ``stem``: its path without suffix; ``made_of``: its :func:`digest`."""

    number: int
    job: Job
    stem: Path
    file: scene_file.SceneFile
    made_of: str

    @property
    def facts(self) -> dict[str, str]:
        """Its metadata, beside those of every image."""
        return {DIGEST: self.made_of, "prosim.frame": str(self.number)}


class Film:
    """The frames of one job, rendered in their order; existing ones are left."""

    def __init__(self, job: Job, stem: Path) -> None:
        self.job, self.stem, self.frames, self.fps = job, stem, job.frames or range(0), job.fps or FPS
        self.kept = prosim_scene.Kept()
        self.made = self.left = self.black = 0
        #: Why frames are black; each reason is said once.
        self.reasons: set[str] = set()
        self.text = Path(job.scene).read_bytes()
        self.bar = FilmBar(len(self.frames))
        self.signals: list[int] = []
        with wrong_input():
            self.names = scene_file.uses(job.scene, {**job.definitions, **self.definitions(0)}, (FRAME, TIME))
            if not self.names and len(self.frames) > 1:
                raise ValueError(
                    f"{job.scene} says neither ${FRAME} nor ${TIME}, so all frames would be alike; say where it moves, "
                    f"such as {{360 * ${FRAME} / {len(self.frames)}}}"
                )

    def render(self) -> str | None:
        """Renders what is missing, or lets workers do so; returns by what it was interrupted, in words."""
        job = self.job
        with (
            log(job.verbose),
            session.threads(job.threads),
            atomic.scratch() as folder,
            interruptible(lambda: None) as self.signals,
            Workers(job) as workers,
            self.bar,
        ):
            missing = self.missing(folder)
            for frame in missing:
                with naming(frame.number):
                    made_apart, interruption = self.frame(frame, workers)
                if made_apart is not None and not interruption:
                    interruption = self.frames_apart(made_apart, missing)
                if interruption:
                    return interruption
            return "interrupted" if self.signals else None

    def missing(self, folder: Path) -> Iterator[Frame]:
        """The frames that are to be rendered, each read when it is asked for, until a signal has come. Raises
        ClickException.
        """
        for number in self.frames:
            if self.signals:
                return
            self.bar.begin(number)
            own = {name: value for name, value in self.definitions(number).items() if name in self.names}
            seed = (self.job.seed + number) % 2**32
            job = replace(self.job, definitions={**self.job.definitions, **own}, seed=seed)
            with naming(number), wrong_input():
                file = job.file(folder, kept=self.kept)
                self.see_changes(number)
                made_of = digest(job, file)
            if job.overwrite or not exists(self.path(number), made_of):
                yield Frame(number, job, self.path(number), file, made_of)
                continue
            self.left += 1
            self.bar.leave_out()

    def frame(self, frame: Frame, workers: Workers) -> tuple[Apart | None, str | None]:
        """Renders one frame. Returns what renders the next ones, if each had better be rendered by one worker; and by
        what it was interrupted, in words.
        """
        job = frame.job
        with wrong_input():
            task = bundled(Task.of(job, frame.file, frame.stem, facts=frame.facts))
        if task.about is not None and not job.overwrite:
            task = replace(task, begin=unfinished(frame.stem, task.about))
        if self.signals:  # from here on the render listens itself
            return None, "interrupted"
        before = 0.0 if workers.dask is None else workers.dask.seconds
        result = render_image(task, self.bar, workers)
        if result.interrupted:
            return None, result.lost or "interrupted"
        self.see(frame, result)
        # A state is kept here, so that nothing is lost with a worker; and a time is that of all of them.
        if workers.dask is None or job.keep or task.integrator.time or (job.denoise and job.cluster):
            return None, None
        return Apart(workers.dask, task.size(), workers.dask.seconds - before), None

    def frames_apart(self, apart: Apart, frames: Iterator[Frame]) -> str | None:
        """Lets each worker render some of the next frames, as long as they are small; returns by what it was
        interrupted, in words.
        """
        for frame, result in apart.write(frames, lambda: bool(self.signals)):
            self.see(frame, result)
        return "interrupted" if self.signals else apart.dask.gone

    def see(self, frame: Frame, result: Result) -> None:
        """Counts a frame that is there, and prints what is said of it."""
        self.made += 1
        self.bar.finish()
        self.black += result.black is not None
        if result.black is not None and result.black not in self.reasons:
            self.reasons.add(result.black)
            warn(f"frame {frame.number}: {result.black}")
        tqdm.write(result.said, file=sys.stderr)

    def see_changes(self, number: int) -> None:
        """Warns where the scene is another than at the frame before, which is as it was then."""
        text = Path(self.job.scene).read_bytes()
        if text != self.text:
            self.text = text
            warn(
                f"{self.job.scene} was changed meanwhile: frame {number} is of what it says now, frames before it are "
                "not; the same command renders these again"
            )

    def definitions(self, number: int) -> dict[str, str]:
        """What the names of a frame stand for."""
        return {FRAME: str(number), TIME: repr(number / self.fps)}

    def path(self, number: int) -> Path:
        """Path of a frame without its suffix: ``name.0007``."""
        return self.stem.with_name(f"{self.stem.name}.{number:04d}")

    def said(self) -> str:
        """What has been done, in words."""
        first, last = self.path(self.frames[0]), self.path(self.frames[-1])
        names = f"{first}.exr" if len(self.frames) == 1 else f"{first}.exr to {last.name}.exr"
        left = f", {self.left} had been rendered before" if self.left else ""
        black = f", {self.black} of them black" if self.black else ""
        return f"{names}, and .png: {self.made} of {len(self.frames)} frames rendered{black}{left}"


@dataclass
class Apart:
    """Small frames, each rendered by one worker of ``dask``: what goes before its samples, all workers do at a time.
    ``size``: bytes of one at most; ``seconds``: that one worker takes for one, about.
    """

    dask: DaskExecutor
    size: int
    seconds: float

    def write(self, frames: Iterator[Frame], stopped: Callable[[], bool]) -> Iterator[tuple[Frame, Result]]:
        """Renders and writes frames in the order in which they are done, as long as they are small, and yields each. It
        ends as well where it is ``stopped``, or the cluster is gone.

        What is wrong with a frame is raised when those before it are there. Raises ClickException.
        """
        asked: dict[ImageTask, Frame] = {}
        wrong: list[click.ClickException] = []

        def images() -> Iterator[ImageTask]:
            while self.seconds <= SMALL:
                try:
                    if (frame := next(frames, None)) is None:
                        return
                    image = self._image(frame)
                except click.ClickException as error:
                    wrong.append(error)
                    return
                asked[image] = frame
                yield image

        try:
            for answer in self.dask.make(images()):
                if stopped():
                    break
                if answer is None:
                    continue
                whole, image = answer
                frame = asked.pop(whole)
                self.seconds = image.seconds
                with naming(frame.number):
                    paths = output.save(frame.stem, image.contents)
                said = image.line(frame.job, frame.file, paths), *image.said
                yield frame, Result("\n".join(said), False, None, None, image.black)
        except RuntimeError as error:
            raise click.ClickException(str(error)) from None
        if wrong and not stopped() and not self.dask.gone:
            raise wrong[0]

    def _image(self, frame: Frame) -> ImageTask:
        from ..parallel.bundle import SceneBundle
        from ..parallel.executor import ImageTask

        with naming(frame.number):
            output.check(Path(frame.job.scene), frame.stem, SUFFIXES, self.size)
            output.spare(frame.file.sources(), output.SOURCES, frame.stem, SUFFIXES)
            with wrong_input():
                bundle = SceneBundle.of(frame.file, frame.job.sensor)
        return ImageTask(f"frame {frame.number}", bundle, on_worker, (frame.job, frame.facts))


def on_worker(scene: mi.Scene, sensor: mi.Sensor, job: Job, facts: dict[str, str]) -> Image:
    """The image of a frame, rendered by a worker."""
    begun = perf_counter()
    steps = start(job, scene, sensor)
    for _ in steps:
        pass
    steps.close()
    return finish(job, scene, sensor, steps, perf_counter() - begun, facts=facts)


@contextmanager
def naming(number: int) -> Iterator[None]:
    """Says of which frame an error is."""
    try:
        yield
    except click.ClickException as error:
        raise type(error)(f"frame {number}: {error.message}") from None


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


def exists(stem: Path, made_of: str) -> bool:
    """Whether a frame is on the disk already, finished, and made of just this."""
    image = Path(f"{stem}.exr")
    if not image.is_file():  # of which OpenEXR would complain aloud
        return False
    try:
        header = OpenEXR.File(str(image), header_only=True).parts[0].header
    except (RuntimeError, ValueError):
        return False
    return bool(header.get(DIGEST) == made_of)


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
    film = Film(job, stem)
    interruption = film.render()
    if interruption:
        click.echo(f"{film.said()}; {interruption}. The same command continues with the others.")
        sys.exit(1)
    click.echo(film.said())
