"""``prosim render --frames``: renders an animation, in which $frame changes from frame to frame."""

import hashlib
import json
import sys
import warnings
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import click
import OpenEXR
import prosim_scene
from prosim_scene import FRAME

from ..engine import environment
from ..scene import images, scene_file
from .job import Job
from .option_types import input_errors
from .render_task import RenderTask, Resources, render_image
from .terminal import Progress

#: The key, in the metadata of a frame's EXR file, of the frame's :func:`digest`.
DIGEST = "prosim.digest"


class Animation:
    """Renders the frames of an animation one after another, with the options of one job.

    A frame is not rendered again if its files exist with the current :func:`digest`.
    """

    def __init__(self, job: Job, stem: Path) -> None:
        """Raises UsageError if the option -D defines $frame."""
        if FRAME in job.definitions:
            raise click.UsageError(f"-D {FRAME}=... and --frames both define ${FRAME}; give one.")
        self.job, self.stem, self.frames = job, stem, job.frames or range(0)
        self.cache = prosim_scene.TranslationCache()
        self.rendered = self.skipped = self.black = 0

    def render(self) -> None:
        """Renders the missing frames, and prints a report. If the animation is interrupted, the process exits with code
        1.

        Raises ClickException, such as InputError, if a frame cannot be rendered; the finished frames stay on the disk.
        """
        with Resources(self.job) as resources, Progress("film", len(self.frames)) as bar:
            resources.handle_signals()
            for number in self.frames:
                if resources.interruption:
                    break
                try:
                    self.render_frame(number, bar, resources)
                except click.ClickException as error:
                    raise type(error)(f"frame {number}: {error.message}") from None
            interruption = resources.interruption
        end = f"; {interruption}. The same command renders the missing frames." if interruption else ""
        click.echo(self.report() + end)
        if interruption:
            sys.exit(1)

    def render_frame(self, number: int, bar: Progress, resources: Resources) -> None:
        """Renders the frame ``number``, if it is missing, from its checkpoint, if there is one.

        The value of $frame and the seed depend on the ``number``. The first black frame causes a warning.
        Raises ClickException if the frame cannot be rendered.
        """
        bar.begin(number, self.rendered, len(self.frames) - self.skipped)
        definitions = {**self.job.definitions, FRAME: str(number)}
        job = replace(self.job, definitions=definitions, seed=(self.job.seed + number) % 2**32)
        with input_errors():
            file = job.read_scene(resources.folder, cache=self.cache)
            facts = {DIGEST: digest(job, file), "prosim.frame": str(number)}
            task = RenderTask(job, file, self.path(number), facts=facts)
            if is_rendered(task):
                self.skipped += 1
                return
            task.check()
            if job.checkpoint:
                task.begin = task.unfinished()
        outcome = render_image(task, bar, resources)
        if outcome.interruption:
            return
        self.rendered += 1
        if outcome.why_black and self.black == 0:
            warnings.warn(f"frame {number}: {outcome.why_black}", stacklevel=2)
        self.black += bool(outcome.why_black)
        with suppress(OSError):  # the terminal was closed
            bar.write(outcome.report, file=sys.stderr)

    def path(self, number: int) -> Path:
        """Returns the path of the image of the frame ``number`` without suffix, such as ``name.0007``."""
        return self.stem.with_name(f"{self.stem.name}.{number:04d}")

    def report(self) -> str:
        """Returns the names of the image files, and the numbers of rendered, black and earlier rendered frames, in
        words.
        """
        first, last = self.path(self.frames[0]), self.path(self.frames[-1])
        names = f"{first}.exr" if len(self.frames) == 1 else f"{first}.exr to {last.name}.exr"
        skipped = f", {self.skipped} had been rendered before" if self.skipped else ""
        black = f", {self.black} of them black" if self.black else ""
        return f"{names}, and .png: {self.rendered} of {len(self.frames)} frames rendered{black}{skipped}"


def digest(job: Job, file: scene_file.SceneFile) -> str:
    """Returns the SHA-256 hash of all that determines the image of a frame, up to rounding errors: the content of the
    scene, options, the variant and the software versions, but neither the scene's folder nor the processor.
    """
    environment_facts = environment.this_environment()
    versions = [environment_facts[name] for name in environment.MUST_AGREE]
    # The digest of the file already contains the definitions.
    content = job.image_fields() | {"scene": "", "definitions": {}, "digest": file.digest(), "environment": versions}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def is_rendered(task: RenderTask) -> bool:
    """Tells whether the image files of the frame exist, are not damaged, and have the current digest."""
    exr, png = Path(f"{task.stem}.exr"), Path(f"{task.stem}.png")
    if not exr.is_file() or not images.is_whole(exr.read_bytes()):
        return False
    header = OpenEXR.File(str(exr), header_only=True).parts[0].header
    stored = header.get(images.PNG_CHECKSUM)  # a film without colours has no PNG
    if stored and not (png.is_file() and images.checksum(png.read_bytes()) == stored):
        return False
    return bool(header.get(DIGEST) == task.facts[DIGEST])
