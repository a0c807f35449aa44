"""``prosim render``, ``prosim resume`` and ``prosim merge``: render a scene, continue an interrupted render from a
state file, or merge the parts of an image.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from ..engine import checkpoint
from ..engine.checkpoint import Checkpoint
from ..engine.error_target import ErrorTarget
from ..engine.plan import TARGETS
from ..engine.policies import POLICIES
from . import files
from .files import image_stem
from .job import OPTIONS, RUNNING, Command, Job, choose_variant, job_options
from .option_types import SCENE_FILE, STATE_FILE, input_errors, option
from .render_task import STATE_SUFFIX, SUFFIXES, render_and_write

#: Policies that decide only once, by the first samples of each pixel. They cannot decide again after a checkpoint: with
#: a new target, ``prosim resume`` replaces them by ``graded``.
FIRST_SAMPLE_POLICIES = [name for name, policy in POLICIES.items() if not (policy.decides_again and policy.unbounded)]

#: Options that change when a render stops.
TARGET_OPTIONS = (*TARGETS, "max_samples", "adaptive")

#: Decorator that adds the option --scene to a command that opens a state.
scene_option = option("Scene", "--scene", "moved", type=SCENE_FILE, help="Path of the scene, if it was moved.")


@click.command(cls=Command)
@click.argument("scene", type=SCENE_FILE)
@job_options(*OPTIONS)
def render(job: Job) -> None:
    """Render SCENE, a file in the thesis's scene language (any name) or a Mitsuba scene (.xml).

    The command writes a linear EXR image, whose metadata describe the render, and a tone-mapped PNG image. Existing
    files are replaced when the new files are complete. Ctrl-C ends the render; the unfinished image is written (exit
    code 1).

    The options --noise, --time and --spp set the quality. By default, the scene sets the quality.
    """
    stem = files.output_stem(job.output, Path(job.scene).with_suffix(""), SUFFIXES)
    if job.frames is None:
        render_and_write(job, stem)
    else:
        from .frames import Animation  # imports the translator, which an XML scene does not need

        Animation(job, stem).render()


@click.command(cls=Command)
@click.argument("state", type=STATE_FILE)
@job_options(*TARGET_OPTIONS, "output", "exposure", "verbose", "threads", "workers", "cluster")
@scene_option
def resume(job: Job, state: Path, moved: Path | None) -> None:
    """Continue the render that prosim render --checkpoint has stored in the file STATE.

    The image has the same bits as an image of a render without interruption. If an option sets another target, the
    render continues until this target is reached. The time for --time includes the time of the render before the
    interruption. If the scene or the software version has changed since STATE was written, the command fails.
    """
    record, before = checkpoint_and_job(state, moved)
    target: dict[str, Any] = {name: value for name in TARGET_OPTIONS if (value := getattr(job, name)) is not None}
    if record.part and (target or job.distributed):
        raise click.UsageError(
            f"{state} is a part, and all parts of an image have one target; finish it without further options. "
            "prosim merge --checkpoint makes a state of all parts, which can be continued."
        )
    if target.get("adaptive") in FIRST_SAMPLE_POLICIES:
        raise click.UsageError(f"--adaptive {target['adaptive']} decides by the first samples, which exist already.")
    if target:
        policy = record.attributes["sampling"]["adaptive"]
        # The target replaces --spp, too.
        unfit = before.spp or policy in FIRST_SAMPLE_POLICIES
        target = {"adaptive": "graded" if unfit else policy, "spp": None} | reached(record, target) | target
    job = continued_job(before, job, checkpoint=True, part=record.part, **target)
    render_and_write(job, files.output_stem(job.output, image_stem(state), SUFFIXES), record)
    if record.finished and not target:
        click.echo(
            "The render was finished before. When all parts are finished, prosim merge makes the image of them."
            if record.part
            else "The render was finished before. To improve the image, add another target, such as --noise or --time."
        )


def reached(record: Checkpoint, target: Mapping[str, Any]) -> dict[str, Any]:
    """Returns 0 (no limit) for each limit of the options or the scene that the state ``record`` has reached, and that
    would thus end the render at once, whatever its new ``target``.
    """
    before = record.attributes["sampling"]
    errors = ErrorTarget((before["noise"], before["noise_99"]), 0.0, 0.0).excess(record.attributes["noise"])
    # The denoiser may have reserved some of the time.
    time_is_up = record.finished and before["time"] and record.attributes["seconds"] > 0.9 * before["time"]
    names = ("time",) if time_is_up and target.keys() != {"adaptive"} else ()
    return dict.fromkeys((*names, "noise", "noise_99") if "time" in target and errors <= 1 else names, 0.0)


@click.command(cls=Command)
@click.argument("part_files", metavar="PART...", type=STATE_FILE, nargs=-1, required=True)
@job_options("output", "exposure", "checkpoint", "verbose", "threads")
@scene_option
def merge(job: Job, part_files: tuple[Path, ...], moved: Path | None) -> None:
    """Merge all PARTs of an image, files that prosim render --part has written, to the whole image.

    The image has the same bits as an image that is rendered without --part, if all parts were rendered on the same kind
    of processor. Each part must be given once; the order of the parts does not matter. The command renders nothing.
    """
    record, before = checkpoint_and_job(part_files[0], moved, lambda _: checkpoint.merge(part_files))
    stem = files.output_stem(job.output, image_stem(part_files[0]), SUFFIXES)
    render_and_write(continued_job(before, job), stem, record)
    click.echo(
        f"The parts can be removed: {stem}{STATE_SUFFIX} stores all of them."
        if job.checkpoint
        else "The parts can be removed, unless the image is to be continued: --checkpoint makes a state of them."
    )


def continued_job(saved: Job, requested: Job, **changes: Any) -> Job:
    """Returns the job ``saved`` of a state file, with the fields of the job ``requested`` that do not change the image,
    its exposure if it has one, and the ``changes``.
    """
    running = {name: getattr(requested, name) for name in RUNNING}
    exposure = saved.exposure if requested.exposure is None else requested.exposure
    return replace(saved, exposure=exposure, **running | changes)


def checkpoint_and_job(
    state: Path, moved: Path | None, load: Callable[[Path], Checkpoint] = checkpoint.load
) -> tuple[Checkpoint, Job]:
    """Reads the file ``state`` by ``load``; returns its checkpoint and its job, and sets the variant of the job.

    The scene of the job is the file ``moved``, the stored path, or a file of the same name in the folder of ``state``.
    Raises InputError if the checkpoint cannot be read, if prosim render did not write it, or if the scene is missing.
    """
    with input_errors():
        # The variant must be set before the arrays are read.
        choose_variant(checkpoint.read(state, arrays=False).environment["variant"])
        record = load(state)
        job = Job.of(record)
        scene = Path(job.scene)
        for path in filter(None, (moved, scene, state.parent / scene.name)):
            if path.is_file():
                return record, replace(job, scene=str(path))
        raise ValueError(f"{scene} does not exist, nor does the folder of {state} have it; give its path by --scene")
