"""What a render has come to: the contents of its files, and what is to be said of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import mitsuba as mi

from ..denoising import halves
from ..engine.part import Part
from ..engine.render import Reached
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
    tell: rendering.Tell | None,
    stopped: Callable[[], bool],
    keeper: Keeper | None = None,
    **how: Any,
) -> denoised.Picture:
    """Renders the image, and denoises it where that is asked for. ``tell``: shows each step; ``stopped``: asked after
    each; ``how``: for :func:`.rendering.progressive`.
    """
    integrator: Any = scene.integrator()
    render: Any
    if denoise:
        render = halves.Rendering(scene, sensor, integrator, job.seed, job.spp)
    else:
        render = rendering.progressive(scene, sensor, job.seed, job.spp, **how)
    while not stopped() and (step := next(render, None)) is not None:
        if tell is not None:
            tell(step.done, render)
        if keeper is not None:
            keeper(render)
    render.close()
    if keeper is not None:
        keeper(render, True)
    if denoise:
        return denoised.denoise(render, sensor.film())
    unmeasured = rendering.keeps(integrator) and integrator.time and not (integrator.noise or integrator.noise_99)
    at_most = render.noise_at_most() if unmeasured else None
    return denoised.Picture(sensor.film().bitmap(), at_most=at_most, reached=render.reached)


def develop(
    job: Job,
    scene: mi.Scene,
    sensor: mi.Sensor,
    picture: denoised.Picture,
    seconds: float,
    end: str | None = None,
    further: Mapping[str, str] | None = None,
    written: bool = True,
) -> Developed:
    """What the render of ``scene`` that has taken so many ``seconds`` has come to. ``end``: what has interrupted it, if
    something has; ``further``: metadata; ``written``: whether the image is to be written.
    """
    integrator, exposure = scene.integrator(), job.exposure or 0.0
    contents: Mapping[str, bytes] = {}
    why = None
    if written:
        facts = metadata(job, integrator, picture.reached, end is not None, seconds)
        facts |= dict(picture.facts) | dict(further or {})
        contents = images.encode(picture.bitmap, facts, exposure, picture.facts)
        shown = images.colours(picture.bitmap)
        why = None if shown is None else black.why(scene, sensor, shown * 2.0**exposure, exposure=exposure)
    width, height = sensor.film().crop_size()
    at_most = picture.at_most if written else None
    sentence = report.sentence(integrator, picture.reached, end is not None, end or "", at_most)
    said = sentence, picture.said if written else None
    return Developed(contents, why, (int(width), int(height)), seconds, said)


def metadata(
    job: Job, integrator: mi.Integrator, reached: Reached | None, interrupted: bool, seconds: float
) -> dict[str, str]:
    """What an EXR image says of how it was made; ``reached``: how far the render came."""
    return report.facts(integrator, reached, interrupted) | {
        "prosim.scene": job.scene,
        "prosim.version": version("mitsuba-prosim"),
        "prosim.variant": job.variant,
        "prosim.integrator": str(integrator),
        "prosim.seed": str(job.seed),
        "prosim.seconds": f"{seconds:.3f}",
    }
