"""From a scene to two images by different samples, and the features of the view."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from ..engine.error_target import AIM, ENOUGH
from ..engine.work import Step
from ..registry import create
from ..sampling.hash import combine, hash32
from ..scene import rendering
from ..transport.features import NAMES
from .denoised import mixed
from .mixing import Denoised
from .oidn import Denoiser

if TYPE_CHECKING:
    from ..engine.checkpoint import Checkpoint
    from ..engine.render import Render

#: N: the features of a pixel have N² samples.
FEATURE_SAMPLES = 4

#: Minimum width and height of the part that is denoised to decide whether it is worth the time.
LEAST_SIDE = 64

#: The error of the final image is within this many times the limit with a probability of about 95 %.
TOLERANCE = 1.1

#: RMS error of the displayed image (white = 1), and the bounds of 99 and of 99.9 % of its pixels.
Noise = tuple[float, float, float]


@dataclass(frozen=True)
class Halves:
    """The two images with all of their channels, shape (height, width, channels). ``second`` is None where the
    rendering was stopped.
    """

    #: Of the channels, the film's own first.
    names: list[str]
    first: np.ndarray
    second: np.ndarray | None

    @property
    def colours(self) -> int:
        """Number of the channels that are colours."""
        return 1 if self.names[0] == "Y" else 3

    def denoised(self, denoiser: Denoiser | None, pixels: Any = ...) -> Denoised:
        """The result of :func:`.denoise` for both halves, or some of the ``pixels``."""
        assert self.second is not None
        first, second = (half[..., : self.colours][pixels] for half in (self.first, self.second))
        return mixed(first, second, denoiser)

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

    With an error target the raw image ends the render if it is within it, and is then the result. The denoiser is
    called if its image is likely to be within the target by fewer samples, whose number is worth the call: first with
    the smallest networks for a ninth of the pixels, then for all. These decisions depend on samples and rounded
    errors alone: times, or bits of the denoiser that differ with the number of threads, do not change the image.
    """

    #: The denoiser is called when the raw error is at most this many times the target.
    FAR = 3.0
    #: Maximum number of calls for all pixels before that of the final image.
    CALLS = 3
    #: Samples of a pixel that cost about as much as a call, and so many that the best networks are worth theirs.
    CALL, BEST = 64, 512

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
        #: The denoised image, and the networks and the number of samples that it has.
        self._latest: tuple[tuple[str, float], Denoised] | None = None
        self._denoiser = cache(self._load)
        #: The render of our own integrators; the images of others.
        self.render: Render | None = None
        self._images: list[np.ndarray] = []
        if rendering.is_progressive(integrator):
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

    def update_film(self) -> None:
        """Puts the first half so far into the film."""
        if self.render is not None:
            self.render.update_film()

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
        return Halves(names, images[0], images[1] if len(images) == 2 else None)

    @cached_property
    def features(self) -> tuple[np.ndarray, np.ndarray]:
        """Albedo and normal, see :func:`features`."""
        return features(self.scene, self.sensor, self.seed, getattr(self.integrator, "hide_emitters", False))

    @property
    def networks(self) -> str:
        """The denoiser's networks for the samples so far: "fast" or "best"; "none" where the raw image is within the
        error target.
        """
        if self.render is not None and self.render.second is not None:
            state, target = self.render.state, self.render.target
            samples, networks, *error = state.estimates[-1] if state.estimates else (0, "probe")
            if networks != "probe" and samples == self._samples and target.excess(error) <= ENOUGH:
                return str(networks)
            if target.excess(self.render.second.noise(state)) <= ENOUGH:
                return "none"
        return "fast" if self.fast else "best"

    def denoised(self) -> Denoised:
        """The denoised image of the samples so far, or the raw image if that is within the error target."""
        return self._denoised(self.networks)

    def _denoised(self, networks: str) -> Denoised:
        of = networks, 0.0 if self.render is None else self._samples
        if self._latest is None or self._latest[0] != of:
            self._latest = of, self.halves.denoised(self._denoiser(networks))
        return self._latest[1]

    @property
    def _samples(self) -> float:
        return float(self.counts().mean(dtype=np.float64))

    def _load(self, networks: str) -> Denoiser | None:
        return None if networks == "none" else Denoiser(*self.features, fast=networks == "fast")

    def estimate(self, render: Render) -> Noise:
        """The error of the final image; see :class:`~mitsuba_prosim.engine.render.Denoiser`. Where the denoiser is not
        called, it is the one that the last call promises, or that of the raw image.
        """
        assert render.second is not None
        state, target, samples = render.state, render.target, self._samples
        raw = render.second.noise(state)
        if target.seconds and not target.denoiser_seconds:
            started = time.perf_counter()
            self.denoised()
            render.target = target = dataclasses.replace(target, denoiser_seconds=1.2 * (time.perf_counter() - started))
        if not any(target.limits) or target.excess(raw) <= ENOUGH:
            return raw
        if target.excess(raw) > self.FAR:
            return scaled(raw, 1 / self.FAR)
        by_raw = samples * (target.excess(raw) / AIM) ** 2
        if not state.estimates and by_raw - samples >= 2 * self.CALL:
            self._record("probe", raw, self._probed())
        while state.estimates:
            last, networks, *error = state.estimates[-1]
            noise = scaled(error, (last / samples) ** 0.5)
            excess, called = target.excess(noise), last == samples and networks != "probe"
            if called and excess <= ENOUGH:
                return noise
            if by_raw - samples * (excess / AIM) ** 2 < self.CALL or len(state.estimates) > self.CALLS:
                break
            if called or (excess > 1 and networks != "probe"):
                return noise
            networks = "fast" if self.fast or by_raw < self.BEST else "best"
            result = self._denoised(networks)
            self._record(networks, raw, max(result.noise, result.at_most * ENOUGH / TOLERANCE) / result.raw_noise)
        return raw

    def _probed(self) -> float:
        """The final error over the raw one, by the smallest networks without features in the middle of the image."""
        halves = self.halves
        sides = [(n, max(n // 3, min(n, LEAST_SIDE))) for n in halves.first.shape[:2]]
        part = tuple(slice((n - side) // 2, (n + side) // 2) for n, side in sides)
        result = halves.denoised(Denoiser(fast=True), part)
        return result.at_most / max(result.raw_noise, 1e-30)

    def _record(self, networks: str, raw: Noise, ratio: float) -> None:
        """Keeps the errors, rounded: those of the raw image multiplied by ``ratio``."""
        assert self.render is not None
        noise = (float(f"{error:.3g}") for error in scaled(raw, ratio))
        self.render.state.estimates.append((self._samples, networks, *noise))

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


def scaled(noise: Sequence[float], factor: float) -> Noise:
    """The three errors, each multiplied by ``factor``."""
    return noise[0] * factor, noise[1] * factor, noise[2] * factor


def check(film: mi.Film) -> None:
    """Raises ValueError for a film that stores no colours."""
    if mi.has_flag(film.flags(), mi.FilmFlags.Special):
        raise ValueError(f"{film.class_name()}: the denoiser needs colours; use an hdrfilm")
