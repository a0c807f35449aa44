"""From a job to an EXR and a PNG image."""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import click
import mitsuba as mi
from tqdm.auto import tqdm

from ..engine.part import Part
from ..engine.record import Record
from ..engine.state import KEPT
from ..saved.keeper import Keeper
from ..scene import atomic, rendering, report, scene_file, session
from . import denoised, tev
from . import output as files
from .developed import develop, take
from .helping import Helping, pack
from .interrupts import interruptible
from .job import Job
from .lines import Left, Lines
from .log import log
from .options import InputError, refuse_waves, wrong_input

if TYPE_CHECKING:
    from ..cluster.remote import Remote

#: What an image is written as, and its state.
SUFFIXES, STATE = (".exr", ".png"), ".state.exr"


@dataclass(frozen=True)
class Made:
    """What is to be said of an image that has been written, and who has kept its state, if it was kept."""

    said: str
    interrupted: bool
    #: Why the cluster is there no more, if that has interrupted it.
    lost: str | None
    keeper: Keeper | None
    #: Why nothing can be seen, if that is so.
    black: str | None


def make(job: Job, stem: Path, begin: Record | None = None, sources: Collection[Path] = ()) -> None:
    """Renders ``job``, or its part alone, and writes its image, ``stem`` being the path without suffix; prints what was
    done.

    ``begin``: continues from there; ``sources``: the files of ``begin``, which no image may overwrite. Raises
    InputError, where nothing has been written, and ClickException; ends the process where it was interrupted.
    """
    keep = job.keep or job.part is not None
    with log(job.verbose), session.threads(job.threads):
        with atomic.scratch() as folder, wrong_input():
            opened = job.open(folder)
            about = job.about(opened[0]) if keep or begin is not None else {}
            if about:
                refuse_to_keep(opened[1].integrator())
            refuse_another_scene(job, begin, about)
            sources = [*sources, *(path.resolve() for _, path in opened[0].named_files())]
            parcel = pack(job, opened[0], opened[1].integrator())
        beside = tev.beside(progress_bar, job.view, job.scene, opened[2].film(), warn)
        with Helping(job, warn) as helping, beside as bar:
            by = partial(helping, parcel)
            made = render(job, opened, stem, begin, about if keep else None, bar=bar, by=by, sources=sources)
    click.echo(made.said)
    if made.interrupted:
        if made.keeper is not None:
            click.echo(f"To continue it: prosim resume {made.keeper.path}")
        sys.exit(1)


def render(
    job: Job,
    opened: tuple[scene_file.SceneFile, mi.Scene, mi.Sensor],
    stem: Path,
    begin: Record | None = None,
    keep: Mapping[str, Any] | None = None,
    frame: Mapping[str, str] | None = None,
    bar: Callable[[mi.Integrator, str], AbstractContextManager[rendering.Tell | None]] | None = None,
    by: Callable[[mi.Integrator], AbstractContextManager[Remote | None]] = lambda _: nullcontext(),
    sources: Collection[Path] = (),
) -> Made:
    """Renders ``job``, which has been ``opened``, and writes its image or state, as :func:`make` does.

    ``keep``: what the state says that it is about, where it is kept; ``frame``: further metadata of a frame of a film,
    whose image is written only if it is finished, and of which nothing is said here; ``bar``: what shows the progress,
    in the place of :func:`progress_bar`; ``by``: what lets others take the samples of an integrator, for a while;
    ``sources``: files that no image may overwrite.
    """
    file, loaded, chosen = opened
    integrator, part = loaded.integrator(), job.part
    refuse_waves([name for name in ("noise", "noise_99", "time") if getattr(integrator, name, 0)], job.variant)
    size = size_of_image(integrator, chosen.film(), job.denoise)
    suffixes: tuple[str, ...] = SUFFIXES if part is None else ()
    keeper, state = None, STATE if part is None else f".{part}.exr"
    if keep is not None:
        # The old state is there, too.
        suffixes, size = (*suffixes, state), size + 2 * size_of_state(integrator, chosen.film(), part)
        keeper = Keeper(stem.with_name(stem.name + state), keep, warn)
    files.check(Path(job.scene), stem, suffixes, size)
    files.spare(sources, files.SOURCES, stem, () if part else SUFFIXES)

    with interruptible(integrator.cancel) as signals, by(integrator) as taker:
        start = perf_counter()
        try:
            with (bar or progress_bar)(integrator, job.variant) as tell:
                how = {} if job.denoise else {"begin": begin, "part": part, "executor": taker}
                stopped = lambda: bool(signals or gone(taker))  # noqa: E731
                picture = take(loaded, chosen, job, job.denoise, tell, stopped, keeper, **how)
        except ValueError as error:
            raise InputError(str(error)) from None
        except (RuntimeError, MemoryError) as error:
            raise click.ClickException(f"the scene could not be rendered: {session.message(error)}") from None
        lost = gone(taker)
        seconds, interrupted = perf_counter() - start, bool(signals or lost)
        if interrupted and frame is None and report.nothing(picture.reached):
            nothing = "before the image had begun; nothing was written."
            if lost:
                raise click.ClickException(f"{lost} {nothing}")
            click.echo(f"Interrupted {nothing}", err=True)
            sys.exit(128 + signals[0])
        end = None if not interrupted else "the loss of the cluster" if lost else "a signal"
        written: list[Path] = []
        unwritten = part is not None or (frame is not None and interrupted)
        made = develop(job, loaded, chosen, picture, seconds, end, frame, not unwritten)
        if made.contents:
            written = files.save(stem, made.contents)
        if made.black and frame is None:
            warn(made.black)
    if keeper is not None:
        if keeper.unwritten is not None:
            files.save(stem, {state: keeper.unwritten})
        written.append(keeper.path)
    said = [
        made.line(job, file, written, part) + (f", {report.interrupted(picture.reached)}" if interrupted else ""),
        lost,
        *(made.said[1:] if part else made.said),
    ]
    return Made("\n".join(filter(None, said)), interrupted, lost, keeper, made.black)


