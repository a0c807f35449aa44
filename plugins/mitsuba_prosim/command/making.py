"""From a job to an EXR and a PNG image."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from time import perf_counter

import click
import mitsuba as mi
from tqdm.auto import tqdm

from ..scene_files import images, rendering, session, writing
from . import output as files
from . import reached
from .interrupts import interruptible
from .job import Job
from .log import log
from .options import InputError, wrong_input

SUFFIXES = (".exr", ".png")


def make(job: Job, stem: Path, threads: int | None, verbose: int) -> None:
    """Renders ``job`` and writes its image in both kinds, ``stem`` being their path without suffix; says what was done.

    ``threads``: None for all; ``verbose``: as for :func:`.log.log`. Raises InputError, where nothing has been written,
    and ClickException; ends the process where it was interrupted.
    """
    with log(verbose), session.threads(threads):
        with writing.scratch() as folder, wrong_input():
            file, loaded, chosen = job.open(folder)
        width, height = chosen.film().crop_size()
        integrator = loaded.integrator()
        refuse_waves((name for name in ("noise", "time") if getattr(integrator, name, 0)), job.variant)
        # Four channels of 32 bits and what else the integrator gives, and three bytes of the PNG.
        size = int(width * height) * (19 + 4 * len(integrator.aov_names())) + 2**16
        files.check(Path(job.scene), stem, SUFFIXES, size)

        start = perf_counter()
        with interruptible(integrator.cancel) as signals:
            try:
                with progress_bar(integrator, job.variant) as tell:
                    rendering.render(loaded, chosen, job.seed, job.spp, tell)
            except (RuntimeError, MemoryError) as error:
                raise click.ClickException(f"the scene could not be rendered: {session.message(error)}") from None
            seconds, interrupted = perf_counter() - start, bool(signals)
            facts = reached.facts(integrator, interrupted) | {
                "prosim.scene": job.scene,
                "prosim.version": version("mitsuba-prosim"),
                "prosim.variant": job.variant,
                "prosim.integrator": str(integrator),
                "prosim.seed": str(job.seed),
                "prosim.seconds": f"{seconds:.3f}",
            }
            written = files.save(stem, images.encode(chosen.film().bitmap(), facts, job.exposure))
    click.echo(
        f"{' and '.join(map(str, written))}: {width} x {height} pixels, {job.variant}, {seconds:.2f} s"
        + (f", {file.wrapped} within prosim_adaptive" if file.wrapped else "")
        + (", interrupted" if interrupted else "")
    )
    if said := reached.sentence(integrator, interrupted):
        click.echo(said)
    if interrupted:
        sys.exit(1)


def refuse_waves(names: Iterable[str], variant: str) -> None:
    """Raises InputError where something of these names was asked of a scalar variant, which knows no waves."""
    if variant.startswith("scalar_") and (names := list(names)):
        raise InputError(
            f"{', '.join(names)}: {variant} finishes one pixel after the other, each with the samples of the scene's "
            "sampler, and can't go by what the whole image has come to. Take a variant that can, such as -m "
            "llvm_ad_rgb (prosim doctor says which this machine can run), or say --spp instead."
        )


@contextmanager
def progress_bar(integrator: mi.Integrator, variant: str) -> Iterator[Callable[[float], None] | None]:
    """Shows how far a render is, with the time left, if the integrator tells and a person watches.

    Yields the function to be told the part done, 0 to 1, or None.
    """
    told = rendering.tells_progress(integrator)
    form = "{l_bar}{bar}| {elapsed}" if told else "{desc}"
    # The first step comes when the kernels are compiled and a part is rendered.
    doing = "compiling kernels" if told and not variant.startswith("scalar") else "rendering"
    with tqdm(desc=doing, total=100, unit="%", bar_format=form, disable=None, file=sys.stderr, leave=False) as bar:

        def tell(done: float) -> None:
            bar.set_description_str("rendering", refresh=False)
            if done > 0.01:  # before, nobody knows
                bar.bar_format = form + ", {remaining} left"
            bar.update(max(100 * done - bar.n, 0))  # an estimate that has become worse is not shown

        yield tell if told else None
