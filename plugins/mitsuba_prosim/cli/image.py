"""One image: a render, step by step, and its files."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, NoReturn

import click
import mitsuba as mi

from ..denoising import halves, layers, oidn
from ..engine import checkpoint
from ..engine.checkpoint import Checkpoint, CheckpointWriter
from ..engine.render import Reached
from ..scene import black, images, rendering, report, scene_file, session
from . import output
from .interrupts import interruptible
from .job import TARGETS, Job, refuse_scalar
from .options import InputError, need
from .progress import Progress, warn
from .tev import Viewer

if TYPE_CHECKING:
    from .workers import Workers

#: Suffixes of an image, and of its state.
SUFFIXES, STATE = (".exr", ".png"), ".state.npz"

#: The report calls the error of a denoised image uncertain if its upper bound is this many times the limit.
UNCERTAIN = 1.1

#: A line of the report where the denoiser does not pay.
NOT_DENOISED = "not denoised: the samples alone reached the limit as soon"


@dataclass(frozen=True)
class Task:
    """An image that is to be rendered and written to ``stem``, a path without suffix.

    ``about``: facts that identify its checkpoints; None: it has none. ``begin``: continues from there. ``facts``:
    further metadata, of a frame of a film, which is written only when it is finished.
    """

    job: Job
    file: scene_file.SceneFile
    scene: mi.Scene
    sensor: mi.Sensor
    stem: Path
    about: Mapping[str, Any] | None = None
    begin: Checkpoint | None = None
    facts: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        job: Job,
        file: scene_file.SceneFile,
        stem: Path,
        begin: Checkpoint | None = None,
        facts: Mapping[str, str] | None = None,
    ) -> Task:
        """The task of a job whose scene ``file`` has been opened. Raises the errors of loading it, and ValueError where
        the options do not suit the scene, or ``begin`` belongs to another one.
        """
        scene = file.load()
        integrator, sensor = scene.integrator(), scene_file.pick_sensor(scene, job.sensor)
        refuse_scalar([name for name in TARGETS if getattr(integrator, name, 0)], job.variant)
        if job.denoise:
            check_denoising(sensor.film(), integrator)
        keep = job.keep or job.part is not None
        refuse_other_integrators(job, integrator)
        about = job.about(file) if keep or begin is not None else {}
        if begin is not None and begin.about["digest"] != about["digest"]:
            raise ValueError(
                f"{job.scene} is not the scene of this state: its text has changed, or a mesh or a picture that it "
                "names. Render it again, or give the right one by --scene."
            )
        return cls(job, file, scene, sensor, stem, about if keep else None, begin, facts or {})

    @property
    def integrator(self) -> Any:
        """The scene's integrator."""
        return self.scene.integrator()

    def writer(self) -> CheckpointWriter | None:
        """The writer of the checkpoints, or None. Raises InputError where the result can't be written."""
        part = self.job.part
        states = [f".{part}.npz" if part else STATE] if self.about is not None else []
        output.check(
            self.stem, [*(() if part else SUFFIXES), *states], self.size(), [self.file.path, *self.file.sources()]
        )
        if self.about is None:
            return None
        return CheckpointWriter(self.stem.with_name(self.stem.name + states[0]), self.about, warn)

    def size(self) -> int:
        """Bytes of the image at most: ten channels of 32 bits, the integrator's own ones, and the PNG."""
        width, height = self.sensor.film().crop_size()
        return int(width * height) * (48 + 4 * len(self.integrator.aov_names())) + 2**16


@dataclass(frozen=True)
class Image:
    """A rendered image; it can be pickled. ``contents``: of its files, by suffix; ``size``: in pixels; ``quality``:
    noise, samples and time, line by line; ``black``: the reason why nothing is visible, or None.
    """

    contents: Mapping[str, bytes]
    size: tuple[int, ...]
    seconds: float
    quality: Sequence[str] = ()
    black: str | None = None

    def line(self, job: Job, file: scene_file.SceneFile, written: Sequence[Path]) -> str:
        """A line of the report."""
        return (
            f"{' and '.join(map(str, written))}: "
            + (f"part {job.part.number} of {job.part.of}, " if job.part else "")
            + f"{self.size[0]} x {self.size[1]} pixels, {job.variant}, {self.seconds:.2f} s"
            + (f", {file.wrapped} within prosim_adaptive" if file.wrapped else "")
        )