def gone(taker: Remote | None) -> str | None:
    """Why those who take the samples are there no more; None where they are, or where it is this process."""
    return None if taker is None else taker.gone


def size_of_image(integrator: mi.Integrator, film: mi.Film, denoise: bool) -> int:
    """Bytes that an image takes at most. Raises ClickException where it is to be denoised and can't be."""
    if denoise:
        denoised.check(film, integrator)
    # Four channels of 32 bits and what else there is, and three bytes of the PNG.
    others = len(integrator.aov_names()) + (denoised.LAYERS if denoise else 0)
    return int(film.crop_size()[0] * film.crop_size()[1]) * (19 + 4 * others) + 2**16


def refuse_another_scene(job: Job, begin: Record | None, about: Mapping[str, Any]) -> None:
    """Raises ValueError where a record was not made of this scene."""
    if begin is not None and begin.about["digest"] != about["digest"]:
        raise ValueError(
            f"{job.scene} is not what the state was made of: its text has changed, or a mesh or a picture that "
            "it names. Render it anew, or name the right one with --scene."
        )


def refuse_to_keep(integrator: mi.Integrator) -> None:
    """Raises ValueError where an image can't be gone on with."""
    if not rendering.keeps(integrator):
        raise ValueError(
            f"a state can be kept where prosim or prosim_adaptive takes the samples, in all but scalar variants; this "
            f"scene's integrator is {integrator.class_name()}. Say how it should be sampled, such as --noise 0.01 or "
            "--adaptive none --samples 8: it is put within prosim_adaptive then."
        )
    if getattr(integrator, "sampler", None) is not None:
        raise ValueError(
            "a state can't be kept where samples are drawn from a sampler of Mitsuba's, which does not say where it "
            "was; leave the sampler out of prosim_adaptive."
        )


def size_of_state(integrator: mi.Integrator, film: mi.Film, part: Part | None) -> int:
    """Bytes that a state takes, about: the twin is small, and what is another part's is compressed to nothing."""
    values = (5 + len(integrator.aov_names())) * (2 * film.rfilter().border_size() + 1) ** 2
    pixels = int(film.crop_size()[0] * film.crop_size()[1])
    if part is not None:
        return 4 * pixels * (values + 12) // part.of + 2**16
    return min(4 * pixels * values, KEPT) + 4 * pixels * 12 + 2**16


def warn(text: str) -> None:
    """Says something beside the progress bar."""
    tqdm.write(f"warning: {text}", file=sys.stderr)


@contextmanager
def progress_bar(integrator: mi.Integrator, variant: str) -> Iterator[rendering.Tell | None]:
    """Shows how far a render is, with the time left, if the integrator tells: by a bar if a person watches, else by a
    line now and then.

    Yields the function to be told the part done, 0 to 1, or None.
    """
    told = rendering.keeps(integrator)
    form = "{l_bar}{bar}| {elapsed}" if told else "{desc}"
    # The first step comes when the kernels are compiled and a part is rendered.
    doing = "compiling kernels" if told else "rendering"
    with tqdm(desc=doing, total=100, unit="%", bar_format=form, disable=None, file=sys.stderr, leave=False) as bar:
        lines, left = Lines(), Left()

        def tell(done: float, _: Any) -> None:
            if bar.disable:
                lines("rendering", done)
            bar.set_description_str("rendering", refresh=False)
            bar.bar_format = form + left(done)
            bar.update(max(100 * done - bar.n, 0))  # an estimate that has become worse is not shown

        yield tell if told else None
