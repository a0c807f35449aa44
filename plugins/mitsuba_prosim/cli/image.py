"""One image: a render, step by step, and what becomes of it."""

from __future__ import annotations

import json
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, NoReturn

import click
import mitsuba as mi

from .. import atomic
from ..denoising import halves, layers, oidn
from ..engine import checkpoint
from ..engine.checkpoint import Checkpoint, CheckpointWriter
from ..engine.render import Reached
from ..scene import black, images, rendering, report, scene_file, session
from . import output
from .interrupts import interruptible
from .job import ENDS, Job
from .log import log
from .options import InputError, refuse_waves, wrong_input
from .progress import Bar, Progress, warn
from .tev import Viewer, viewer

if TYPE_CHECKING:
    from ..parallel.bundle import SceneBundle
    from ..parallel.executor import DaskExecutor
    from .workers import Workers

#: What an image is written as, and its state.
SUFFIXES, STATE = (".exr", ".png"), ".state.npz"

#: Channels of the raw and of the denoised image, and of the errors.
DENOISED_CHANNELS = 9

HOW_TO_SAMPLE = (
    "Say how it should be sampled, such as --noise 0.01 or --adaptive none --samples 8: it is put within "
    "prosim_adaptive then."
)


@dataclass(frozen=True)
class Task:
    """An image that is to be rendered and written to ``stem``, a path without suffix.

    ``about``: what its checkpoints say that they are of; None: there are none. ``begin``: continues from there.
    ``sources``: files that no image may overwrite. ``facts``: further metadata, of a frame of a film, which is written
    only when it is finished.
    """

    job: Job
    file: scene_file.SceneFile
    scene: mi.Scene
    sensor: mi.Sensor
    stem: Path
    about: Mapping[str, Any] | None = None
    begin: Checkpoint | None = None
    sources: Sequence[Path] = ()
    facts: Mapping[str, str] = field(default_factory=dict)
    #: The scene as it is sent to workers, where they take the samples.
    bundle: SceneBundle | None = None

    @classmethod
    def of(
        cls,
        job: Job,
        file: scene_file.SceneFile,
        stem: Path,
        begin: Checkpoint | None = None,
        sources: Collection[Path] = (),
        facts: Mapping[str, str] | None = None,
    ) -> Task:
        """The task of a job whose scene ``file`` has been opened. Raises what loading it raises, and ValueError where
        it can't be kept or continued.
        """
        scene = file.load()
        sensor = scene_file.pick_sensor(scene, job.sensor)
        keep = job.keep or job.part is not None
        about = job.about(file) if keep or begin is not None else {}
        if about:
            refuse_to_keep(scene.integrator())
        if begin is not None and begin.about["digest"] != about["digest"]:
            raise ValueError(
                f"{job.scene} is not what the state was made of: its text has changed, or a mesh or a picture that "
                "it names. Render it again, or name the right one with --scene."
            )
        sources = [*sources, *(path.resolve() for path in file.sources())]
        return cls(job, file, scene, sensor, stem, about if keep else None, begin, sources, facts or {})

    @property
    def integrator(self) -> Any:
        """The scene's integrator."""
        return self.scene.integrator()

    def checked(self) -> CheckpointWriter | None:
        """Checks that the image can be rendered and written; returns what writes its checkpoints, if it has some.

        Raises InputError and ClickException.
        """
        job, film, part = self.job, self.sensor.film(), self.job.part
        refuse_waves([name for name in ENDS if getattr(self.integrator, name, 0)], job.variant)
        if job.denoise:
            check_denoising(film, self.integrator)
        size, suffixes, writer = self.size(), () if part else SUFFIXES, None
        if self.about is not None:
            state = f".{part}.npz" if part else STATE
            suffixes = (*suffixes, state)
            size += 2 * size_of_state(self.integrator, film, 1 / part.of if part else 1.0)  # the old one is there, too
            writer = CheckpointWriter(self.stem.with_name(self.stem.name + state), self.about, warn)
        output.check(Path(job.scene), self.stem, suffixes, size)
        output.spare(self.sources, output.SOURCES, self.stem, () if part else SUFFIXES)
        return writer

    def size(self) -> int:
        """Bytes that the image takes at most."""
        width, height = self.sensor.film().crop_size()
        # Four channels of 32 bits and what else there is, and three bytes of the PNG.
        others = len(self.integrator.aov_names()) + (DENOISED_CHANNELS if self.job.denoise else 0)
        return int(width * height) * (19 + 4 * others) + 2**16


@dataclass(frozen=True)
class Image:
    """A rendered image; it can travel. ``contents``: of its files, by suffix; ``size``: in pixels; ``said``: how good
    it is, line by line; ``black``: why nothing can be seen, if that is so.
    """

    contents: Mapping[str, bytes]
    size: tuple[int, int]
    seconds: float
    said: Sequence[str]
    black: str | None

    def line(self, job: Job, file: scene_file.SceneFile, written: Sequence[Path]) -> str:
        """What it is, and where, in words."""
        return (
            f"{' and '.join(map(str, written))}: "
            + (f"part {job.part.number} of {job.part.of}, " if job.part else "")
            + f"{self.size[0]} x {self.size[1]} pixels, {job.variant}, {self.seconds:.2f} s"
            + (f", {file.wrapped} within prosim_adaptive" if file.wrapped else "")
        )


