"""Progressive images: by the scene's integrator, denoised or not, and by Mitsuba's path tracer."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compare.scenes import can_light, lit
from ..denoising import halves
from ..engine.work import Local, Step
from ..registry import create
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
        self._coarse: dict[str, np.ndarray] = {}

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
        """The layers of a :class:`.Picture` of the image so far; None before the render has started.

        During the first pass without the maps: pixels without a sample are those of :meth:`coarse`, or black.
        """
        now = self.taken()
        if now is None:
            return None
        self.new = False
        known = now["samples"] > 0
        return now if known.all() else {name: over(known, now[name], self._coarse.get(name)) for name in coloured(now)}

    def taken(self) -> dict[str, np.ndarray] | None:
        """The layers of the samples so far, see :func:`.of_render`; None before the render has started."""
        return None if self.render is None else of_render(self.render, self._kind)

    def reached(self) -> Any:
        """Samples, noise and seconds so far, a :class:`.Reached`."""
        return self.render.reached

    @property
    def _kind(self) -> str:
        return getattr(self.integrator, "layers", "none")

    def coarse(self) -> dict[str, np.ndarray]:
        """The layers of a first image, without the maps, by one sample per pixel; call it while the film has few
        pixels. With dispersion a pixel gets a sample per wavelength of the spectrum.
        """
        each = dr.size_v(mi.Spectrum) if disperses(self.scene) else 1
        render = self.integrator.progressive(self.scene, self.sensor, self.seed, each**2)
        next(step for step in render if step.complete)
        self._coarse = coloured(of_render(render, self._kind))
        return self._coarse


def coloured(layers: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The ``layers`` without the maps."""
    return {name: values for name, values in layers.items() if values.ndim == 3}


class DenoisedImage(ProgressiveImage):
    """An image of two halves, which is denoised at the end. Raises ValueError for a film without colours."""

    def __init__(self, integrator: Any, scene: mi.Scene, sensor: mi.Sensor, spp: int, seed: int) -> None:
        super().__init__(integrator, scene, sensor, spp, seed)
        halves.check(sensor.film())
        self._final: dict[str, np.ndarray] = {}

    def taken(self) -> dict[str, np.ndarray] | None:
        """The first half; in the end the final image, and ``raw`` and ``denoised``, of which it is mixed."""
        return self._final or super().taken()

    def _run(self) -> Iterator[Step]:
        steps = halves.DenoisedRender(
            self.scene, self.sensor, self.integrator, self.seed, self.spp, executor=Local(SECONDS)
        )
        self.render = steps.render
        for step in steps:
            yield Step(0.96 * step.done, step.complete)
        result = steps.denoised()
        self._final = {
            "final": result.final,
            "error": result.final_error,
            "samples": steps.counts().astype(np.float32),
            "raw": result.raw,
            "denoised": result.denoised,
        }
        self.render.state.noise, self.new = (result.noise, np.nan, np.nan), True
        yield Step(1.0, True)


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
