"""What a render has come to: the contents of its files, and what is to be said of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import mitsuba as mi

from ..engine.part import Part
from ..engine.record import Record
from ..saved.keeper import Keeper
from ..scene import black, images, rendering, report, scene_file
from . import denoised
from .job import Job


@dataclass(frozen=True)
class Developed:
    """An image that is ready to be written. ``contents``: of its files by their suffixes; ``black``: why nothing can be
    seen, if that is so; ``size``: in pixels; ``said``: what is to be told of it, line by line.
    """

    contents: Mapping[str, bytes]
    black: str | None
    size: tuple[int, int]
    seconds: float
    said: tuple[str | None, ...]

    def line(self, job: Job, file: scene_file.SceneFile, written: Sequence[Path], part: Part | None = None) -> str:
        """What it is, and where, in words."""
        width, height = self.size
        return (
            f"{' and '.join(map(str, written))}: "
            + (f"part {part.number} of {part.of}, " if part else "")
            + f"{width} x {height} pixels, {job.variant}, {self.seconds:.2f} s"
            + (f", {file.wrapped} within prosim_adaptive" if file.wrapped else "")
        )


def take(
    scene: mi.Scene,
    sensor: mi.Sensor,
    job: Job,
    denoise: bool,
    tell: Callable[[float], None] | None,
    stopped: Callable[[], bool],
    begin: Record | None = None,
    keeper: Keeper | None = None,
    part: Part | None = None,
) -> denoised.Picture:
    """Renders the image, and denoises it where that is asked for."""
    if denoise:
        return denoised.render(scene, sensor, job.seed, job.spp, tell, stopped)
    at_most = rendering.render(scene, sensor, job.seed, job.spp, tell, begin, keeper, part)
    return denoised.Picture(sensor.film().bitmap(), at_most=at_most)


def develop(
    job: Job,
    scene: mi.Scene,
    sensor: mi.Sensor,
    picture: denoised.Picture | None,
    seconds: float,
    end: str | None = None,
    further: Mapping[str, str] | None = None,
) -> Developed:
    """What the render of ``scene`` that has taken so many ``seconds`` has come to. ``picture``: None where it is not to
    be written; ``end``: what has interrupted it, if something has; ``further``: metadata.
    """
    integrator, exposure = scene.integrator(), job.exposure or 0.0
    contents: Mapping[str, bytes] = {}
    why = None
    if picture is not None:
        facts = metadata(job, integrator, end is not None, seconds) | dict(picture.facts) | dict(further or {})
        contents = images.encode(picture.bitmap, facts, exposure, picture.facts)
        shown = images.colours(picture.bitmap)
        why = None if shown is None else black.why(scene, sensor, shown * 2.0**exposure, exposure=exposure)
    width, height = sensor.film().crop_size()
    at_most = None if picture is None else picture.at_most
    sentence = report.sentence(integrator, end is not None, end or "", at_most)
    said = sentence, None if picture is None else picture.said
    return Developed(contents, why, (int(width), int(height)), seconds, said)


def metadata(job: Job, integrator: mi.Integrator, interrupted: bool, seconds: float) -> dict[str, str]:
    """What an EXR image says of how it was made."""
    return report.facts(integrator, interrupted) | {
        "prosim.scene": job.scene,
        "prosim.version": version("mitsuba-prosim"),
        "prosim.variant": job.variant,
        "prosim.integrator": str(integrator),
        "prosim.seed": str(job.seed),
        "prosim.seconds": f"{seconds:.3f}",
    }
