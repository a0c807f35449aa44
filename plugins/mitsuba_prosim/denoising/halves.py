"""From a scene to two images by different samples, and the features of the view."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Generator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from ..engine.error_target import ENOUGH
from ..engine.work import Step
from ..registry import create
from ..sampling.hash import combine, hash32
from ..scene import rendering
from ..transport.features import NAMES
from .denoised import Denoised, mixed
from .mixing import displayed
from .oidn import Denoiser

if TYPE_CHECKING:
    from ..engine.accumulators import FilmState
    from ..engine.checkpoint import Checkpoint
    from ..engine.render import Render

#: N: the features of a pixel have N² samples.
FEATURE_SAMPLES = 4


@dataclass(frozen=True)
class Halves:
    """The two images with all of their channels, shape (height, width, channels), and the features, shape
    (height, width, 3). ``second`` is None where the rendering was stopped; then there are no features either.
    """

    #: Of the channels, the film's own first.
    names: list[str]
    first: np.ndarray
    second: np.ndarray | None
    albedo: np.ndarray | None = None
    normal: np.ndarray | None = None

    @property
    def colours(self) -> int:
        """Number of the channels that are colours."""
        return 1 if self.names[0] == "Y" else 3

    def denoised(self, fast: bool = False, denoiser: Denoiser | None = None) -> Denoised:
        """The result of :func:`.denoise` for both halves; ``denoiser``: one with these features."""
        assert self.second is not None
        first, second = (half[..., : self.colours] for half in (self.first, self.second))
        return mixed(first, second, denoiser or Denoiser(self.albedo, self.normal, fast))

    @property
    def uncertainty(self) -> float:
        """Relative standard error of the estimated squared error: large if a few pixels have most of it."""
        assert self.second is not None
        first, second = (displayed(half[..., : self.colours]) for half in (self.first, self.second))
        squares = np.square(np.sqrt(first, dtype=np.float64) - np.sqrt(second, dtype=np.float64))
        return float(np.sqrt(np.sum(squares**2)) / max(float(np.sum(squares)), 1e-300))

    def others(self) -> dict[str, np.ndarray]:
        """Alpha and the integrator's own channels, of both halves together, by name."""
        assert self.second is not None
        result = {}
        for k, name in enumerate(self.names[self.colours :], self.colours):
            a, b = self.first[..., k], self.second[..., k]
            result[name] = a + b if name == "samples" else np.hypot(a, b) / 2 if name == "error" else (a + b) / 2
        return result


def render(
    scene: mi.Scene,
    sensor: int | mi.Sensor = 0,
    integrator: mi.Integrator | None = None,
    seed: int = 0,
    spp: int = 0,
    fast: bool = False,
) -> Denoised:
    """Renders ``scene`` by its integrator, or another, and denoises the image.

    The samples, those of the integrator or ``spp``, are divided into two halves of other seeds; its ``noise`` is the
    limit of the final image's error. The sensor's film is used for that, and does not hold the result. ``fast``: see
    :func:`.denoise`.

    Raises ValueError for films that store no colours, and :class:`.oidn.MissingError` if the package mitsuba-oidn is
    not installed.
    """
    if isinstance(sensor, int):
        sensor = scene.sensors()[sensor]
    return DenoisedRender(scene, sensor, integrator or scene.integrator(), seed, spp, fast).run().denoised()


