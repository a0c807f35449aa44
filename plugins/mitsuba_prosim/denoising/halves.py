"""Denoises two halves of an image, and renders the albedo and normals of the visible surfaces for the denoiser."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import cached_property

import mitsuba as mi
import numpy as np

from ..parameters import check_unpolarized
from ..registry import create
from ..sampling.hash import combine, hash32
from ..transport.features import NAMES
from .denoise import denoise_halves
from .denoised import Denoised
from .oidn import Denoiser
from .pyramid import unevenness

#: Whether the networks are fast -> square root of the number of samples of a pixel's features; time in which both
#: halves are denoised, in multiples of the time of a call of the fast networks, from 128 x 128 to 500 x 500 pixels.
FEATURE_SAMPLES, COSTS = {False: 4, True: 2}, {False: 10.0, True: 2.9}
#: Maximum share of a time limit for that. The features may take as long again, also if the image is not denoised then.
SHARE = 0.04
#: Time of a call of the fast networks, in rays per pixel; number of rays per pixel from which the best networks save
#: time, because they replace a fifth of the samples; number of samples of a ray tree after which one image has less
#: noise than two halves that are denoised.
CALL_RAYS, BEST_RAYS, ENOUGH = 40, 2400, 256
#: Maximum unevenness of the normals of an image that a denoiser improves more than samples do.
DETAILS = 0.3


class HalvesDenoiser:
    """Denoises an image of ``scene`` from two halves of its samples; keeps the latest result.

    ``fast`` tells whether the fast networks are used; None: unless the image has :data:`BEST_RAYS`.
    """

    def __init__(self, scene: mi.Scene, sensor: mi.Sensor, seed: int, hide_emitters: bool, fast: bool | None) -> None:
        self.scene, self.sensor, self.seed, self.hide_emitters, self.fast = scene, sensor, seed, hide_emitters, fast
        self._latest: tuple[float, Denoised] | None = None
        self._denoisers: dict[bool, Denoiser] = {}
        #: Seconds of a time limit for the denoiser, and :func:`.unevenness` of the normals; 0 while they are unknown.
        self.reserved = self.details = 0.0

    def plan(self, limit: float, rays: float) -> str:
        """Chooses the networks for a render of ``limit`` seconds, and sets :attr:`reserved` to the seconds of the
        denoiser. Returns why samples, of ``rays`` rays each, help more; "" if they do not.
        """
        call = seconds_per_pixel() * float(np.prod(self.sensor.film().crop_size()))
        seconds = {fast: cost * call for fast, cost in COSTS.items() if self.fast in (None, fast)}
        affordable = [fast for fast, each in seconds.items() if each <= SHARE * limit]
        if not affordable:
            return f"the denoiser would take too much of the {limit:g} s"
        if limit / call * CALL_RAYS > ENOUGH * rays:
            return f"the samples of {limit:g} s alone leave less noise"
        self.fast, self.reserved = affordable[0], seconds[affordable[0]]
        self.denoiser(self.fast)  # renders the features, which have no share in the reserved time
        return "small details leave a denoiser little to do" if self.details > DETAILS else ""

    @cached_property
    def names(self) -> list[str]:
        """Names of the channels of a half, stored because the features change the film's channels."""
        return [field.name for field in self.sensor.film().bitmap().struct_()]

    def denoiser(self, fast: bool) -> Denoiser:
        """Returns the denoiser with the features of the view, which are rendered for the first call."""
        if fast not in self._denoisers:
            what = self.scene, self.sensor, self.seed, self.hide_emitters, FEATURE_SAMPLES[fast]
            albedo, normal = features(*what)
            self._denoisers[fast], self.details = Denoiser(albedo, normal, fast), unevenness(normal)
        return self._denoisers[fast]

    def colours(self, images: list[np.ndarray]) -> list[np.ndarray]:
        """Returns the colours of the developed ``images``, shape (height, width, 1 or 3)."""
        return [image[..., : 1 if self.names[0] == "Y" else 3] for image in images]

    def __call__(self, halves: Callable[[], list[np.ndarray]], samples: float, rays: float) -> Denoised:
        """Returns the denoised image.

        ``halves`` returns the developed halves, which together have ``samples`` samples per pixel, of about ``rays``
        rays each. The latest result is returned again if it has the same samples. Raises RuntimeError if the second
        half is missing.
        """
        if self._latest is None or self._latest[0] != samples:
            images = self.colours(halves())
            if len(images) < 2:
                raise RuntimeError("the render was stopped before its second half; there is nothing to denoise")
            fast = samples * rays < BEST_RAYS if self.fast is None else self.fast
            self._latest = samples, denoise_halves(images[0], images[1], self.denoiser(fast))
        return self._latest[1]


def seconds_per_pixel() -> float:
    """Returns the measured time of a denoiser with the smallest networks, without features, in seconds per pixel."""
    image, denoiser = np.zeros((128, 128, 3), np.float32), Denoiser(fast=True)
    denoiser(image)  # loads the networks
    started = time.perf_counter()
    denoiser(image)
    return (time.perf_counter() - started) / (128 * 128)


def features(
    scene: mi.Scene, sensor: mi.Sensor, seed: int = 0, hide_emitters: bool = False, n: int = 4
) -> tuple[np.ndarray, np.ndarray]:
    """Renders the visible surfaces by :ref:`integrator-prosim_features` with ``n``² samples per pixel; returns
    ``(albedo, normal)``, each of shape (height, width, 3).

    The film of ``sensor`` is overwritten, and its filter applies. The noise is independent of that of an image with the
    same ``seed``. If ``hide_emitters`` is true, light sources are not visible.
    """
    nested = create("prosim_features", hide_emitters=hide_emitters)
    integrator = create("prosim_adaptive", nested=nested, samples=n, adaptive="none")
    integrator.render(scene, sensor, seed=combine(hash32(seed), 2), spp=n**2)
    values = np.array(sensor.film().develop())[..., -len(NAMES) :]
    return values[..., :3], values[..., 3:]


def check(film: mi.Film) -> None:
    """Raises ValueError for a film that stores no colours, and in polarised variants."""
    check_unpolarized("denoising")
    if mi.has_flag(film.flags(), mi.FilmFlags.Special):
        raise ValueError(f"{film.class_name()}: the denoiser needs colours; use an hdrfilm")
