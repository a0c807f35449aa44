"""One image: its render, step by step, and its files."""

from __future__ import annotations

import json
import os
import sys
import warnings
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import click
import mitsuba as mi

from .. import atomic
from ..denoising import halves, layers
from ..engine import checkpoint
from ..engine.checkpoint import Checkpoint, CheckpointWriter
from ..engine.error_target import SHARE
from ..scene import black, images, rendering, scene_file, session
from . import files, report
from .interrupts import interruptible
from .job import TARGETS, Job, refuse_scalar
from .log import log
from .option_types import InputError, input_errors, require_extra
from .progress import Progress
from .tev import TevClient

if TYPE_CHECKING:
    from ..parallel.executor import DaskExecutor

#: Suffixes of an image, and of its state.
SUFFIXES, STATE = (".exr", ".png"), ".state.npz"


@dataclass(eq=False)
class RenderTask:
    """An image that is to be rendered and written to ``stem``, a path without suffix.

    ``begin``: the checkpoint to continue. ``facts``: further metadata of the image, which frames of a film alone have;
    an interrupted frame is not written.
    """

    job: Job
    file: scene_file.SceneFile
    stem: Path
    begin: Checkpoint | None = None
    facts: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def scene(self) -> mi.Scene:
        """The scene, loaded at the first use. Raises the errors of its plugins."""
        return self.file.load()

    @cached_property
    def sensor(self) -> mi.Sensor:
        """The sensor that the job names. Raises ValueError where the scene has no such sensor."""
        return scene_file.pick_sensor(self.scene, self.job.sensor)

    @property
    def integrator(self) -> Any:
        """The scene's integrator."""
        return self.scene.integrator()

    @cached_property
    def about(self) -> dict[str, Any]:
        """Facts that identify the checkpoints, and by which another process continues the job."""
        image = self.job.image() | {"scene": os.path.abspath(self.job.scene)}
        return {"job": image, "digest": self.file.digest()}

    def check(self) -> None:
        """Raises the errors of loading the scene, and ValueError where the options do not suit it, or :attr:`begin`
        belongs to another one.
        """
        job, film, integrator = self.job, self.sensor.film(), self.integrator
        refuse_scalar([name for name in TARGETS if getattr(integrator, name, 0)], job.variant)
        if job.denoise:
            check_denoising(film, integrator)
        option = "--part" if job.part else "--checkpoint" if job.checkpoint else job.distributed
        if option:
            rendering.require_progressive(integrator, option)
        if self.begin is not None and self.begin.about["digest"] != self.about["digest"]:
            raise ValueError(
                f"{job.scene} is not the scene of this state: its text has changed, or a mesh or a picture that it "
                "names. Render it again, or give the right one by --scene."
            )

    @property
    def state_suffix(self) -> str:
        """The suffix of the checkpoints; empty without any."""
        return f".{self.job.part}.npz" if self.job.part else STATE if self.job.checkpoint else ""

    def check_place(self) -> None:
        """Raises InputError where the result can't be written."""
        width, height = self.sensor.film().crop_size()
        # Ten channels of 32 bits, the integrator's own ones, and the PNG.
        size = int(width * height) * (48 + 4 * len(self.integrator.aov_names())) + 2**16
        suffixes = [*(() if self.job.part else SUFFIXES), *filter(None, [self.state_suffix])]
        files.check(self.stem, suffixes, size, [self.file.path, *self.file.sources()])

    def unfinished(self) -> Checkpoint | None:
        """The checkpoint of an interrupted render of this image, if it exists."""
        try:
            record = checkpoint.load(f"{self.stem}{STATE}")
        except (OSError, ValueError):
            return None
        return record if json.dumps(record.about, sort_keys=True) == json.dumps(self.about, sort_keys=True) else None


