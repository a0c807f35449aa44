"""Renders one image step by step, writes its files, and reports what it has reached: in the metadata of the EXR file,
and in the lines that the command prints at the end.
"""

from __future__ import annotations

import json
import os
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from math import isnan
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, NamedTuple

import click
import mitsuba as mi

from .. import __version__, atomic
from ..compat import description
from ..engine import checkpoint
from ..engine.checkpoint import Checkpoint, CheckpointWriter
from ..engine.error_target import REST, ErrorTarget
from ..engine.plan import TARGETS
from ..engine.render import Reached
from ..explaining.verdict import ERRORS, denoised_words, end_cause, name_in, verdict
from ..parameters import pick_sensor
from ..scene import black, images, rendering, scene_file, session
from . import files
from .job import Job, refuse_scalar
from .option_types import InputError, input_errors, require_extra
from .terminal import Progress, interruptible, log

if TYPE_CHECKING:
    from ..denoising.final_image import FinalImage
    from ..parallel.executor import DaskExecutor

#: Suffixes of the files of an image, and of its checkpoint.
SUFFIXES, STATE_SUFFIX = (".exr", ".png"), ".state.npz"


@dataclass(eq=False)
class RenderTask:
    """An image that is to be rendered and written to ``stem``, a path without suffix.

    ``begin`` is a checkpoint from which the render continues. ``facts`` are additional metadata for the EXR file of a
    frame of an animation, and empty for a single image. No image of an interrupted frame is written.
    """

    job: Job
    file: scene_file.SceneFile
    stem: Path
    begin: Checkpoint | None = None
    facts: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def scene(self) -> mi.Scene:
        """The loaded scene; the first access loads the scene, and raises the errors of the scene's plugins."""
        return self.file.load()

    @cached_property
    def sensor(self) -> mi.Sensor:
        """The sensor that the job selects by a number; raises ValueError if the scene has no such sensor."""
        return pick_sensor(self.scene, self.job.sensor)

    @property
    def integrator(self) -> Any:
        """The scene's integrator, or the one that prosim_denoised nests."""
        integrator: Any = self.scene.integrator()
        return integrator.nested if rendering.is_denoised(integrator) else integrator

    @property
    def denoise(self) -> bool:
        """Whether the image is denoised, by the option or by prosim_denoised."""
        return bool(self.job.denoise) or self.integrator is not self.scene.integrator()

    @cached_property
    def about(self) -> dict[str, Any]:
        """The attributes that a checkpoint stores: the job, and the digest that identifies the content of the scene."""
        image = self.job.image_fields() | {"scene": os.path.abspath(self.job.scene)}
        return {"job": image, "digest": self.file.digest()}

    def check(self) -> None:
        """Loads the scene, and checks that it suits the options, and that the output files can be written.

        Raises the errors of loading the scene, ValueError if the options or the checkpoint do not suit the scene,
        InputError if the files cannot be written, and ClickException if the denoiser is not installed.
        """
        job, film, integrator = self.job, self.sensor.film(), self.integrator
        refuse_scalar(", ".join(name for name in TARGETS if getattr(integrator, name, 0)), job.variant)
        if self.denoise:
            check_denoising(film)
            if wrong := [f"--{name}" for name in ("layers", "snapshots") if getattr(job, name)]:
                raise ValueError(f"{', '.join(wrong)}: the image is denoised; leave it out, or do not denoise")
        option = "--part" if job.part else "--checkpoint" if job.checkpoint else job.distributed
        if option:
            rendering.require_progressive(integrator, option)
            if integrator is not self.scene.integrator():
                raise ValueError(
                    f"{option} with prosim_denoised: replace it by the integrator that it nests, and give --denoise"
                )
        if self.begin is not None and self.begin.about.get("digest") != self.about["digest"]:
            raise ValueError(
                f"{job.scene} is not the scene of this state: its text has changed, or a mesh or a picture that it "
                "names. Render it again, or give the right one by --scene."
            )
        width, height = film.crop_size()
        # Bytes per pixel: ten channels of 32 bits, the PNG, and the integrator's own channels; further channels
        # of a denoiser; and the 64-bit sums of a state, for each pixel within the filter's reach.
        aovs, within = len(integrator.aov_names()), (2 * film.rfilter().border_size() + 1) ** 2
        each = 48 + 4 * aovs + 12 * self.denoise
        each += (36 + 8 * within * (5 + aovs)) * (1 + self.denoise) * bool(self.state_suffix)
        size = int(width * height) * each + 2**16
        suffixes = [*(() if job.part else SUFFIXES), *filter(None, [self.state_suffix])]
        suffixes += [f".{snapshot}.exr" for snapshot in job.snapshots or ()]
        files.check(self.stem, suffixes, size, [self.file.path, *self.file.sources()])

    @property
    def state_suffix(self) -> str:
        """The suffix of the file for the checkpoint or the part of an image; "" without such a file."""
        return f".{self.job.part}.npz" if self.job.part else STATE_SUFFIX if self.job.checkpoint else ""

    def unfinished(self) -> Checkpoint | None:
        """Returns the checkpoint that an earlier render of the same image has written; None if there is no such
        checkpoint, or if it cannot be continued.
        """
        try:
            record = checkpoint.load(f"{self.stem}{STATE_SUFFIX}")
        except (OSError, ValueError):
            return None
        return record if json.dumps(record.about, sort_keys=True) == json.dumps(self.about, sort_keys=True) else None


