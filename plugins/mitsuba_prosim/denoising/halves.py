"""Renders two images of a scene with different samples, and features of the view, for the denoiser."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import cache, cached_property, lru_cache
from typing import Any

import mitsuba as mi
import numpy as np

from ..engine.error_target import AIM, Noise, counts_for_ratio, mean
from ..engine.render import Render
from ..registry import create
from ..sampling.hash import combine, hash32
from ..scene import rendering
from ..transport.features import NAMES
from .denoised import denoise_halves
from .mixing import Denoised, unmixed
from .oidn import Denoiser

#: Square root of the number of samples of a pixel's features.
FEATURE_SAMPLES = 4

#: Exponents of two power laws, means of several scenes. More samples reduce the error of the raw image, and increase
#: the ratio of the error of the denoised image to the error of the raw image.
RATE, RATIO_RATE = 0.68, 0.1

#: With a probability of about 95 %, the error of the final image is at most this many times the limit.
TOLERANCE = 1.1


def render(
    scene: mi.Scene,
    sensor: int | mi.Sensor = 0,
    integrator: mi.Integrator | None = None,
    seed: int = 0,
    spp: int = 0,
    fast: bool = False,
) -> Denoised:
    """Renders ``scene`` with its own integrator, or with ``integrator``, and denoises the image.

    Half of the samples (``spp``, or the sample count of the integrator) use one seed; the other half use another seed.
    The integrator's parameter ``noise`` is the error target of the final image. The render overwrites the sensor's
    film, which does not hold the denoised image afterwards. ``fast`` selects smaller networks, see :func:`.denoise`.

    Raises ValueError for films that store no colours, and :class:`.oidn.MissingError` if the package mitsuba-oidn is
    not installed.
    """
    integrator = integrator or scene.integrator()
    return denoised_progressive(scene, sensor, integrator, seed, spp, fast).run().denoiser.denoised()


def denoised_progressive(
    scene: mi.Scene,
    sensor: int | mi.Sensor,
    integrator: Any,
    seed: int = 0,
    spp: int = 0,
    fast: bool = False,
    **options: Any,
) -> Any:
    """Begins a progressive render whose image is denoised at its end.

    ``render.denoiser`` is the :class:`FinalImage` of the returned render. ``options`` are passed to
    :func:`.rendering.progressive`. Raises ValueError for films that store no colours.
    """
    if isinstance(sensor, int):
        sensor = scene.sensors()[sensor]
    check(sensor.film())
    denoiser = FinalImage(scene, sensor, integrator, seed, fast)
    denoiser.render = rendering.progressive(scene, sensor, integrator, seed, spp, denoiser=denoiser, **options)
    return denoiser.render


class FinalImage:
    """Denoises the two halves of a ``render`` at its end, and earlier to estimate the error of the final image.

    With an error target, the render begins as without a denoiser. If the raw image reaches the target, the render ends
    and the raw image is the result. If the raw image lacks many samples, the second half of the samples begins. The
    denoiser is first called when the error of the raw image is at most ``FAR`` times the target. The estimated error of
    the denoised image then decides how many samples the next pass takes. The decisions depend only on samples and
    rounded errors. The image does not depend on measured times, nor on bits of the denoiser that differ with the number
    of threads.

    With an error target, the denoiser uses the smallest networks without features, which cost little ("plain"). It uses
    the best networks if the image needs many samples even so.
    """

    #: Maximum ratio of the raw image's error to the target at which the denoiser is first called.
    FAR = 2.7
    #: Ratio of the error to its limit at which a pass aims before the denoiser is called, because another pass or
    #: another call costs more than some samples.
    CLOSE = 0.93
    #: Maximum number of calls of the denoiser that estimate the error.
    CALLS = 5
    #: Cost of a call of the denoiser with the smallest networks, in rays per pixel.
    CALL_COST = 48
    #: In multiples of the cost of a call: the minimum number of samples that the raw image lacks when the second half
    #: begins; the minimum number of samples that the denoiser must save after a call; and the minimum number of samples
    #: of the image for which the best networks are worth their time.
    BEGIN, SAVED, BEST = 6, {"plain": 2, "best": 6}, 32

    def __init__(self, scene: mi.Scene, sensor: mi.Sensor, integrator: Any, seed: int, fast: bool) -> None:
        """The caller must set ``render``, the :class:`.Render` whose image is denoised, before the first other call.
        ``fast`` excludes the best networks.
        """
        self.scene, self.sensor, self.integrator, self.seed, self.fast = scene, sensor, integrator, seed, fast
        self.render: Any = None
        self._denoiser = cache(self._load)
        self._latest = lru_cache(maxsize=1)(self._denoise)  # keeps the last result

    @cached_property
    def names(self) -> list[str]:
        """Names of the channels of :attr:`images`; the film's own channels are first.

        The names are read before the rendering of the features changes the film.
        """
        return [field.name for field in self.sensor.film().bitmap().struct_()]

    @property
    def images(self) -> list[np.ndarray]:
        """The developed halves of the image so far with all channels, each of shape (height, width, channels).

        The list has only one image if the second half has no samples, or has samples of some pixels only.
        """
        return self.render.half_images()

    @property
    def colours(self) -> list[np.ndarray]:
        """The colours of each of :attr:`images`, shape (height, width, 1 or 3)."""
        return [image[..., : 1 if self.names[0] == "Y" else 3] for image in self.images]

    def other_channels(self) -> dict[str, np.ndarray]:
        """Returns alpha and the further channels of the integrator, for both halves together: name -> array.

        Each array has the shape (height, width). A channel is the mean of the halves, with two exceptions: "samples" is
        the sum, and "error" is the standard error of the mean of two independent images.
        """
        images, names, result = self.images, self.names, {}
        for k in range(1 if names[0] == "Y" else 3, len(names)):
            planes, name = [image[..., k] for image in images], names[k]
            total = np.hypot.reduce(planes) if name == "error" else np.add.reduce(planes)
            result[name] = total if name == "samples" else total / len(images)
        return result

    @cached_property
    def features(self) -> tuple[np.ndarray, np.ndarray]:
        """Albedo and normal of the view, see the function :func:`features`."""
        return features(self.scene, self.sensor, self.seed, getattr(self.integrator, "hide_emitters", False))

    def _load(self, networks: str) -> Denoiser:
        """Returns a denoiser with these ``networks``, see :attr:`networks`."""
        albedo, normal = (None, None) if networks == "plain" else self.features
        return Denoiser(albedo, normal, networks != "best")

    @property
    def networks(self) -> str:
        """Which networks of the denoiser suit the samples so far: "plain", "fast", "best" or "none".

        "plain" are the fast networks without features. "none" means that the raw image has reached the error target. If
        the last estimate was made with the same samples, its networks are used again, because the estimate is valid for
        the image of these networks only.
        """
        if self.render.second is not None:
            if self.render.target.excess(self.render.second.noise()) <= 1:
                return "none"
            estimates = self.render.state.estimates
            samples, networks, *_ = estimates[-1] if estimates else (0, "")
            if samples == self._samples:
                return str(networks)
        return "fast" if self.fast else "best"

    def denoised(self) -> Denoised:
        """Returns the denoised image of the samples so far, or the raw image if the raw image has reached the error
        target.
        """
        return self._latest(self.networks, self._samples)

    def _denoise(self, networks: str, _: float) -> Denoised:
        """Returns the denoised image by these ``networks``, or the raw image if ``networks`` is "none".

        The number of samples is an argument only because it is a part of the cache's key.
        """
        colours = self.colours
        if networks == "none":
            raw = np.add.reduce(colours) / len(colours)
            # ``error`` shows where the noise is, but is too large: it is the error of independent samples of the first
            # image. ``noise`` [0] is the measured RMS error.
            return unmixed(raw, self.render.error(), self.render.second.noise()[0])
        if len(colours) < 2:
            raise RuntimeError("the render was stopped before its second half; there is nothing to denoise")
        return denoise_halves(colours[0], colours[1], self._denoiser(networks))

    @property
    def _samples(self) -> float:
        """Mean number of samples per pixel."""
        reached = self.render.reached
        return float(reached.samples) if reached else 0.0

    def estimate(self, render: Render) -> Noise:
        """Returns an estimate of the error of the final image, by which ``render`` decides how to continue.

        If this method does not call the denoiser, the estimate is extrapolated from the denoiser's last call, or is the
        error of the raw image. If this method begins a complete second image, ``render`` takes the samples of the
        second image and calls this method again.
        """
        second, estimates, target, samples = render.second, render.state.estimates, render.target, self._samples
        assert second is not None
        raw = second.noise()
        if target.seconds and not target.denoiser_seconds:
            started = time.perf_counter()
            self.denoised()
            target.denoiser_seconds = 1.2 * (time.perf_counter() - started)
        excess = target.excess(raw)
        if not excess > 1:  # the excess is NaN without limits
            return raw
        # ``cost`` is the cost of a call of the denoiser. Below, ``by_raw`` and ``by_final`` are the counts at which the
        # raw and the final image reach the target. All three are samples per pixel.
        ratio, cost = (excess / AIM) ** (1 / RATE), self._call_cost
        if not second.complete:
            # A complete second half doubles the samples, which is not worth while for an image that needs few samples.
            least = 2 * samples + self.BEGIN * cost
            if samples * ratio >= least and self._needed(ratio) >= least:
                render.begin_complete_second()
            return raw
        if not estimates and excess > self.FAR:
            target.sample_ratio = (excess / (self.CLOSE * self.FAR)) ** (1 / RATE)
            return raw
        by_raw = self._needed(ratio)
        networks = estimates[-1][1] if estimates else "plain"
        # Calls the denoiser at most twice: with the networks so far, and then perhaps with the best networks.
        while True:
            if estimates:
                last, _, ratio = estimates[-1]  # the samples and the ratio of the errors at the last call
                noise = scaled(raw, ratio * (samples / last) ** RATIO_RATE)
                excess = target.excess(noise)
                by_final = self._needed((excess / AIM) ** (1 / (RATE - RATIO_RATE)))
                if last == samples and excess <= 1:
                    return noise
                if min(by_raw, by_final) > self.BEST * cost and not self.fast and networks == "plain":
                    networks = "best"
                elif (
                    by_raw - by_final < self.SAVED[networks] * cost or len(estimates) >= self.CALLS
                ):  # the denoiser saves too few samples
                    return raw
                elif last == samples or excess > 1:  # more samples are needed before the next call
                    target.sample_ratio = (excess / self.CLOSE) ** (1 / (RATE - RATIO_RATE))
                    return noise
            result = self._latest(networks, samples)
            # Rounded, because the bits of a denoised image depend on the number of threads.
            estimates.append((samples, networks, float(f"{result.at_most / result.raw_noise:.3g}")))

    def _needed(self, ratio: float) -> float:
        """Returns the samples per pixel that reduce the error as much as ``ratio`` times the samples in each pixel.

        The result is infinite if the maximum number of samples of a pixel does not reduce the error as much.
        """
        state, plan = self.render.state, self.render.state.plan
        counts = counts_for_ratio(state, ratio)
        if state.crop(counts, plan.region).min() == plan.max_samples:
            return float("inf")
        return mean(counts) * (2 if self.render.second.complete else 1)

    @property
    def _call_cost(self) -> float:
        """Cost of a call of the denoiser with the smallest networks, in samples per pixel.

        The cost is :attr:`CALL_COST` divided by the number of rays of a sample. A sample is assumed to have 10 rays if
        it follows paths. Otherwise, a sample has one ray and a shadow ray to each lamp, and twice as many rays if
        reflected or refracted rays are followed. The number is estimated from the scene, because measured times differ.
        """
        transport = self.render.state.estimator.transport
        if not hasattr(transport, "lights") or not transport.settings.follows_tree:  # follows paths
            return self.CALL_COST / 10
        follows = transport.settings.max_level > 0 and (transport.reflects or transport.refracts)
        return self.CALL_COST / (1 + transport.lights.lamps) / (2 if follows else 1)


def features(
    scene: mi.Scene, sensor: mi.Sensor, seed: int = 0, hide_emitters: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Renders the features of the view by :ref:`integrator-prosim_features`, and returns ``(albedo, normal)``.

    The film's filter applies. The samples of the features differ from the samples of an image with the same ``seed``,
    so that the two halves of the image stay independent.
    """
    nested = create("prosim_features", hide_emitters=hide_emitters)
    integrator = create("prosim_adaptive", nested=nested, samples=FEATURE_SAMPLES, adaptive="none")
    integrator.render(scene, sensor, seed=combine(hash32(seed), 2), spp=FEATURE_SAMPLES**2)
    values = np.array(sensor.film().develop())[..., -len(NAMES) :]
    return values[..., :3], values[..., 3:]


def scaled(noise: Sequence[float], factor: float) -> Noise:
    """Returns the four errors of ``noise``, each multiplied by ``factor``."""
    return noise[0] * factor, noise[1] * factor, noise[2] * factor, noise[3] * factor


def check(film: mi.Film) -> None:
    """Raises ValueError for a film that stores no colours."""
    if mi.has_flag(film.flags(), mi.FilmFlags.Special):
        raise ValueError(f"{film.class_name()}: the denoiser needs colours; use an hdrfilm")
