"""Two images of a scene from different samples, and the features of its view."""

from __future__ import annotations

import dataclasses
from collections.abc import Generator
from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from ..engine.work import Step
from ..registry import create
from ..sampling.hash import combine, hash32
from ..scene import rendering
from ..transport.features import NAMES
from .denoised import Denoised, denoise

#: The features of a pixel have N² samples.
FEATURE_SAMPLES = 4

#: Goals of a render that are errors.
ERRORS = ("noise", "noise_99", "noise_999")


@dataclass(frozen=True)
class Halves:
    """Two images with all of their channels, shape (height, width, channels), and features, shape (height, width, 3).
    ``second`` and the features are None where the render was stopped.
    """

    #: Of the channels, the film's own first.
    names: list[str]
    first: np.ndarray
    second: np.ndarray | None
    albedo: np.ndarray | None = None
    normal: np.ndarray | None = None

    @property
    def colours(self) -> int:
        """The number of channels that are colours."""
        return 1 if self.names[0] == "Y" else 3

    def denoised(self, fast: bool = False) -> Denoised:
        """The result of :func:`.denoise`."""
        assert self.second is not None
        first, second = (half[..., : self.colours] for half in (self.first, self.second))
        return denoise(first, second, self.albedo, self.normal, fast)

    def others(self) -> dict[str, np.ndarray]:
        """Alpha and the integrator's own channels of the whole image, by name."""
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

    Each of two halves with different seeds takes half of the samples, of ``spp`` or of the integrator's own number. The
    sensor's film is used, and does not hold the result. ``fast``: see :func:`.denoise`.

    Raises ValueError for films that store no colours, and :class:`.oidn.MissingError` where the package mitsuba-oidn is
    not installed.
    """
    if isinstance(sensor, int):
        sensor = scene.sensors()[sensor]
    return halves(scene, sensor, integrator or scene.integrator(), seed, spp).denoised(fast)


def halves(scene: mi.Scene, sensor: mi.Sensor, integrator: mi.Integrator, seed: int = 0, spp: int = 0) -> Halves:
    """Renders the two halves, one after the other."""
    both = Rendering(scene, sensor, integrator, seed, spp)
    for _ in both:
        pass
    return both.halves


class Rendering:
    """A progressive render of two halves, with the interface of :class:`~mitsuba_prosim.engine.render.Render`.

    :meth:`close` leaves the first half, as far as it is done.
    """

    def __init__(self, scene: mi.Scene, sensor: mi.Sensor, integrator: mi.Integrator, seed: int, spp: int) -> None:
        check(sensor.film())
        self.scene, self.sensor, self.integrator, self.seed, self.spp = scene, sensor, integrator, seed, spp
        #: Samples, noise and time so far; None where the integrator does not report them.
        self.reached: Any = None
        self._images: list[np.ndarray] = []
        self._names: list[str] = []
        self._steps = self._run()
        self._render: Any = None
        self._features: tuple[Any, Any] = (None, None)

    def __iter__(self) -> Rendering:
        return self

    def __next__(self) -> Step:
        return next(self._steps)

    def put(self) -> None:
        """Puts the half in progress into the film."""
        self._render.put()

    def close(self) -> None:
        """Ends the render."""
        self._steps.close()
        if not self._images and self._render is not None:
            self._render.close()
            self._store()

    @property
    def halves(self) -> Halves:
        """The result."""
        second = None if self._features[0] is None else self._images[1]
        return Halves(self._names, self._images[0], second, *self._features)

    def _run(self) -> Generator[Step, None, None]:
        how = half(self.integrator, self.sensor, self.spp)
        # Another image may have the next seed.
        for k, seed in enumerate((self.seed, combine(hash32(self.seed), 1))):
            self._render = rendering.progressive(self.scene, self.sensor, seed, integrator=self.integrator, **how)
            for step in self._render:
                yield Step(0.48 * (k + step.done), False)
            is_finished = getattr(self._render, "finished", True)
            if is_finished or k == 0:
                self._store()
            if not is_finished:
                return
        hide_emitters = getattr(self.integrator, "hide_emitters", False)
        self._features = features(self.scene, self.sensor, self.seed, hide_emitters)
        yield Step(1.0, True)

    def _store(self) -> None:
        """Stores the image of the film."""
        self._names = [field.name for field in self.sensor.film().bitmap().struct_()]
        self._images.append(np.array(self.sensor.film().develop()))
        reached = self._render.reached
        self.reached = together(self.reached, reached) if self.reached else reached


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


def half(integrator: Any, sensor: mi.Sensor, spp: int) -> dict[str, Any]:
    """Arguments of :func:`.rendering.progressive` for half of the samples: of ``spp``, or 0 for the integrator's own.

    Our integrators get N-rook patterns of N²/2 samples, goals with twice the variance, and half of the time.
    """
    if not rendering.keeps(integrator):
        return {"spp": ((spp or sensor.sampler().sample_count()) + 1) // 2}
    if spp:
        return {"spp": size_of_half(spp**0.5) ** 2}
    sampling = integrator.sampling
    goals = {name: getattr(sampling, name) * 2**0.5 for name in ("threshold", *ERRORS)}
    samples, most = size_of_half(sampling.samples), (sampling.max_samples + 1) // 2
    goals |= {"samples": samples, "max_samples": most, "time": sampling.time / 2}
    return {"sampling": dataclasses.replace(sampling, **goals)}


def size_of_half(n: float) -> int:
    """N of an N-rook pattern of about ``n``² / 2 samples."""
    return max(1, round(n / 2**0.5))


def together(first: Any, second: Any) -> Any:
    """The :class:`~mitsuba_prosim.engine.render.Reached` of two halves."""
    sums = {name: getattr(first, name) + getattr(second, name) for name in ("samples", "least", "seconds")}
    errors = {name: float(np.hypot(getattr(first, name), getattr(second, name))) / 2 for name in ERRORS}
    return dataclasses.replace(first, **sums, **errors)