class Resources(ExitStack):
    """The resources that all images of a job share: Mitsuba's log, a temporary ``folder``, and the workers, which start
    with the first image.

    ``signals`` is the list of the numbers of the signals, such as SIGINT, that have arrived to end the job.
    """

    def __init__(self, job: Job) -> None:
        super().__init__()
        self.job, self.signals = job, list[int]()
        #: The integrator of the current image.
        self.integrator: Any = None
        self.dask: DaskExecutor | None = None

    def __enter__(self) -> Resources:
        self._handlers = self.enter_context(ExitStack())  # which is the last to be left
        self.folder = self.enter_context(atomic.scratch())
        self.enter_context(log(self.job.verbose, self.folder))
        self.enter_context(session.threads(self.job.threads))
        return self

    def handle_signals(self) -> None:
        """From this call on, the first signal ends the current image, and then the job, when all resources are
        released; a second signal ends the job at once.
        """
        self._handlers.enter_context(interruptible(self._stop, self.signals))

    def _stop(self) -> None:
        if self.integrator is not None:
            self.integrator.cancel()

    @property
    def interruption(self) -> str | None:
        """Why the job must end, in words: the cluster was lost, or a signal has arrived; else None."""
        return (self.dask and self.dask.loss_reason) or ("interrupted" if self.signals else None)

    def executor(self, file: scene_file.SceneFile) -> DaskExecutor | None:
        """Returns the executor that renders the scene ``file`` on workers; None if this process renders the image.

        Raises InputError if the scene cannot be sent to workers, and ClickException if there are no workers or no Dask.
        """
        job, option = self.job, self.job.distributed
        if option is None:
            return None
        require_extra("cluster", option)
        from ..parallel import cluster
        from ..parallel.executor import DaskExecutor
        from ..parallel.worker import SceneBundle

        with input_errors():
            bundle = SceneBundle.of(file, job.sensor)
        if self.dask is not None:
            self.dask.change_scene(bundle)
            return self.dask
        if job.cluster:
            context = cluster.scheduler(job.cluster)
        else:
            context = cluster.workers(job.workers or 1, job.threads, self.folder)
        try:
            self.dask = DaskExecutor(self.enter_context(context), bundle)
        except RuntimeError as error:
            message = str(error) if job.cluster else f"the workers can't be started here ({error})"
            raise click.ClickException(message) from None
        return self.dask


