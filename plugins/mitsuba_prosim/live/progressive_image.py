"""Progressive images: rendered by the scene's integrator, denoised or not, or by Mitsuba's path tracer."""

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

#: Approximate duration of a work item in seconds. The viewer handles new requests between work items.
SECONDS = 0.4


class ProgressiveImage:
    """The image of ``scene`` by ``integrator``, which is rendered work item by work item.

    An integrator that is not progressive is nested in ``prosim_adaptive``. ``spp`` is the number of samples
    per pixel; 0 means the scene's number. ``denoise`` tells whether the final image is denoised.
    """

    def __init__(
        self, integrator: Any, scene: mi.Scene, sensor: mi.Sensor, spp: int, seed: int, denoise: bool = False
    ) -> None:
        """Prepares the render; :meth:`step` renders. ``seed`` is the seed of the samples."""
        if not rendering.is_progressive(integrator):
            integrator = create("prosim_adaptive", nested=integrator, adaptive="none")
            spp = spp or sensor.sampler().sample_count()
        self.integrator, self.scene, self.sensor, self.spp, self.seed = integrator, scene, sensor, spp, seed
        self.denoise, self.done = denoise, False
        #: Whether samples were taken since the last call of :meth:`layers`; whether a pass over the image is complete.
        self.new = self.complete = False
        #: Progress, 0 to 1, which never decreases, even if the renderer's estimate decreases.
        self.progress = 0.0
        #: The picture that was published last, and the limit for the rate of drawing.
        self.picture: Picture | None = None
        self.throttle = Throttle()
        self.render: Any = None
        self._steps = self._run()
        self._coarse: dict[str, np.ndarray] = {}
        self._denoised: dict[str, np.ndarray] = {}

    def step(self) -> bool:
        """Renders a work item; returns whether a picture of the image should be drawn now.

        A picture is drawn at the end of each pass over the image, and within a pass if the last picture is old enough.
        """
        step = next(self._steps, None)
        if step is None:
            self.done, self.progress, self.complete = True, 1.0, False
            return False
        self.progress, self.complete = max(self.progress, step.done), step.complete
        self.new |= not step.complete  # the step that completes a pass takes no samples
        return self.new and (step.complete or self.throttle.due)

    def _run(self) -> Iterator[Step]:
        """Renders and, if requested, denoises the image; yields the progress after each work item."""
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
            self.render.state.noise, self.new = (result.noise, np.nan, np.nan, result.at_most), True
            yield Step(1.0, True)

    def layers(self) -> Mapping[str, np.ndarray]:
        """Returns the layers of the current image, for a :class:`.Picture`, and sets :attr:`new` to False.

        The layers ``raw`` and ``denoised`` exist only after denoising; the final image is a mixture of them. During the
        first pass over the image the maps are missing, and pixels without a sample are taken from the coarse image, or
        are black.
        """
        if self.render is None:
            return self._coarse
        latest, self.new = self._denoised or layers_of_render(self.render, self.integrator), False
        known = latest["samples"] > 0
        if known.all():
            return latest
        return {name: fill_unknown(known, latest[name], self._coarse.get(name)) for name in without_maps(latest)}

    def begin_coarse(self) -> None:
        """Renders the coarse image, which :meth:`layers` uses for pixels without a sample.

        The film must have few pixels during this call. A pixel has one sample, or, in a scene with dispersion, one
        sample for each wavelength of a spectrum.
        """
        each = dr.size_v(mi.Spectrum) if disperses(self.scene) else 1
        render = self.integrator.progressive(self.scene, self.sensor, self.seed, each**2)
        next(step for step in render if step.complete)
        self._coarse = without_maps(layers_of_render(render, self.integrator))


def without_maps(layers: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Returns the ``layers`` that contain colours."""
    return {name: values for name, values in layers.items() if values.ndim == 3}


def integrator_name(integrator: Any) -> str:
    """Returns the name of an integrator's plugin, such as ``path``; of the nested integrator, if there is one."""
    integrator = getattr(integrator, "nested", integrator)
    if hasattr(integrator, "parameter_names"):  # a plugin of this project
        return str(integrator.name)
    return str(integrator.class_name()).removesuffix("Integrator").lower()


def not_compared(integrator: Any) -> str | None:
    """Returns the reason why this integrator cannot be compared with Mitsuba's ``path``; None if it can."""
    if integrator_name(integrator) == "path":
        return "the scene's integrator is the path tracer already"
    if not can_light(getattr(integrator, "background", None)):
        return "this background is not a bitmap, so path can't use it as a light"
    return None


def rendered_by_path(image: ProgressiveImage) -> ProgressiveImage:
    """Returns a progressive image of the scene of ``image``, with the same sampling, rendered by Mitsuba's ``path``.

    The background of the scene's integrator becomes an emitter.
    """
    sampling = asdict(image.integrator.sampling)
    path = create("prosim_adaptive", nested=create("path"), channels=image.integrator.channels, **sampling)
    scene, background = image.scene, getattr(image.integrator, "background", None)
    if background is not None:
        scene = with_background_emitter(scene, background)
    return ProgressiveImage(path, scene, image.sensor, image.spp, image.seed)
