"""From a scene to two images by different samples, and the features of the view."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from ..engine.waves import part
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


def halves(
    scene: mi.Scene,
    sensor: mi.Sensor,
    integrator: mi.Integrator,
    seed: int = 0,
    spp: int = 0,
    tell: Callable[[float], None] | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> Halves:
    """Renders each half by itself. ``tell``: called with the part done, 0 to 1; ``stopped``: asked after the first
    half, and after the second one, whether it was cut short.
    """
    check(sensor.film())
    reached = []
    images = []
    with halved(integrator, sensor, spp) as (_, half):
        # No neighbouring seed, which may be that of another image.
        for k, own in enumerate((seed, combine(hash32(seed), 1))):
            rendering.render(scene, sensor, own, half, part(tell, 0.48 * k, 0.48 * (k + 1)), integrator=integrator)
            images.append(np.array(sensor.film().develop()))
            reached.append(getattr(integrator, "reached", None))
            if stopped():
                break
    names = [field.name for field in sensor.film().bitmap().struct_()]
    if stopped():
        if reached[0]:
            integrator.reached = reached[0]
        return Halves(names, images[0], None)
    if all(reached):
        integrator.reached = together(*reached)
    albedo, normal = features(scene, sensor, seed, getattr(integrator, "hide_emitters", False))
    if tell is not None:
        tell(1.0)
    return Halves(names, images[0], images[1], albedo, normal)


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


@contextmanager
def halved(integrator: Any, sensor: mi.Sensor, spp: int) -> Iterator[tuple[Any, int]]:
    """``(integrator, spp)`` for half of the samples, for a while: those of ``spp``, or of the integrator if that is 0.

    Our own integrators get patterns of about N²/2, with twice the variance where noise or a threshold is asked for,
    and half of the time.
    """
    from ..engine.integrator import WaveIntegrator

    if not isinstance(integrator, WaveIntegrator) or not is_jit():
        yield integrator, ((spp or sensor.sampler().sample_count()) + 1) // 2
        return
    if spp:
        yield integrator, size_of_half(spp**0.5) ** 2
        return
    asked = {
        "samples": size_of_half(integrator.samples),
        "max_samples": (integrator.max_samples + 1) // 2,
        "threshold": integrator.threshold * 2**0.5,
        "noise": integrator.noise * 2**0.5,
        "noise_99": integrator.noise_99 * 2**0.5,
        "time": integrator.time / 2,
    }
    before = {name: getattr(integrator, name) for name in asked}
    try:
        for name, value in asked.items():
            setattr(integrator, name, value)
        yield integrator, 0
    finally:
        for name, value in before.items():
            setattr(integrator, name, value)


def size_of_half(n: float) -> int:
    """N of the patterns of which two have about ``n``² samples."""
    return max(1, round(n / 2**0.5))


def together(first: Any, second: Any) -> Any:
    """How far two halves came, as :class:`~mitsuba_prosim.engine.snapshot.Reached`."""
    return dataclasses.replace(
        first,
        samples=first.samples + second.samples,
        least=first.least + second.least,
        noise=float(np.hypot(first.noise, second.noise)) / 2,
        noise_99=float(np.hypot(first.noise_99, second.noise_99)) / 2,
        seconds=first.seconds + second.seconds,
    )


def is_jit() -> bool:
    """Whether the variant has waves."""
    return not str(mi.variant()).startswith("scalar")
