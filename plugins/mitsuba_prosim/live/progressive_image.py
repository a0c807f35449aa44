"""Renders images progressively, by the scene's integrator (with or without a denoiser) or by Mitsuba's ``path``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..denoising.final_image import FinalImage, denoised_progressive
from ..engine.camera import coarse_film
from ..engine.render import Reached
from ..engine.work import Executor, Step
from ..registry import create
from ..scene import rendering
from ..scene.background import can_light, with_background_emitter
from ..scene.throttle import Throttle
from ..transport.scattering import disperses
from .picture import Picture, colours, fill_unknown, layers_of_render

#: Approximate duration of a work item in seconds. The viewer handles new requests between work items.
SECONDS = 0.4
#: Maximum number of pixels of the coarse image, which is shown first.
COARSE = 1 << 14


class ProgressiveImage:
    """An image of ``scene`` that ``integrator`` renders progressively; each call of :meth:`step` renders one work item.

    An integrator that cannot render progressively is nested in ``prosim_adaptive``, which can. ``spp`` is the number of
    samples per pixel; 0 means the number in the scene. ``denoise`` tells whether the final image is denoised.
    """

    def __init__(
        self, integrator: Any, scene: mi.Scene, sensor: mi.Sensor, spp: int, seed: int, denoise: bool = False
    ) -> None:
        """Prepares the render; :meth:`step` renders. ``seed`` is the seed of the samples."""
        if not rendering.is_progressive(integrator):
            integrator = create("prosim_adaptive", nested=integrator, adaptive="none")
            spp = spp or rendering.samples_taken(integrator, sensor, sensor.sampler().sample_count(), 1 + denoise)
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
        #: The denoiser and its render, None without denoising; and its result after the end of the render.
        self.final: FinalImage | None = None
        self._result: Any = None

    def step(self) -> bool:
        """Renders one work item; returns whether the caller should now draw a new picture of the image.

        A new picture should be drawn at the end of each pass over the image, and during a pass if the latest picture is
        old enough (see :class:`.Throttle`), but only if new samples were taken. If no work item is left, the result is
        False, and :attr:`done` becomes True.
        """
        step = next(self._steps, None)
        if step is None:
            self.done, self.progress, self.complete = True, 1.0, False
            return False
        self.progress, self.complete = max(self.progress, step.done), step.complete
        self.new |= not step.complete  # the step that completes a pass takes no samples
        return self.new and (step.complete or self.throttle.due)

    def _run(self) -> Iterator[Step]:
        """Renders the image and, if requested, denoises it at the end; yields the progress after each work item."""
        what, executor = (self.scene, self.sensor, self.integrator, self.seed, self.spp), Executor(SECONDS)
        final = self.final = denoised_progressive(*what, executor=executor) if self.denoise else None
        self.render = rendering.progressive(*what, executor=executor) if final is None else final.render
        for step in self.render:
            # Denoising counts as the last 4 % of the progress.
            yield Step(0.96 * step.done, step.complete) if self.denoise else step
        if final is not None:
            self._result, self.new = final.denoised(), True
            yield Step(1.0, True)

    @property
    def reached(self) -> Reached:
        """Samples, error and time so far; after denoising, without the errors of 99 % and 99.9 %."""
        reached: Reached = self.render.reached
        if (result := self._result) is None:
            return reached
        return reached._replace(noise=result.noise, noise_99=np.nan, noise_999=np.nan, noise_at_most=result.at_most)

    def layers(self) -> Mapping[str, np.ndarray]:
        """Returns the layers of the image so far, from which the caller makes a :class:`.Picture`; sets :attr:`new` to
        False. Before the first call of :meth:`step`, returns the layers of the coarse image, or an empty dictionary if
        there is no coarse image.

        The layers ``raw`` and ``denoised`` exist only after denoising; the layer ``final`` is then a mixture of ``raw``
        and ``denoised``. During the first pass over the image, the layers ``error`` and ``samples`` are missing, and
        pixels without a sample have the values of the coarse image, or are black if there is no coarse image.
        """
        if self.render is None:
            return self._coarse
        latest, self.new = layers_of_render(self.render, self.integrator), False
        if (result := self._result) is not None:
            shown = {name: colours(getattr(result, name)) for name in ("final", "raw", "denoised")}
            return {"final": shown["final"], "error": result.final_error, "samples": latest["samples"], **shown}
        known = latest["samples"] > 0
        if known.all():
            return latest
        return {name: fill_unknown(known, latest[name], self._coarse.get(name)) for name in without_maps(latest)}

    def begin_coarse(self) -> None:
        """Renders the coarse image (an image with few pixels), which :meth:`layers` shows where the image has no sample
        yet.

        Each pixel of the coarse image has one sample. In a scene with dispersion, the coarse image is the first pass of
        a render with n² samples per pixel, where n is the number of wavelengths of a spectrum.
        """
        each = dr.size_v(mi.Spectrum) if disperses(self.scene) else 1
        with coarse_film(self.sensor, COARSE):
            render = self.integrator.progressive(self.scene, self.sensor, self.seed, each**2)
            next(step for step in render if step.complete)
            self._coarse = without_maps(layers_of_render(render, self.integrator))


def without_maps(layers: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Returns the ``layers`` that contain colours, without the layers that are maps."""
    return {name: values for name, values in layers.items() if values.ndim == 3}


def integrator_name(integrator: Any) -> str:
    """Returns the plugin name, such as ``path``, of an integrator, or of the one nested in it."""
    integrator = getattr(integrator, "nested", integrator)
    if hasattr(integrator, "parameter_names"):  # a plugin of this project
        return str(integrator.name)
    return str(integrator.class_name()).removesuffix("Integrator").lower()


def not_compared(integrator: Any) -> str | None:
    """Returns why the live view cannot compare ``integrator`` with Mitsuba's ``path``; None if it can."""
    if integrator_name(integrator) == "path":
        return "the scene's integrator is the path tracer already"
    if not can_light(getattr(integrator, "background", None)):
        return "this background is not a bitmap, so path can't use it as a light"
    return None


def rendered_by_path(image: ProgressiveImage) -> ProgressiveImage:
    """Returns a progressive image of the same scene and with the same sampling parameters as ``image``, but rendered by
    Mitsuba's ``path`` and never denoised.

    If the scene's integrator has a background, the background is replaced by an emitter, because ``path`` has no
    parameter for a background. Raises ValueError if the background cannot become an emitter, see :func:`not_compared`.
    """
    sampling = asdict(image.integrator.sampling)
    path = create("prosim_adaptive", nested=create("path"), channels=image.integrator.channels, **sampling)
    scene, background = image.scene, getattr(image.integrator, "background", None)
    if background is not None:
        scene = with_background_emitter(scene, background)
    return ProgressiveImage(path, scene, image.sensor, image.spp, image.seed)
