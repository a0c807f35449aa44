"""Progressive images: by the scene's integrator, denoised or not, and by Mitsuba's path tracer."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compare.methods import can_light, with_background_emitter
from ..denoising import halves
from ..engine.work import Executor, Step
from ..registry import create
from ..scene import rendering
from ..transport.scattering import disperses
from .picture import Picture, fill_unknown, layers_of_render
from .publisher import Throttle

#: Approximate number of seconds of a work item. The viewer reads new requests between work items.
SECONDS = 0.4


class ProgressiveImage:
    """A progressive image by ``integrator``, nested in ``prosim_adaptive`` if it is not progressive. ``spp``: samples
    per pixel, 0 for those of the scene; ``denoise``: whether the final image is denoised.
    """

    def __init__(
        self, integrator: Any, scene: mi.Scene, sensor: mi.Sensor, spp: int, seed: int, denoise: bool = False
    ) -> None:
        if not rendering.is_progressive(integrator):
            integrator = create("prosim_adaptive", nested=integrator, adaptive="none")
            spp = spp or sensor.sampler().sample_count()
        self.integrator, self.scene, self.sensor, self.spp, self.seed = integrator, scene, sensor, spp, seed
        self.denoise, self.done = denoise, False
        #: Whether there are samples that :meth:`layers` has not returned; whether a pass over the image is complete.
        self.new = self.complete = False
        #: Progress, 0 to 1, which never falls, although its estimate may.
        self.progress = 0.0
        #: The picture that was published last, and the rate of drawing.
        self.picture: Picture | None = None
        self.throttle = Throttle()
        self.render: Any = None
        self._steps = self._run()
        self._coarse: dict[str, np.ndarray] = {}
        self._denoised: dict[str, np.ndarray] = {}

    def step(self) -> bool:
        """Renders a work item; returns whether the image should be drawn."""
        step = next(self._steps, None)
        if step is None:
            self.done, self.progress, self.complete = True, 1.0, False
            return False
        self.progress, self.complete = max(self.progress, step.done), step.complete
        self.new |= not step.complete  # a complete pass takes no more samples
        return self.new and (step.complete or self.throttle.due)

    def _run(self) -> Iterator[Step]:
        begin = halves.denoised_progressive if self.denoise else rendering.progressive
        self.render = begin(self.scene, self.sensor, self.integrator, self.seed, self.spp, executor=Executor(SECONDS))
        for step in self.render:
            yield Step(0.96 * step.done, step.complete) if self.denoise else step
        if self.denoise:
            result = self.render.denoiser.denoised()
            self._denoised = {
                "final": result.final,
                "error": result.final_error,
                "samples": self.render.counts().astype(np.float32),
                "raw": result.raw,
                "denoised": result.denoised,
            }
            self.render.state.noise, self.new = (result.noise, np.nan, np.nan), True
            yield Step(1.0, True)

    def layers(self) -> Mapping[str, np.ndarray]:
        """The layers of a :class:`.Picture` of the image so far. A denoised image has ``raw`` and ``denoised`` too, of
        which it is a mixture; before it is the image without a denoiser.

        During the first pass it lacks the maps, and pixels without a sample are those of the coarse image, or black.
        """
        if self.render is None:
            return self._coarse
        latest, self.new = self._denoised or layers_of_render(self.render, self.integrator), False
        known = latest["samples"] > 0
        if known.all():
            return latest
        return {name: fill_unknown(known, latest[name], self._coarse.get(name)) for name in without_maps(latest)}

    def begin_coarse(self) -> None:
        """Begins with an image by one sample per pixel; call it while the film has few pixels. With dispersion a pixel
        gets a sample per wavelength of the spectrum.
        """
        each = dr.size_v(mi.Spectrum) if disperses(self.scene) else 1
        render = self.integrator.progressive(self.scene, self.sensor, self.seed, each**2)
        next(step for step in render if step.complete)
        self._coarse = without_maps(layers_of_render(render, self.integrator))


def without_maps(layers: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The ``layers`` that have colours."""
    return {name: values for name, values in layers.items() if values.ndim == 3}


def name(integrator: Any) -> str:
    """The name of an integrator, or of its nested one."""
    integrator = getattr(integrator, "nested", integrator)
    if hasattr(integrator, "parameter_names"):  # one of ours
        return str(integrator.name())
    return str(integrator.class_name()).removesuffix("Integrator").lower()


def not_compared(integrator: Any) -> str | None:
    """The reason why an image cannot be compared with that of ``path``, or None."""
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
        scene = with_background_emitter(scene, background)
    return ProgressiveImage(path, scene, own.sensor, own.spp, own.seed)