@dataclass(frozen=True)
class Result:
    """The outcome of a task. ``report``: lines to print; ``interruption``: its cause, in words;
    ``black``: the reason why nothing is visible, or None.
    """

    report: str
    interruption: str | None = None
    black: str | None = None


def start(job: Job, scene: mi.Scene, sensor: mi.Sensor, **how: Any) -> Any:
    """The render of a job: an iterator of :class:`.Step`. ``how``: see :func:`.rendering.progressive`."""
    if job.denoise:
        how = how if rendering.keeps(scene.integrator()) else {}
        return halves.DenoisedRender(scene, sensor, scene.integrator(), job.seed, job.spp or 0, **how)
    return rendering.progressive(scene, sensor, job.seed, job.spp or 0, **how)


def render_image(task: Task, bar: Progress, workers: Workers, shown: Viewer | None = None) -> Result:
    """Renders and writes an image or its state. ``workers`` may take the samples; ``shown``: where the image is shown.

    Raises InputError, where nothing has been written, and ClickException; ends the process where it was interrupted
    before the first sample, unless it is a frame of a film.
    """
    job, film, is_frame = task.job, task.sensor.film(), bool(task.facts)
    writer = task.writer()
    snapshots = Snapshots(task)
    consumers: list[Any] = [one for one in (writer, snapshots, shown and shown.update) if one]
    with interruptible(task.integrator.cancel) as signals:
        executor = workers.executor(task)
        started = perf_counter()
        try:
            steps = start(job, task.scene, task.sensor, begin=task.begin, part=job.part, executor=executor)
            while not (signals or getattr(executor, "gone", None)) and (step := next(steps, None)) is not None:
                bar.show(step.done)
                for consume in consumers:
                    consume(steps)
            steps.close()
            snapshots(steps)
            if writer is not None:
                writer(steps, last=True)
        except ValueError as error:
            raise InputError(str(error)) from None
        except (RuntimeError, MemoryError) as error:
            raise click.ClickException(f"the scene could not be rendered: {session.message(error)}") from None
        seconds, lost = perf_counter() - started, getattr(executor, "gone", None)
        interruption = lost or ("interrupted" if signals else None)
        if interruption and not is_frame and report.nothing(steps.reached):
            end_without_image(signals, lost)
        image = Image({}, tuple(film.crop_size()), seconds)
        if job.part is None and not (is_frame and interruption):
            by = "the loss of the cluster" if lost else "a signal" if signals else None
            image = finish(job, task.scene, task.sensor, steps, seconds, by, task.facts)
        if shown is not None:
            shown.show()
        paths = output.save(task.stem, image.contents) if image.contents else []
    if writer is not None:
        if writer.unwritten is not None:
            output.save(writer.path.with_suffix(""), {".npz": writer.unwritten})
        paths.append(writer.path)
    lines = [image.line(job, task.file, paths), lost, *image.quality]
    if interruption:
        lines[0] = f"{lines[0]}, {report.interrupted(steps.reached)}"
        lines.append(f"To continue it: prosim resume {writer.path}" if writer else None)
    return Result("\n".join(filter(None, lines)), interruption, image.black)


class Snapshots:
    """Writes the image of a task, without suffix ``NAME``, to ``NAME.0.04.exr`` when its error is this small, or to
    ``NAME.4s.exr`` after 4 seconds, with its true error, counts and time.
    """

    def __init__(self, task: Task) -> None:
        self.task, self.left, self.started = task, sorted(task.job.snapshots or ()), perf_counter()

    def __call__(self, steps: Any) -> None:
        """Writes those that are due."""
        reached, task = steps.reached if self.left else None, self.task
        for text in [one for one in self.left if reached is not None and reached.least and due(one, reached)]:
            self.left.remove(text)
            steps.put()
            facts = metadata(task.job, task.integrator, reached, False, perf_counter() - self.started)
            facts |= {"prosim.ended": f"snapshot {text}", "prosim.noise_at_most": f"{steps.noise_at_most():.6g}"}
            exr = images.encode(task.sensor.film().bitmap(), facts)[".exr"]
            output.save(task.stem.with_name(f"{task.stem.name}.{text}"), {".exr": exr})


def due(snapshot: str, reached: Reached) -> bool:
    """Whether the error is as small as a snapshot says, or its time is over."""
    if snapshot.endswith("s"):
        return reached.seconds >= float(snapshot[:-1])
    return reached.noise <= float(snapshot)