class DenoisedRender:
    """Two halves of the samples in progress, which are denoised at the end, and earlier to estimate the error of the
    final image: the interface of :class:`~mitsuba_prosim.engine.render.Render`. ``how``: for ``progressive``.
    """

    #: The denoiser estimates the error when the raw one is at most this many times the limit: at most so often with
    #: smaller networks, and so often with those of the final image.
    FAR, FAST, BEST = 5.0, 3, 2
    #: The error with the smaller networks over that with the final image's own, about.
    SMALLER_NETWORKS = 1.1
    #: The power of the number of samples with which the final error falls: first assumption, and its bounds.
    SLOPE, LEAST, MOST = 0.4, 0.25, 0.6

    def __init__(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor,
        integrator: Any,
        seed: int = 0,
        spp: int = 0,
        fast: bool = False,
        **how: Any,
    ) -> None:
        check(sensor.film())
        self.scene, self.sensor, self.integrator, self.seed, self.fast = scene, sensor, integrator, seed, fast
        self.features: tuple[np.ndarray, np.ndarray] | None = None
        #: The denoised image, and the number of samples that it has; the denoisers by their speed.
        self._latest: tuple[float, Denoised] | None = None
        self._denoisers: dict[bool, Denoiser] = {}
        #: The render of our own integrators; the images of others.
        self.render: Render | None = None
        self._images: list[np.ndarray] = []
        if rendering.keeps(integrator):
            self.render = integrator.progressive(scene, sensor, seed, spp, denoiser=self, **how)
        self._blocks = self._blocking(((spp or sensor.sampler().sample_count()) + 1) // 2)

    def __iter__(self) -> Any:
        return iter(self.render or self._blocks)

    def __next__(self) -> Step:
        return next(self.render or self._blocks)

    def run(self) -> DenoisedRender:
        """Takes all steps, and returns itself."""
        for _ in self:
            pass
        return self

    def put(self) -> None:
        """Puts the first half so far into the film."""
        if self.render is not None:
            self.render.put()

    def close(self) -> None:
        """Ends it with the samples so far."""
        if self.render is not None:
            self.render.close()
        self._blocks.close()

    def checkpoint(self) -> Checkpoint:
        """The checkpoint by which another process continues the render."""
        assert self.render is not None
        return self.render.checkpoint()

    def counts(self) -> np.ndarray:
        """Number of samples of each pixel, shape (height, width)."""
        assert self.render is not None
        return self.render.counts()

    @property
    def finished(self) -> bool:
        """Whether the image has all requested samples."""
        return len(self._images) == 2 if self.render is None else self.render.finished

    @property
    def reached(self) -> Any:
        """Samples, error and time so far, as :class:`~mitsuba_prosim.engine.render.Reached`; None for integrators of
        Mitsuba.
        """
        return None if self.render is None else self.render.reached

    @property
    def halves(self) -> Halves:
        """The two halves; the first alone if the second lacks pixels."""
        film, images = self.sensor.film(), self._images
        if self.render is not None:
            assert self.render.second is not None
            complete = np.all(np.array(self.render.second.accumulators.count) > 0)
            images = [np.array(self.render.image(k)) for k in ((True, False) if complete else (False,))][::-1]
        names = [field.name for field in film.bitmap().struct_()]
        if len(images) < 2:
            return Halves(names, images[0], None)
        if self.features is None:
            hide_emitters = getattr(self.integrator, "hide_emitters", False)
            self.features = features(self.scene, self.sensor, self.seed, hide_emitters)
        (first, second), (albedo, normal) = images, self.features
        return Halves(names, first, second, albedo, normal)

    def denoised(self) -> Denoised:
        """The denoised image of the samples so far."""
        samples = 0.0 if self.render is None else float(self.render.counts().mean(dtype=np.float64))
        if self._latest is None or self._latest[0] != samples:
            self._latest = samples, self._denoise(self.fast)
        return self._latest[1]

    def _denoise(self, fast: bool) -> Denoised:
        both = self.halves
        if fast not in self._denoisers:
            self._denoisers[fast] = Denoiser(both.albedo, both.normal, fast)
        return both.denoised(denoiser=self._denoisers[fast])

    def estimate(self, render: Render) -> tuple[float, float, float]:
        """The error of the final image; see :class:`~mitsuba_prosim.engine.render.Denoiser`. Far from the limits it is
        not denoised; then the error is one with which the raw one comes near.

        The decisions go by rounded numbers, as the bits of the denoiser may depend on the number of threads.
        """
        state, target, samples = render.state, render.target, float(render.counts().mean(dtype=np.float64))
        assert render.second is not None
        raw, timed = render.second.noise(state), target.seconds and not target.reserved
        if target.excess(raw) > self.FAR and not timed:
            return raw[0] / self.FAR, raw[1] / self.FAR, raw[2] / self.FAR
        if not any(target.limits) and not timed:
            return raw
        last = state.estimates[-1] if state.estimates else None
        if last is not None and last[0] == samples:  # before an interruption
            return last[2], last[3], last[4]
        best = sum(not fast for _, fast, *_ in state.estimates)
        noise: tuple[float, ...] = raw
        if not self.fast and len(state.estimates) - best < self.FAST and not timed:
            noise = self._record(state, samples, True, self._denoise(True))
        elif last is not None:
            noise = tuple(error * (last[0] / samples) ** state.slope for error in last[2:])
        if timed or (best < self.BEST and (self.fast or target.excess((noise[0], noise[1], noise[2])) <= ENOUGH)):
            started = time.perf_counter()
            noise = self._record(state, samples, False, self.denoised())
            if target.seconds:
                render.target = dataclasses.replace(target, reserved=1.2 * (time.perf_counter() - started))
        return noise[0], noise[1], noise[2]

    def _record(self, state: FilmState, samples: float, fast: bool, image: Denoised) -> tuple[float, ...]:
        """Keeps the estimated error, rounded, and how fast it falls."""
        noise = tuple(float(f"{error / (self.SMALLER_NETWORKS if fast else 1):.3g}") for error in image.errors())
        if state.estimates and samples > state.estimates[-1][0]:
            before, _, error, *_ = state.estimates[-1]
            state.slope = min(max(np.log(error / noise[0]) / np.log(samples / before), self.LEAST), self.MOST)
        elif not state.estimates:
            state.slope = self.SLOPE
        state.estimates.append((samples, fast, *noise))
        return noise

    def _blocking(self, spp: int) -> Generator[Step, None, None]:
        """Renders the halves by an integrator that reports no progress."""
        # No neighbouring seed, which may be that of another image.
        for seed in (self.seed, combine(hash32(self.seed), 1)):
            yield from rendering.progressive(self.scene, self.sensor, seed, spp, self.integrator)
            self._images.append(np.array(self.sensor.film().develop()))


def features(
    scene: mi.Scene, sensor: mi.Sensor, seed: int = 0, hide_emitters: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """``(albedo, normal)`` of the view by :ref:`integrator-prosim_features`, with the film's filter.

    The samples are not those of an image with that ``seed``, as the two halves must stay independent.
    """
    nested = create("prosim_features", hide_emitters=hide_emitters)
    integrator = create("prosim_adaptive", nested=nested, samples=FEATURE_SAMPLES, adaptive="none")
    integrator.render(scene, sensor, seed=combine(hash32(seed), 2), spp=FEATURE_SAMPLES**2)
    values = np.array(sensor.film().develop())[..., -len(NAMES) :]
    return values[..., :3], values[..., 3:]


def check(film: mi.Film) -> None:
    """Raises ValueError for a film that stores no colours."""
    if mi.has_flag(film.flags(), mi.FilmFlags.Special):
        raise ValueError(f"{film.class_name()}: the denoiser needs colours; use an hdrfilm")