class Outcome(NamedTuple):
    """The result of the render of an image: the report, and the reasons for a black image and for an early end."""

    #: The lines that the command prints.
    report: str
    #: Why nothing is visible; None if something is visible.
    why_black: str | None
    #: Why the render ended too early, in words; None if the render is complete.
    interruption: str | None


def render_image(task: RenderTask, bar: Progress, resources: Resources) -> Outcome:
    """Renders the image of ``task``, and writes its files; for a part of an image, and for an interrupted frame, only
    the checkpoint.

    Raises InputError if the input is wrong (in this case, no file has been written), and other ClickExceptions. If a
    single image is interrupted before its first sample, the process exits with 128 plus the number of the signal, or
    with 1.
    """
    state, snapshots = Path(f"{task.stem}{task.state_suffix}"), Snapshots(task)
    consumers: list[Any] = [CheckpointWriter(state, task.about)] if task.state_suffix else []
    resources.integrator = task.integrator
    render, final, seconds = run_steps(task, bar, resources, [snapshots, *consumers])
    snapshots(render)
    if snapshots.left:
        left = ",".join(snapshots.left)
        warnings.warn(f"--snapshots {left}: not written, because the render ended earlier", stacklevel=2)
    reached, interruption = render.reached, resources.interruption
    if interruption and not task.facts and reached is not None and reached.samples == 0:
        words = f"{interruption} before the first sample; nothing was written."
        click.echo(words[0].upper() + words[1:], err=True)
        sys.exit(128 + resources.signals[0] if resources.signals else 1)
    saved, unsaved = list[Path](), dict[str, atomic.Content]()
    if task.state_suffix:  # writes the state before denoising, which may fail or be interrupted
        unsaved = {task.state_suffix: replace(render.checkpoint(), about=task.about).write}
        # If the state cannot be written now, ``files.save`` writes it with the image, to another folder if needed.
        with suppress(OSError):
            saved, unsaved = atomic.write({state: unsaved[task.state_suffix]}), {}
    contents, lines, why_black = finished_image(task, render, final, seconds, interruption is not None)
    written = [*files.save(task.stem, contents | unsaved), *saved]
    lines = [written_line(task, written, seconds, interruption), *lines]
    if interruption and task.state_suffix:
        lines.append(f"To continue it: prosim resume {state}")
    return Outcome("\n".join(filter(None, lines)), why_black, interruption)


def run_steps(
    task: RenderTask, bar: Progress, resources: Resources, consumers: Sequence[Callable[[Any], None]]
) -> tuple[Any, FinalImage | None, float]:
    """Renders the image of ``task``; returns the render, its final image (None without denoising), and the seconds.

    A signal or the loss of the cluster interrupts the render. After each step, each of the ``consumers``, such as the
    writer of checkpoints, is called with the render. Raises InputError and other ClickExceptions.
    """
    job, executor, started = task.job, resources.executor(task.file), perf_counter()
    what = task.scene, task.sensor, task.integrator, job.seed, job.spp or 0
    options: dict[str, Any] = {"begin": task.begin, "part": job.part, "executor": executor}
    if task.begin is not None and not job.spp:  # N of the passes so far, if a target has replaced --spp
        task.integrator.samples = task.begin.attributes["sampling"]["samples"]
    try:
        final = None
        if task.denoise:
            from ..denoising.final_image import denoised_progressive  # which an image without denoising does not need

            final = denoised_progressive(*what, getattr(task.scene.integrator(), "fast", None), **options)
        render = rendering.progressive(*what, **options) if final is None else final.render
        while not resources.interruption and (step := next(render, None)) is not None:
            bar.show(step.done)
            for consume in consumers if step.done else ():
                consume(render)
        render.close()
    except ValueError as error:
        raise InputError(str(error)) from None
    except (RuntimeError, MemoryError) as error:
        raise click.ClickException(f"the scene could not be rendered: {session.message(error)}") from None
    return render, final, perf_counter() - started