class Resources(ExitStack):
    """What the images of a job share: Mitsuba's log, the number of threads, a temporary ``folder``, and the workers,
    from the first image that needs them.
    """

    def __init__(self, job: Job) -> None:
        super().__init__()
        self.job = job
        self.dask: DaskExecutor | None = None

    def __enter__(self) -> Resources:
        self.enter_context(log(self.job.verbose))
        self.enter_context(session.threads(self.job.threads))
        self.folder = self.enter_context(atomic.scratch())
        return self

    @property
    def loss_reason(self) -> str | None:
        """Why the cluster has gone away; None while it is there."""
        return self.dask.loss_reason if self.dask else None

    def executor(self, file: scene_file.SceneFile) -> DaskExecutor | None:
        """The executor for the samples of an image of ``file``; None for this process.

        Raises InputError where the scene can't travel, and ClickException.
        """
        job, option = self.job, self.job.distributed
        if option is None:
            return None
        require_extra("cluster", option)
        from ..parallel import cluster
        from ..parallel.bundle import SceneBundle
        from ..parallel.executor import DaskExecutor

        with input_errors():
            bundle = SceneBundle.of(file, job.sensor)
        if self.dask is not None:
            self.dask.change_scene(bundle)
            return self.dask
        there = cluster.scheduler(job.cluster) if job.cluster else cluster.workers(job.workers or 1, job.threads)
        try:
            self.dask = DaskExecutor(self.enter_context(there), bundle)
        except RuntimeError as error:
            message = str(error) if job.cluster else f"the workers can't be started here ({error})"
            raise click.ClickException(message) from None
        return self.dask


@dataclass
class Image:
    """The image of a render that has ended: the ``contents`` of its files by suffix; the ``lines`` that the command
    prints; ``black``: why nothing is visible; ``interruption``: its cause.
    """

    contents: dict[str, atomic.Content] = field(default_factory=dict)
    lines: Sequence[str | None] = ()
    black: str | None = None
    interruption: str | None = None

    @property
    def report(self) -> str:
        """The text that the command prints."""
        return "\n".join(filter(None, self.lines))


def render_image(
    task: RenderTask, bar: Progress, resources: Resources, received_signals: list[int] | None = None
) -> Image:
    """Renders an image and writes it, or its state. For ``received_signals`` see :func:`.interruptible`.

    Raises InputError, where nothing has been written, and ClickException; ends the process where it was interrupted
    before the first sample, unless it is a frame of a film.
    """
    job, is_frame, film = task.job, bool(task.facts), task.sensor.film()
    task.check_place()
    state = Path(f"{task.stem}{task.state_suffix}")
    consumers: list[Any] = [CheckpointWriter(state, task.about)] if task.state_suffix else []
    snapshots = Snapshots(task)
    with TevClient(job, film) as shown, interruptible(task.integrator.cancel, received_signals) as signals:
        consumers += [snapshots, shown.update]
        executor = resources.executor(task.file)
        started = perf_counter()
        start = halves.denoised_progressive if job.denoise else rendering.progressive
        how: dict[str, Any] = {"begin": task.begin, "part": job.part, "executor": executor}
        try:
            steps = start(task.scene, task.sensor, task.integrator, job.seed, job.spp or 0, **how)
            while not (signals or resources.loss_reason) and (step := next(steps, None)) is not None:
                bar.show(step.done)
                for consume in consumers:
                    consume(steps)
            steps.close()
            snapshots(steps)
        except ValueError as error:
            raise InputError(str(error)) from None
        except (RuntimeError, MemoryError) as error:
            raise click.ClickException(f"the scene could not be rendered: {session.message(error)}") from None
        seconds, reached = perf_counter() - started, steps.reached
        lost = resources.loss_reason
        interruption = lost or ("interrupted" if signals else None)
        if interruption and not is_frame and reached is not None and reached.samples == 0:
            nothing = "before the first sample; nothing was written."
            if lost:
                raise click.ClickException(f"{lost} {nothing}")
            click.echo(f"Interrupted {nothing}", err=True)
            sys.exit(128 + signals[0])
        image, saved, unsaved = Image(), list[Path](), {}
        if task.state_suffix:  # first: the denoiser may fail, or the user may not wait for it
            content = replace(steps.checkpoint(), about=task.about).write
            try:
                saved = atomic.write({state: content})
            except OSError:
                unsaved = {task.state_suffix: content}
        if job.part is None and not (is_frame and interruption):
            image = finish(task, steps, seconds, interruption is not None)
        partial = image.contents and reached is not None and reached.min_samples == 0
        shown.show()
        written = [*files.save(task.stem, image.contents | unsaved), *saved]
    width, height = film.crop_size()
    first = (
        f"{' and '.join(map(str, written))}: "
        + (f"part {job.part.number} of {job.part.of}, " if job.part else "")
        + f"{width} x {height} pixels, {job.variant}, {seconds:.2f} s"
        + (f", {task.file.wrapped} within prosim_adaptive" if task.file.wrapped else "")
    )
    image.lines, image.interruption = [first, *image.lines], interruption
    if interruption:
        first += ", interrupted" + (": pixels without a sample are black" if partial else "")
        how_to_continue = f"To continue it: prosim resume {state}" if task.state_suffix else None
        image.lines = [first, lost, *image.lines[1:], how_to_continue]
    return image


