"""Renders an image progressively, with or without a denoiser, draws its pictures for the web page and the notebook, and
limits how often it draws them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from time import perf_counter as clock
from typing import Any, TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compat import description
from ..denoising.final_image import FinalImage, denoised_progressive
from ..engine.camera import coarse_film
from ..engine.render import Reached, Render
from ..engine.work import Executor, Step
from ..registry import create
from ..scene import rendering
from ..scene.channels import mixed
from ..scene.images import compress, luminance, png
from ..transport.scattering import disperses

#: Names of layers, and the factors by which :meth:`.Picture.mixed` multiplies them.
Factors: TypeAlias = Mapping[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Picture:
    """An image that is ready to be shown; no two pictures of a viewer have the same ``number``.

    ``layers`` are 32-bit arrays by name: colours, shape (height, width, 3), or a map, shape (height, width). Those that
    the integrator's parameter ``layers`` requests have names such as ``lights.lamp1``.
    """

    number: int
    layers: Mapping[str, np.ndarray]

    def mixed(self, factors: Factors) -> Picture:
        """Returns the picture with some layers of the integrator multiplied by ``factors``; ``final`` is then the sum
        of these layers. Without factors, nothing changes.
        """
        if not factors:
            return self
        final, layers = mixed({name: values for name, values in self.layers.items() if "." in name}, factors)
        return replace(self, layers={**self.layers, "final": final, **layers})

    def packed(self, layer: str) -> tuple[bytes, dict[str, str]]:
        """Returns ``(content, headers)`` of the HTTP response with a layer.

        ``content`` has the values row by row, as 32-bit little-endian floating-point numbers, with 0 for NaN, and the
        greatest finite number for infinity. The header ``X-White`` is the 99th percentile of the map, or of the
        luminance of the colours; 1 if it is not finite. Raises KeyError if the picture has no such layer.
        """
        values = self.layers[layer]
        height, width = values.shape[:2]
        light = luminance(values) if values.ndim == 3 else values
        white = finite_or_none(np.percentile(np.maximum(light, 0), 99))
        facts = {"Picture": self.number, "Width": width, "Height": height, "White": 1.0 if white is None else white}
        return np.nan_to_num(values).astype("<f4").tobytes(), {f"X-{name}": str(fact) for name, fact in facts.items()}

    def at(self, x: int, y: int, size: tuple[int, int]) -> dict[str, list[float | None] | float | None]:
        """Returns the values of all layers at pixel (x, y) of the final image, whose (width, height) is ``size``: three
        numbers for colours, one for a map. Numbers that are not finite become None. A coarse picture has fewer pixels.
        """
        height, width = self.layers["final"].shape[:2]
        x, y = x * width // size[0], y * height // size[1]
        return {
            name: [finite_or_none(v) for v in values[y, x]] if values.ndim == 3 else finite_or_none(values[y, x])
            for name, values in self.layers.items()
        }


def layers_of_render(render: Render, integrator: mi.Integrator) -> dict[str, np.ndarray]:
    """Returns the layers ``final``, ``error`` and ``samples`` of a render, and those that the integrator's parameter
    ``layers`` requests, with names such as ``lights.lamp1``.
    """
    kind, image, estimator = getattr(integrator, "layers", "none"), np.array(render.image()), render.state.estimator
    first = image.shape[2] - len(estimator.channels.aov_names)  # the first AOV; before it are the colours and alpha
    final = colours(image[..., :first], estimator.sensor.film())
    layers = {"final": final, "error": render.error(), "samples": render.counts().astype(np.float32)}
    if kind != "none":
        for k, name in enumerate(estimator.transport.aov_names, first):
            if name.endswith(".R"):
                layers[f"{kind}.{name[:-2]}"] = colours(image[..., k : k + 3])
    return layers


def fill_unknown(known: np.ndarray, values: np.ndarray, previous: np.ndarray | None = None) -> np.ndarray:
    """Returns the ``values`` of a layer where the mask ``known``, shape (height, width), is True, else those of the
    layer ``previous``, which may have fewer pixels, or 0.
    """
    mask = known[..., None] if values.ndim == 3 else known
    if previous is None:
        return np.where(mask, values, np.float32(0))
    rows, columns = (np.arange(size) * old // size for size, old in zip(known.shape, previous.shape))
    return np.where(mask, values, previous[np.ix_(rows, columns)])


def colours(image: np.ndarray, film: mi.Film | None = None) -> np.ndarray:
    """Returns the colours of a developed image, shape (height, width, channels): its first three channels, or a grey
    image three times. XYZ colours, which the ``film`` has made, are converted to RGB.
    """
    image = image.astype(np.float32, copy=False)
    if image.shape[2] < 3:
        return np.repeat(image[..., :1], 3, axis=2)
    if film is not None and "pixel_format = xyz" in description(film):  # the film does not expose it
        bitmap = mi.Bitmap(np.ascontiguousarray(image[..., :3]), mi.Bitmap.PixelFormat.XYZ)
        return np.array(bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, srgb_gamma=False))
    return image[..., :3]


def as_png(values: np.ndarray) -> bytes:
    """Returns a PNG file of a layer: of colours with compressed highlights, or of a map as a grey image, in which the
    99th percentile is white.
    """
    if values.ndim == 2:
        white = finite_or_none(np.percentile(values, 99)) or 1.0
        return png(np.repeat(values[..., None] / np.float32(white), 3, axis=2))
    return png(compress(values))


def finite_or_none(value: float) -> float | None:
    """Returns ``value``, or None if it is infinite or NaN, because JSON has only finite numbers."""
    return float(value) if math.isfinite(value) else None


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
        self.executor = Executor(longest=1.0)  # a change of the scene or the view waits for the current work item
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
            film = self.render.state.estimator.sensor.film()
            shown = {name: colours(getattr(result, name), film) for name in ("final", "raw", "denoised")}
            return {"final": shown["final"], "error": result.final_error, "samples": latest["samples"], **shown}
        known = latest["samples"] > 0
        if known.all():
            return latest
        return {name: fill_unknown(known, latest[name], self._coarse.get(name)) for name in without_maps(latest)}

    def developed(self) -> mi.TensorXf:
        """Returns the developed film of the image so far, after denoising with the colours of the final image."""
        if self._result is None or self.final is None:
            return self.render.image()
        return mi.TensorXf(np.float32(np.dstack([self._result.final, *self.final.other_channels().values()])))

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
