"""Progressive images: by the scene's integrator, denoised or not, and by Mitsuba's path tracer."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from math import nan
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compare.scenes import can_light, lit
from ..denoising import halves
from ..engine.work import Local, Step
from ..registry import create
from ..sampling.hash import combine, hash32
from ..transport.scattering import disperses
from .picture import of_render, over

#: Seconds of a work item, about. Between two of them the viewer reads new requests.
SECONDS = 0.4


class ProgressiveImage:
    """A progressive image. ``spp``: samples per pixel, 0 for those of the integrator."""

    def __init__(self, integrator: Any, scene: mi.Scene, sensor: mi.Sensor, spp: int, seed: int) -> None:
        self.integrator, self.scene, self.sensor, self.spp, self.seed = integrator, scene, sensor, spp, seed
        self.done = False
        #: Whether there are samples that :meth:`layers` has not returned.
        self.new = False
        #: Progress, 0 to 1, which never falls, although its estimate may.
        self.part = 0.0
        self.render: Any = None
        self._steps = self._run()
        self._coarse: np.ndarray | None = None

    def step(self) -> bool:
        """Renders a work item; returns whether a pass over the image is complete."""
        step = next(self._steps, None)
        self.done = step is None
        if step is None:
            self.part = 1.0
            return False
        self.part = max(self.part, step.done)
        self.new |= not step.complete  # which takes no more samples
        return step.complete

    def _run(self) -> Iterator[Step]:
        self.render = self.begin(self.seed, self.spp)
        yield from self.render

    def begin(self, seed: int, spp: int = 0, **how: Any) -> Any:
        """A :class:`.Render` with short work items."""
        return self.integrator.progressive(self.scene, self.sensor, seed, spp, executor=Local(SECONDS), **how)

    def layers(self) -> Mapping[str, np.ndarray] | None:
        """The layers of a :class:`.Picture` of the image so far; None before the render has begun.

        During the first pass ``final`` only: pixels without a sample are those of :meth:`coarse`, or black.
        """
        now = self.taken()
        if now is None:
            return None
        self.new = False
        known = now["samples"] > 0
        return now if known.all() else {"final": over(known, now["final"], self._coarse)}

    def taken(self) -> dict[str, np.ndarray] | None:
        """The layers of the samples so far, see :func:`.of_render`; None before the render has begun."""
        return None if self.render is None else of_render(self.render)

    def reached(self) -> Any:
        """Its samples, noise and seconds, a :class:`.Reached`."""
        return self.render.reached

    def coarse(self) -> np.ndarray:
        """A first image by one sample per pixel; call it while the film has few pixels. With dispersion a pixel gets a
        sample per wavelength of the spectrum.
        """
        each = dr.size_v(mi.Spectrum) if disperses(self.scene) else 1
        render = self.integrator.progressive(self.scene, self.sensor, self.seed, each**2)
        next(step for step in render if step.complete)
        self._coarse = of_render(render)["final"]
        return self._coarse


class DenoisedImage(ProgressiveImage):
    """An image of two halves, see :func:`.halves.halves`, which is denoised at the end. Raises ValueError for a film
    without colours.
    """

    def __init__(self, integrator: Any, scene: mi.Scene, sensor: mi.Sensor, spp: int, seed: int) -> None:
        super().__init__(integrator, scene, sensor, spp, seed)
        halves.check(sensor.film())
        self._first: dict[str, np.ndarray] = {}
        self._final: dict[str, np.ndarray] = {}
        self._reached: Any = None
        self._noise = nan

    def taken(self) -> dict[str, np.ndarray] | None:
        """The layers of both halves; at the end also ``raw`` and ``denoised``, which the final image mixes."""
        if self._final:
            return self._final
        now = super().taken()
        return both(self._first, now) if now is not None and self._first else now

    def reached(self) -> Any:
        """Samples and seconds of both halves, and the noise, which is known when they are denoised."""
        now = self.render.reached
        return replace(halves.together(self._reached, now) if self._reached else now, noise=self._noise)

    def _run(self) -> Iterator[Step]:
        done: list[dict[str, np.ndarray]] = []
        for k, seed in enumerate((self.seed, combine(hash32(self.seed), 1))):
            self.render = self.begin(seed, **halves.half(self.integrator, self.sensor, self.spp))
            for step in self.render:
                yield Step(0.48 * (k + step.done), step.complete)
            done.append(of_render(self.render))
            self._first, self._reached = done[0], self._reached or self.render.reached
        hide = getattr(self.integrator, "hide_emitters", False)
        albedo, normal = halves.features(self.scene, self.sensor, self.seed, hide)
        result = halves.Halves(["R", "G", "B"], done[0]["final"], done[1]["final"], albedo, normal).denoised()
        self._final = both(*done) | {
            "final": result.final,
            "error": result.final_error,
            "raw": result.raw,
            "denoised": result.denoised,
        }
        self._noise, self.new = result.noise(result.final_error), True
        yield Step(1.0, True)


def both(first: Mapping[str, np.ndarray], second: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The layers of two independent images together, weighted by the samples of each pixel."""
    samples = first["samples"] + second["samples"]
    share = second["samples"] / samples
    return {
        "final": first["final"] + share[..., None] * (second["final"] - first["final"]),
        "error": np.hypot((1 - share) * first["error"], share * second["error"]),
        "samples": samples,
    }


def progressive(integrator: Any, sensor: mi.Sensor, spp: int) -> tuple[Any, int]:
    """``integrator``, wrapped by ``prosim_adaptive`` if it is not progressive, and its samples per pixel."""
    from ..engine.integrator import ProgressiveIntegrator

    if isinstance(integrator, ProgressiveIntegrator):
        return integrator, spp
    within = create("prosim_adaptive", nested=integrator, adaptive="none")
    return within, spp or sensor.sampler().sample_count()


def name(integrator: Any) -> str:
    """The name of an integrator, or of its nested one."""
    integrator = getattr(integrator, "nested", integrator)
    if hasattr(integrator, "parameter_names"):  # one of ours
        return str(integrator.name())
    return str(integrator.class_name()).removesuffix("Integrator").lower()


def not_compared(integrator: Any) -> str | None:
    """The reason why an image can't be compared with that of ``path``, or None."""
    if name(integrator) == "path":
        return "this is the path tracer already"
    if not can_light(getattr(integrator, "background", None)):
        return "path can't be lit by this background, which is no bitmap"
    return None


def by_path(own: ProgressiveImage) -> ProgressiveImage:
    """The image by Mitsuba's ``path``, with the sampling of ``own``, and its background as an emitter."""
    sampling = asdict(own.integrator.sampling)
    path = create("prosim_adaptive", nested=create("path"), channels=own.integrator.channels, **sampling)
    scene, background = own.scene, getattr(own.integrator, "background", None)
    if background is not None:
        scene = lit(scene, background)
    return ProgressiveImage(path, scene, own.sensor, own.spp, own.seed)