@dataclass(frozen=True)
class Result:
    """What became of a task. ``said``: what to print; ``lost``: why the cluster is gone, if that has interrupted it;
    ``state``: its checkpoint; ``black``: why nothing can be seen, if that is so.
    """

    said: str
    interrupted: bool
    lost: str | None
    state: Path | None
    black: str | None


def start(job: Job, scene: mi.Scene, sensor: mi.Sensor, **how: Any) -> Any:
    """The render of a job: an iterator of :class:`.Step`. ``how``: see :func:`.rendering.progressive`."""
    if job.denoise:
        if not rendering.keeps(scene.integrator()):
            how = {}
        return halves.DenoisedRender(scene, sensor, scene.integrator(), job.seed, job.spp, **how)
    return rendering.progressive(scene, sensor, job.seed, job.spp, **how)


def render(task: Task, bar: Bar, workers: Workers, shown: Viewer | None = None) -> Result:
    """Renders and writes an image or its state. ``bar``: shows the progress; ``workers``: take the samples, if not this
    process; ``shown``: where the image is shown.

    Raises InputError, where nothing has been written, and ClickException; ends the process where it was interrupted
    before the first sample, unless it is a frame of a film.
    """
    job, is_frame = task.job, bool(task.facts)
    writer = task.checked()
    with interruptible(task.integrator.cancel) as signals:
        executor = workers.executor(task.bundle)
        begun = perf_counter()
        with failing():
            steps = start(job, task.scene, task.sensor, begin=task.begin, part=job.part, executor=executor)
            while not (signals or gone(executor)) and (step := next(steps, None)) is not None:
                bar.show(step.done)
                if writer is not None:
                    writer(steps)
                if shown is not None:
                    shown.update(steps)
            steps.close()
            if writer is not None:
                writer(steps, True)
        seconds, lost = perf_counter() - begun, gone(executor)
        interrupted = "the loss of the cluster" if lost else "a signal" if signals else None
        if interrupted and not is_frame and report.nothing(steps.reached):
            end_without_image(signals, lost)
        written = job.part is None and not (is_frame and interrupted)
        image = finish(job, task.scene, task.sensor, steps, seconds, interrupted, task.facts, written)
        if shown is not None:
            shown.show()
        paths = output.save(task.stem, image.contents) if image.contents else []
    if writer is not None:
        if writer.unwritten is not None:
            output.save(writer.path.with_suffix(""), {".npz": writer.unwritten})
        paths.append(writer.path)
    said = image.line(job, task.file, paths) + (f", {report.interrupted(steps.reached)}" if interrupted else "")
    lines = [said, lost, *image.said]
    state = None if writer is None else writer.path
    return Result("\n".join(filter(None, lines)), bool(interrupted), lost, state, image.black)


def gone(executor: DaskExecutor | None) -> str | None:
    """Why those who take the samples are gone; None where they are there, or where it is this process."""
    return None if executor is None else executor.gone


@contextmanager
def failing() -> Iterator[None]:
    """Turns what a render raises into InputError and ClickException."""
    try:
        yield
    except ValueError as error:
        raise InputError(str(error)) from None
    except (RuntimeError, MemoryError) as error:
        raise click.ClickException(f"the scene could not be rendered: {session.message(error)}") from None


def end_without_image(signals: Sequence[int], lost: str | None) -> NoReturn:
    """Ends the process that has rendered nothing. Raises ClickException where the cluster was ``lost``."""
    nothing = "before the image had begun; nothing was written."
    if lost:
        raise click.ClickException(f"{lost} {nothing}")
    click.echo(f"Interrupted {nothing}", err=True)
    sys.exit(128 + signals[0])


def finish(
    job: Job,
    scene: mi.Scene,
    sensor: mi.Sensor,
    steps: Any,
    seconds: float,
    interrupted: str | None = None,
    facts: Mapping[str, str] | None = None,
    written: bool = True,
) -> Image:
    """The image of a render that has ended. ``interrupted``: by what; ``facts``: further metadata; ``written``: whether
    its files are wanted.
    """
    integrator, film, reached = scene.integrator(), sensor.film(), steps.reached
    size = int(film.crop_size()[0]), int(film.crop_size()[1])
    at_most = None
    if written and not job.denoise and rendering.keeps(integrator) and integrator.time:
        at_most = None if integrator.noise or integrator.noise_99 or integrator.noise_999 else steps.noise_at_most()
    sentence = report.sentence(integrator, reached, bool(interrupted), interrupted or "", at_most)
    if not written:
        return Image({}, size, seconds, [sentence] if sentence and job.part is None else [], None)
    bitmap, own, said = denoised(steps, film) if job.denoise else (film.bitmap(), {}, None)
    every = metadata(job, integrator, reached, bool(interrupted), seconds) | own | dict(facts or {})
    exposure = job.exposure or 0.0
    shown = images.colours(bitmap)
    why = None if shown is None else black.why(scene, sensor, shown * 2.0**exposure, exposure=exposure)
    contents = images.encode(bitmap, every, exposure, own)
    return Image(contents, size, seconds, [line for line in (sentence, said) if line], why)