def written_line(task: RenderTask, written: Sequence[Path], seconds: float, interruption: str | None) -> str:
    """Returns the first line of the report: the ``written`` files, the part, the size, the variant, the seconds, what
    became of the integrator, and the interruption.
    """
    job, (width, height) = task.job, task.sensor.film().crop_size()
    return (
        f"{' and '.join(map(str, written))}: "
        + (f"part {job.part.number} of {job.part.of}, " if job.part else "")
        + f"{width} x {height} pixels, {job.variant}, {seconds:.2f} s"
        + (f", {task.file.wrapped}" if task.file.wrapped else "")
        + (f", {interruption}" if interruption else "")
    )


def render_and_write(job: Job, stem: Path, begin: Checkpoint | None = None) -> None:
    """Renders the image of a job, or a part of it, writes the files, and prints a report.

    ``stem`` is the path of the files without suffix. ``begin`` is a checkpoint from which the render continues. Raises
    the errors of :func:`render_image`. After an interruption, the process exits with the code 1.
    """
    with Resources(job) as resources:
        with input_errors():
            task = RenderTask(job, job.read_scene(resources.folder), stem, begin)
            task.check()
        resources.handle_signals()
        # The first step ends when the kernels are compiled and one work item is rendered.
        with Progress("compiling kernels" if rendering.is_progressive(task.integrator) else "rendering") as bar:
            outcome = render_image(task, bar, resources)
        if outcome.why_black:
            warnings.warn(outcome.why_black, stacklevel=2)
    click.echo(outcome.report)
    if outcome.interruption:
        sys.exit(1)


class Snapshots:
    """Writes snapshots, which are intermediate images, during the render of a task.

    The snapshot ``0.04`` is written to ``NAME.0.04.exr`` when the option ``--noise 0.04`` would end the render, and the
    snapshot ``4s`` to ``NAME.4s.exr`` after 4 seconds. A render that continues has written those of its beginning.
    """

    def __init__(self, task: RenderTask) -> None:
        self.task, self.left = task, sorted(task.job.snapshots or ())
        if task.begin is not None:
            noise, seconds = task.begin.attributes["noise"], task.begin.attributes["seconds"]
            self.left = [text for text in self.left if not is_due(text, noise, seconds)]

    def __call__(self, render: Any) -> None:
        """Writes the snapshots that are due, once each, if the render is progressive and each pixel has a sample."""
        reached, task = render.reached if self.left else None, self.task
        if reached is None or not reached.min_samples:
            return
        for text in list(self.left):
            if is_due(text, render.state.noise, reached.seconds):
                self.left.remove(text)
                render.update_film()
                facts = metadata(task.job, task.integrator, reached, None, reached.seconds)
                facts = {"prosim.noise_at_most": f"{render.noise_bound():.6g}"} | facts
                facts["prosim.ended"] = f"snapshot {text}"
                exr = images.exr(task.sensor.film().bitmap(), facts)
                files.save(task.stem.with_name(f"{task.stem.name}.{text}"), {".exr": exr})


def is_due(snapshot: str, noise: Sequence[float], seconds: float) -> bool:
    """Tells whether a render with these errors, after these ``seconds``, has reached the ``snapshot``: with --noise, a
    limit of the RMS error only, or with --time, it would end.
    """
    amount = float(snapshot.removesuffix("s"))
    if snapshot.endswith("s"):
        return seconds >= (1 - REST) * amount  # see ErrorTarget.time_is_up
    return ErrorTarget((amount, 0), 0.0, 0.0).excess(noise) <= 1


