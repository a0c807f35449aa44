"""Denoises two halves of an image, and renders the albedo and normals of the visible surfaces for the denoiser."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import cached_property

import mitsuba as mi
import numpy as np

from ..registry import create
from ..sampling.hash import combine, hash32
from ..transport.features import NAMES
from .denoise import denoise_halves
from .denoised import Denoised
from .oidn import Denoiser

#: Square root of the number of samples of a pixel's features.
FEATURE_SAMPLES = 4

#: Whether the networks are fast -> time in which a denoiser with features denoises two halves, in multiples of the time
#: of a call without features. Measured from 128 x 128 to 500 x 500 pixels.
COSTS = {False: 15.0, True: 2.9}
#: Maximum share of a time limit for the denoiser.
SHARE = 0.25


class HalvesDenoiser:
    """Denoises an image of ``scene`` from two halves of its samples; ``fast`` excludes the best networks."""

    def __init__(self, scene: mi.Scene, sensor: mi.Sensor, seed: int, hide_emitters: bool, fast: bool) -> None:
        self.scene, self.sensor, self.seed, self.hide_emitters, self.fast = scene, sensor, seed, hide_emitters, fast
        self._latest: tuple[float, Denoised] | None = None

    def choose_networks(self, limit: float) -> float:
        """Sets :attr:`fast` so that denoising takes at most :data:`SHARE` of ``limit`` seconds, and returns its
        seconds; infinity if even the fast networks take longer.
        """
        call = seconds_per_pixel() * float(np.prod(self.sensor.film().crop_size()))
        affordable = [fast for fast, cost in COSTS.items() if cost * call <= SHARE * limit and fast >= self.fast]
        self.fast = not affordable or affordable[0]
        return COSTS[self.fast] * call if affordable else float("inf")

    @cached_property
    def names(self) -> list[str]:
        """Names of the channels of a half: first the film's channels (colours, alpha), then the integrator's channels.

        The channel names are read from the film once and stored, because rendering the albedo and normals later changes
        the film's channels.
        """
        return [field.name for field in self.sensor.film().bitmap().struct_()]

    @cached_property
    def features(self) -> tuple[np.ndarray, np.ndarray]:
        """Albedo and normals of the visible surfaces, see the function :func:`features`."""
        return features(self.scene, self.sensor, self.seed, self.hide_emitters)

    @cached_property
    def denoiser(self) -> Denoiser:
        """The denoiser with the features."""
        return Denoiser(*self.features, self.fast)

    def colours(self, images: list[np.ndarray]) -> list[np.ndarray]:
        """Returns the colour channels of the developed ``images``, shape (height, width, 1 or 3)."""
        return [image[..., : 1 if self.names[0] == "Y" else 3] for image in images]

    def __call__(self, halves: Callable[[], list[np.ndarray]], samples: float) -> Denoised:
        """Returns the denoised image.

        ``halves`` returns the developed halves, which have ``samples`` samples per pixel together. The latest result is
        returned again if it has the same samples. Raises RuntimeError if the second half is missing.
        """
        if self._latest is None or self._latest[0] != samples:
            images = self.colours(halves())
            if len(images) < 2:
                raise RuntimeError("the render was stopped before its second half; there is nothing to denoise")
            self._latest = samples, denoise_halves(images[0], images[1], self.denoiser)
        return self._latest[1]


def seconds_per_pixel() -> float:
    """Returns the measured time of a denoiser with the smallest networks, without features, in seconds per pixel."""
    image, denoiser = np.zeros((128, 128, 3), np.float32), Denoiser(fast=True)
    denoiser(image)  # loads the networks
    started = time.perf_counter()
    denoiser(image)
    return (time.perf_counter() - started) / (128 * 128)


def features(
    scene: mi.Scene, sensor: mi.Sensor, seed: int = 0, hide_emitters: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Renders the visible surfaces' albedo and normals by :ref:`integrator-prosim_features`; returns ``(albedo,
    normal)``, each of shape (height, width, 3).

    The film of ``sensor`` is overwritten, and its filter applies. If ``hide_emitters`` is true, light sources are not
    visible. The samples of the albedo and normals differ from the samples of an image with the same ``seed``, so that
    the noise of the albedo and normals is independent of the noise of the image.
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