def write_image(job: Job, stem: Path, begin: Checkpoint | None = None) -> None:
    """Renders a job, or its part alone, writes its image, and prints a report. ``stem``: the path without suffix.

    ``begin``: continues from there. Raises InputError, where nothing has been written, and ClickException; ends the
    process where it was interrupted.
    """
    with ExitStack() as until_reported:
        with Resources(job) as resources:
            with input_errors():
                task = RenderTask(job, job.read_scene(resources.folder), stem, begin)
                task.check()
            progressive = rendering.is_progressive(task.integrator)
            # Workers need a second to end, when the image is written.
            signals = until_reported.enter_context(interruptible(lambda: None))
            # The first step ends when the kernels are compiled and one work item is rendered.
            with Progress("compiling kernels" if progressive else "rendering", timed=progressive) as bar:
                image = render_image(task, bar, resources, signals)
            if image.black:
                warnings.warn(image.black, stacklevel=2)
        click.echo(image.report)
    if image.interruption:
        sys.exit(1)


class Snapshots:
    """Writes the image of a task, without suffix ``NAME``, to ``NAME.0.04.exr`` when its error is this small, or to
    ``NAME.4s.exr`` after 4 seconds, with its true error, counts and time.
    """

    def __init__(self, task: RenderTask) -> None:
        self.task, self.left, self.started = task, sorted(task.job.snapshots or ()), perf_counter()

    def __call__(self, steps: Any) -> None:
        """Writes those that are due."""
        reached, task = steps.reached if self.left else None, self.task
        if reached is None or not reached.min_samples:
            return
        for text in list(self.left):
            amount = float(text.removesuffix("s"))
            due = reached.seconds >= (1 - SHARE) * amount if text.endswith("s") else reached.noise <= amount
            if due:
                self.left.remove(text)
                steps.update_film()
                seconds = perf_counter() - self.started
                facts = report.metadata(task.job, task.integrator, reached, False, seconds)
                facts |= {"prosim.ended": f"snapshot {text}", "prosim.noise_at_most": f"{steps.noise_bound():.6g}"}
                exr = images.encode(task.sensor.film().bitmap(), facts)[".exr"]
                files.save(task.stem.with_name(f"{task.stem.name}.{text}"), {".exr": exr})


def finish(task: RenderTask, steps: Any, seconds: float, interrupted: bool) -> Image:
    """The image of a render that has ended, denoised if the job requests it."""
    job, integrator, film, reached = task.job, task.integrator, task.sensor.film(), steps.reached
    header = report.metadata(job, integrator, reached, interrupted, seconds)
    only_time = rendering.is_progressive(integrator) and integrator.time and not report.noise_goals(integrator)
    bound = steps.noise_bound() if only_time and not job.denoise else None
    lines, own = [report.summary(integrator, reached, header.get("prosim.ended"), bound)], dict[str, str]()
    bitmap = film.bitmap()
    if job.denoise:
        final = steps.denoiser
        if interrupted and len(final.images) == 1:
            own, line = {"prosim.denoised": "no, interrupted"}, "not denoised: interrupted"
        else:
            bitmap = layers.bitmap(final)
            own, line = report.denoised_report(final, film)
        lines.append(line)
    exposure = job.exposure or 0.0
    colours = images.colours(bitmap)
    shown = None if colours is None else colours * 2.0**exposure
    why = None if shown is None else black.reason(task.scene, task.sensor, shown, exposure=exposure)
    return Image({**images.encode(bitmap, header | own | dict(task.facts), exposure, own)}, lines, why)


def check_denoising(film: mi.Film, integrator: mi.Integrator | None = None) -> None:
    """Raises ClickException where the package is missing, ValueError where ``film`` stores no colours, or the
    ``integrator`` already denoises.
    """
    require_extra("denoise", "--denoise")
    if integrator is not None and "denoised.R" in integrator.aov_names():
        raise ValueError("the scene's integrator, prosim_denoised, already denoises; leave out --denoise.")
    halves.check(film)