def finished_image(
    task: RenderTask, render: Any, final: FinalImage | None, seconds: float, interrupted: bool
) -> tuple[dict[str, atomic.Content], list[str | None], str | None]:
    """Returns the image files (suffix -> content), lines of the report (or None), and why the image is black, or None.

    The image is that of ``final``, the denoiser, unless the render was interrupted before its second half. A part of an
    image and an interrupted frame have no files and no lines.
    """
    if task.job.part or (task.facts and interrupted):  # only a frame has ``facts``
        return {}, [], None
    job, film, added = task.job, task.sensor.film(), dict[str, str]()
    ended, bitmap = end_cause(render, interrupted), film.bitmap()
    header = metadata(job, task.scene.integrator(), render.reached, ended, seconds)
    if final is not None:
        added = denoised_facts(final, interrupted)
        bitmap = bitmap if interrupted and len(final.render.half_images()) == 1 else final.bitmap()
    exposure = job.exposure or 0.0
    line = summary(render, final, interrupted, task.integrator, task.file, exposure)  # before the time of encoding
    colours = images.colours(bitmap)
    why_black = None
    if not interrupted:
        called = partial(name_in, task.file)
        why_black = black.reason(task.scene, task.sensor, colours, exposure=exposure, called=called)
    # The EXR has all metadata; the PNG has only the metadata of denoising.
    contents = images.encode(bitmap, header | added | dict(task.facts), exposure, added)
    return {**contents}, [line], why_black


def check_denoising(film: mi.Film) -> None:
    """Raises ClickException if the denoiser is not installed, and ValueError if ``film`` stores no colours."""
    require_extra("denoise", "--denoise")
    from ..denoising.halves import check

    check(film)


def metadata(job: Job, integrator: Any, reached: Reached | None, ended: str | None, seconds: float) -> dict[str, str]:
    """Returns the metadata of an EXR image.

    ``reached`` is None if the render is not progressive; otherwise, there are entries for the mean number of samples
    per pixel and the measured errors. ``ended`` is the result of :func:`.end_cause`.
    """
    result = {
        "scene": job.scene,
        "version": __version__,
        "variant": job.variant,
        "integrator": description(integrator),
        "seed": str(job.seed),
        "seconds": f"{seconds:.3f}",
    }
    if reached is not None:
        values = {name: getattr(reached, name) for name in ("samples", *ERRORS, "noise_at_most")}
        result |= {name: f"{value:.6g}" for name, value in values.items() if not isnan(value)}
    if ended is not None:
        result["ended"] = ended
    if layers := getattr(integrator, "layer_names", None):
        result["layers"] = "\n".join(layers)
    return {f"prosim.{name}": value for name, value in result.items()}


def summary(
    render: Any, final: FinalImage | None, interrupted: bool, integrator: Any, file: Any, exposure: float
) -> str | None:
    """Returns a line with the verdict, the samples and the seconds of a render, for the arguments of :func:`.verdict`;
    None for a render with neither a target nor a ``final`` image of a denoiser.
    """
    reached = render.reached if end_cause(render) else None
    if reached is None:
        return None if final is None else denoised_words(final, interrupted)
    limit = f" of {render.target.seconds:g}" if render.target.seconds else ""
    words, stop, causes = verdict(render, final, interrupted, integrator, file, exposure).partition(". ")
    return f"{words}, {reached.samples:.1f} samples a pixel, {reached.seconds:.1f} s{limit}{stop}{causes}"


def denoised_facts(final: FinalImage, interrupted: bool) -> dict[str, str]:
    """Returns the metadata of the ``final`` image of a denoiser."""
    if interrupted and len(final.render.half_images()) == 1:
        return {"prosim.denoised": "no, interrupted"}
    from ..denoising import oidn

    result = final.denoised()
    facts = {
        "prosim.denoised": f"by Open Image Denoise {oidn.load().oidn_version()}, where two halves of the samples "
        "agree; the layers raw and denoised of the EXR are what was mixed",
        "prosim.denoised.noise": f"{result.noise:.6g}",
        "prosim.denoised.raw_noise": f"{result.raw_noise:.6g}",
    }
    if why := final.why_raw:
        facts["prosim.denoised"] = f"no: {why}"
    return facts
