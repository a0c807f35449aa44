"""Renders an image progressively, with or without a denoiser, and limits how often its pictures are drawn."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from time import perf_counter as clock
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
from ..transport.scattering import disperses
from .picture import Picture, colours, fill_unknown, layers_of_render

#: Minimum number of seconds between two pictures, and the maximum fraction of the time for drawing pictures.
DRAW_INTERVAL, DRAW_FRACTION = 0.1, 0.03


class Throttle:
    """Limits how often pictures are drawn, to a small fraction of the rendering time."""

    def __init__(self) -> None:
        self._next = 0.0

    @property
    def due(self) -> bool:
        """Whether enough time has passed since the latest picture, so that the next picture may be drawn."""
        return clock() >= self._next

    @contextmanager
    def drawing(self) -> Iterator[None]:
        """Measures the ``with`` block, which draws a picture, and sets the earliest time of the next one."""
        started = clock()
        yield
        now = clock()
        self._next = now + max(DRAW_INTERVAL, (now - started) / DRAW_FRACTION)


#: Maximum number of pixels of the coarse image, which is shown first.
COARSE = 1 << 14


class ProgressiveImage:
    """An image of ``scene`` that ``integrator`` renders progressively; each call of :meth:`step` renders one work item.

    Another integrator is nested in ``prosim_adaptive``. ``spp`` is the number of samples per pixel; 0 means that of the
    scene. ``denoise`` tells whether the final image is denoised.
    """

    def __init__(
        self, integrator: Any, scene: mi.Scene, sensor: mi.Sensor, spp: int, seed: int, denoise: bool = False
    ) -> None:
        if not rendering.is_progressive(integrator):
            integrator = create("prosim_adaptive", nested=integrator, adaptive="none")
            spp = spp or rendering.samples_taken(integrator, sensor, sensor.sampler().sample_count(), 1 + denoise)
        self.integrator, self.scene, self.sensor, self.spp, self.seed = integrator, scene, sensor, spp, seed
        self.denoise, self.done = denoise, False
        #: Computes the work items, see :class:`.Render`.
        self.executor = Executor()
        #: Whether samples were taken since the last call of :meth:`layers`; whether a pass over the image is complete.
        self.new = self.complete = False
        #: Progress, 0 to 1, which decreases if the render now expects more work.
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
        """Renders one work item; returns whether the caller should now draw the image.

        This is at the end of each pass, and earlier if the latest picture is old enough (:class:`.Throttle`), but only
        with new samples. If no work item is left, :attr:`done` becomes True.
        """
        step = next(self._steps, None)
        if step is None:
            self.done, self.progress, self.complete = True, 1.0, False
            return False
        self.progress, self.complete = step.done, step.complete
        self.new |= not step.complete  # the step that completes a pass takes no samples
        return self.new and (step.complete or self.throttle.due)

    def _run(self) -> Iterator[Step]:
        what, executor = (self.scene, self.sensor, self.integrator, self.seed, self.spp), self.executor
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
        """Samples, error and time so far. After denoising, the error is that of the denoised image, and the error of
        99 % of its pixels is unknown.
        """
        reached: Reached = self.render.reached
        if (result := self._result) is None:
            return reached
        return reached._replace(noise=result.noise, noise_99=np.nan, noise_at_most=result.at_most)

    def layers(self) -> Mapping[str, np.ndarray]:
        """Returns the layers of the image so far, and sets :attr:`new` to False.

        Before the first step, these are the layers of the coarse image, if there is one. ``raw`` and ``denoised``, of
        which ``final`` is a mixture, exist only after denoising. During the first pass, the maps ``error`` and
        ``samples`` are missing, and pixels without a sample are those of the coarse image, or black.
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
        """Renders the coarse image, which :meth:`layers` shows where the image has no sample yet.

        It has one sample per pixel; with dispersion, the first pass of n² samples, where n is the number of
        wavelengths.
        """
        each = dr.size_v(mi.Spectrum) if disperses(self.scene) else 1
        with coarse_film(self.sensor, COARSE):
            render = self.integrator.progressive(self.scene, self.sensor, self.seed, each**2)
            next(step for step in render if step.complete)
            self._coarse = without_maps(layers_of_render(render, self.integrator))


def without_maps(layers: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Returns the ``layers`` with colours."""
    return {name: values for name, values in layers.items() if values.ndim == 3}