def metadata(
    job: Job, integrator: mi.Integrator, reached: Reached | None, interrupted: bool, seconds: float
) -> dict[str, str]:
    """What an EXR image says of how it was made."""
    return report.facts(integrator, reached, interrupted) | {
        "prosim.scene": job.scene,
        "prosim.version": version("mitsuba-prosim"),
        "prosim.variant": job.variant,
        "prosim.integrator": str(integrator),
        "prosim.seed": str(job.seed),
        "prosim.seconds": f"{seconds:.3f}",
    }


# ---------------------------------------------------------------- denoising


def check_denoising(film: mi.Film, integrator: mi.Integrator | None = None) -> None:
    """Raises ClickException where the package is missing, InputError where ``film`` stores no colours, and where the
    ``integrator`` denoises by itself: twice would be once too often.
    """
    if integrator is not None and "denoised.R" in integrator.aov_names():
        raise InputError("--denoise: the scene's integrator, prosim_denoised, denoises by itself; leave out --denoise.")
    try:
        oidn.load()
        halves.check(film)
    except oidn.MissingError as error:
        raise click.ClickException(f"--denoise: {error}") from None
    except ValueError as error:
        raise InputError(f"--denoise: {error}") from None


def denoised(steps: halves.DenoisedRender, film: mi.Film) -> tuple[mi.Bitmap, dict[str, str], str]:
    """The denoised image, its metadata, and what is said of it; of a render that was stopped the first half, or what
    there is of it, as it is.
    """
    both = steps.halves
    if both.second is None:
        return layers.undenoised(both), {"prosim.denoised": "no, interrupted"}, "not denoised: interrupted"
    result = steps.denoised()
    raw, final = result.noise(result.raw_error), result.noise(result.final_error)
    facts = {
        "prosim.denoised": f"by Open Image Denoise {oidn.load().oidn_version()}, as far as two halves of the samples "
        "agree with it; the layers raw and denoised of the EXR are what was mixed",
        "prosim.denoised.noise": f"{final:.6g}",
        "prosim.denoised.raw_noise": f"{raw:.6g}",
    }
    said = f"denoised: noise about {final:.2g}, raw {raw:.2g}"
    if not film.rfilter().is_box_filter():
        said += " (the film's filter is wider than a pixel: a denoiser can do more with a box filter)"
    return layers.bitmap(both, result), facts, said


# ---------------------------------------------------------------- checkpoints


def refuse_to_keep(integrator: mi.Integrator) -> None:
    """Raises ValueError where a render can't be continued."""
    if not rendering.keeps(integrator):
        raise ValueError(
            "a state can be kept where prosim or prosim_adaptive takes the samples, in all but scalar variants; this "
            f"scene's integrator is {integrator.class_name()}. {HOW_TO_SAMPLE}"
        )


def size_of_state(integrator: mi.Integrator, film: mi.Film, part: float) -> int:
    """Bytes that the state of a part of an image takes, about."""
    values = (5 + len(integrator.aov_names())) * (2 * film.rfilter().border_size() + 1) ** 2
    pixels = int(film.crop_size()[0] * film.crop_size()[1])
    return int(part * pixels * (4 * values + 56)) + 2**16


def unfinished(stem: Path, about: Mapping[str, Any]) -> Checkpoint | None:
    """The state of a render that was interrupted, where it was kept and is of this job; None otherwise."""
    try:
        record = checkpoint.load(f"{stem}{STATE}")
    except (OSError, ValueError):
        return None
    return record if json.dumps(record.about, sort_keys=True) == json.dumps(about, sort_keys=True) else None


# ---------------------------------------------------------------- the command


def write_image(job: Job, stem: Path, begin: Checkpoint | None = None, sources: Collection[Path] = ()) -> None:
    """Renders a job, or its part alone, writes its image, ``stem`` being the path without suffix, and prints what was
    done.

    ``begin``: continues from there; ``sources``: the files of ``begin``, which no image may overwrite. Raises
    InputError, where nothing has been written, and ClickException; ends the process where it was interrupted.
    """
    from .workers import Workers, bundled

    with log(job.verbose), session.threads(job.threads):
        with atomic.scratch() as folder, wrong_input():
            task = bundled(Task.of(job, job.file(folder), stem, begin, sources))
        with (
            Workers(job) as workers,
            viewer(job, task.sensor.film()) as shown,
            # The first step comes when the kernels are compiled and a part is rendered.
            Progress("compiling kernels") if rendering.keeps(task.integrator) else Progress("rendering", False) as bar,
        ):
            result = render(task, bar, workers, shown)
        if result.black:
            warn(result.black)
    click.echo(result.said)
    if result.interrupted:
        if result.state is not None:
            click.echo(f"To continue it: prosim resume {result.state}")
        sys.exit(1)
