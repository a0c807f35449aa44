"""From a scene to two images by different samples, and the features of the view."""

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
        """How many channels are colours."""
        return 1 if self.names[0] == "Y" else 3

    def denoised(self, fast: bool = False) -> Denoised:
        """What :func:`.denoise` makes of them."""
        assert self.second is not None
        first, second = (half[..., : self.colours] for half in (self.first, self.second))
        return denoise(first, second, self.albedo, self.normal, fast)

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

    The samples, those that the integrator says or ``spp``, are parted in two halves of other seeds. The sensor's film
    is used for that, and does not hold the result. ``fast``: see :func:`.denoise`.

    Raises ValueError for films that store no colours, and :class:`.oidn.MissingError` where the package mitsuba-oidn is
    not installed.
    """
    if isinstance(sensor, int):
        sensor = scene.sensors()[sensor]
    return halves(scene, sensor, integrator or scene.integrator(), seed, spp).denoised(fast)


def halves(scene: mi.Scene, sensor: mi.Sensor, integrator: mi.Integrator, seed: int = 0, spp: int = 0) -> Halves:
    """Renders each half by itself."""
    both = Rendering(scene, sensor, integrator, seed, spp)
    for _ in both:
        pass
    return both.halves


class Rendering:
    """Two halves in progress, as :class:`~mitsuba_prosim.engine.render.Render` is one image. :meth:`close` leaves the
    first half, or what there is of it.
    """

    def __init__(self, scene: mi.Scene, sensor: mi.Sensor, integrator: mi.Integrator, seed: int, spp: int) -> None:
        check(sensor.film())
        self.scene, self.sensor, self.integrator, self.seed, self.spp = scene, sensor, integrator, seed, spp
        #: How far they came; None where the integrator does not say.
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
        """Makes the half so far what the film holds."""
        self._render.put()

    def close(self) -> None:
        """Ends it with what there is."""
        self._steps.close()
        if not self._images and self._render is not None:
            self._render.close()
            self._keep()

    @property
    def halves(self) -> Halves:
        """What was rendered."""
        whole = self._features[0] is not None
        return Halves(self._names, self._images[0], self._images[1] if whole else None, *self._features)

    def _run(self) -> Generator[Step, None, None]:
        how = half(self.integrator, self.sensor, self.spp)
        # No neighbouring seed, which may be that of another image.
        for k, seed in enumerate((self.seed, combine(hash32(self.seed), 1))):
            self._render = rendering.progressive(self.scene, self.sensor, seed, integrator=self.integrator, **how)
            for step in self._render:
                yield Step(0.48 * (k + step.done), False)
            if not getattr(self._render, "finished", True) and k:
                return
            self._keep()
            if not getattr(self._render, "finished", True):
                return
        hide_emitters = getattr(self.integrator, "hide_emitters", False)
        self._features = features(self.scene, self.sensor, self.seed, hide_emitters)
        yield Step(1.0, True)

    def _keep(self) -> None:
        self._names = [field.name for field in self.sensor.film().bitmap().struct_()]
        self._images.append(np.array(self.sensor.film().develop()))
        reached = self._render.reached
        self.reached = together(self.reached, reached) if self.reached else reached


def features(
    scene: mi.Scene, sensor: mi.Sensor, seed: int = 0, hide_emitters: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """``(albedo, normal)`` of the view, as :ref:`integrator-prosim_features` says, filtered as the film filters.

    Not by the samples of an image with that ``seed``: they would tell the other half what it must not know.
    """
    nested = create("prosim_features", hide_emitters=hide_emitters)
    integrator = create("prosim_adaptive", nested=nested, samples=FEATURE_SAMPLES, adaptive="none")
    integrator.render(scene, sensor, seed=combine(hash32(seed), 2), spp=FEATURE_SAMPLES**2)
    values = np.array(sensor.film().develop())[..., -len(NAMES) :]
    return values[..., :3], values[..., 3:]


def check(film: mi.Film) -> None:
    """Raises ValueError for a film that stores no colours."""
    if mi.has_flag(film.flags(), mi.FilmFlags.Special):
        raise ValueError(
            f"{film.class_name()}: its channels are not the colours that a denoiser knows; take an hdrfilm to denoise"
        )


def half(integrator: Any, sensor: mi.Sensor, spp: int) -> dict[str, Any]:
    """Arguments of :func:`.rendering.progressive` for half of the samples: those of ``spp``, or of the integrator if
    that is 0.

    Our own integrators get patterns of about N²/2, with twice the variance where noise or a threshold is asked for,
    and half of the time.
    """
    if not rendering.keeps(integrator):
        return {"spp": ((spp or sensor.sampler().sample_count()) + 1) // 2}
    if spp:
        return {"spp": size_of_half(spp**0.5) ** 2}
    asked = integrator.sampling
    sampling = dataclasses.replace(
        asked,
        samples=size_of_half(asked.samples),
        max_samples=(asked.max_samples + 1) // 2,
        threshold=asked.threshold * 2**0.5,
        noise=asked.noise * 2**0.5,
        noise_99=asked.noise_99 * 2**0.5,
        noise_999=asked.noise_999 * 2**0.5,
        time=asked.time / 2,
    )
    return {"sampling": sampling}


def size_of_half(n: float) -> int:
    """N of the patterns of which two have about ``n``² samples."""
    return max(1, round(n / 2**0.5))


def together(first: Any, second: Any) -> Any:
    """How far two halves came, as :class:`~mitsuba_prosim.engine.render.Reached`."""
    return dataclasses.replace(
        first,
        samples=first.samples + second.samples,
        least=first.least + second.least,
        noise=float(np.hypot(first.noise, second.noise)) / 2,
        noise_99=float(np.hypot(first.noise_99, second.noise_99)) / 2,
        noise_999=float(np.hypot(first.noise_999, second.noise_999)) / 2,
        seconds=first.seconds + second.seconds,
    )