def end_without_image(signals: Sequence[int], lost: str | None) -> NoReturn:
    """Ends the process that has rendered nothing. Raises ClickException where the cluster was ``lost``."""
    nothing = "before the first sample; nothing was written."
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
) -> Image:
    """The image of a render that has ended. ``interrupted``: the cause; ``facts``: further metadata."""
    integrator, film, reached = scene.integrator(), sensor.film(), steps.reached
    only_time = rendering.keeps(integrator) and integrator.time and not report.goals(integrator)
    at_most = steps.noise_at_most() if only_time and not job.denoise else None
    sentence = report.sentence(integrator, reached, bool(interrupted), interrupted or "", at_most)
    bitmap, own, denoising = denoised(steps, film) if job.denoise else (film.bitmap(), {}, None)
    header = metadata(job, integrator, reached, bool(interrupted), seconds) | own | dict(facts or {})
    exposure = job.exposure or 0.0
    colours = images.colours(bitmap)
    why = None if colours is None else black.why(scene, sensor, colours * 2.0**exposure, exposure=exposure)
    contents = images.encode(bitmap, header, exposure, own)
    return Image(contents, tuple(film.crop_size()), seconds, [line for line in (sentence, denoising) if line], why)


def metadata(
    job: Job, integrator: mi.Integrator, reached: Reached | None, interrupted: bool, seconds: float
) -> dict[str, str]:
    """The metadata of an EXR image."""
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
    """Raises ClickException where the package is missing, ValueError where ``film`` stores no colours, or the
    ``integrator`` already denoises.
    """
    need("denoise", "--denoise")
    if integrator is not None and "denoised.R" in integrator.aov_names():
        raise ValueError("the scene's integrator, prosim_denoised, already denoises; leave out --denoise.")
    halves.check(film)


def denoised(steps: halves.DenoisedRender, film: mi.Film) -> tuple[mi.Bitmap, dict[str, str], str]:
    """The denoised image, its metadata, and a line of the report; of a render that was interrupted the first half."""
    both = steps.halves
    if both.second is None:
        return layers.undenoised(both), {"prosim.denoised": "no, interrupted"}, "not denoised: interrupted"
    result, denoised, limit = steps.denoised(), steps.networks != "none", getattr(steps.integrator, "noise", 0.0)
    facts = {
        "prosim.denoised": f"by Open Image Denoise {oidn.load().oidn_version()}, where two halves of the samples "
        "agree; the layers raw and denoised of the EXR are what was mixed"
        if denoised
        else "no, the raw image is within the limit",
        "prosim.denoised.noise": f"{result.noise:.6g}",
        "prosim.denoised.raw_noise": f"{result.raw_noise:.6g}",
    }
    if steps.render is not None and (estimates := steps.render.state.estimates):
        facts["prosim.denoised.estimates"] = json.dumps(estimates)  # samples, networks, noise
    line = f"denoised: noise about {result.noise:.2g}, raw {result.raw_noise:.2g}" if denoised else NOT_DENOISED
    if result.at_most > UNCERTAIN * max(result.noise, limit):
        line += f", uncertain: may be {result.at_most:.2g}"
    if not film.rfilter().is_box_filter():
        line += " (the film's filter is wider than a pixel; a box filter suits a denoiser better)"
    return layers.bitmap(both, result), facts, line


# ---------------------------------------------------------------- checkpoints


def refuse_other_integrators(job: Job, integrator: mi.Integrator) -> None:
    """Raises ValueError where an option needs an integrator of ours."""
    option = "--part" if job.part else "--keep" if job.keep else job.distributed
    if option and not rendering.keeps(integrator):
        raise ValueError(
            f"{option} needs prosim or prosim_adaptive, in all but scalar variants; this scene's integrator is "
            f"{integrator.class_name()}. Add --noise 0.01 or --adaptive none --samples 8, for example: prosim_adaptive "
            "then wraps it."
        )


def unfinished(stem: Path, about: Mapping[str, Any]) -> Checkpoint | None:
    """The state of an interrupted render, if it exists and belongs to this job."""
    try:
        record = checkpoint.load(f"{stem}{STATE}")
    except (OSError, ValueError):
        return None
    return record if json.dumps(record.about, sort_keys=True) == json.dumps(about, sort_keys=True) else None
