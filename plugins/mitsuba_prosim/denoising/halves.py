"""Renders the inputs of the denoiser: two images of a scene with different samples, and the albedo and normals of the
visible surfaces.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import cache, cached_property, lru_cache
from typing import Any

import mitsuba as mi
import numpy as np

from ..engine.error_target import AIM, counts_for_ratio, mean
from ..engine.image import Noise
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

#: A render ends when the upper bound of the error of the final image is at most this many times the limit. A value of
#: :data:`TOLERANCE` would miss some images whose two halves have an error in common.
BOUND = 1.05


def render(
    scene: mi.Scene,
    sensor: int | mi.Sensor = 0,
    integrator: mi.Integrator | None = None,
    seed: int = 0,
    spp: int = 0,
    fast: bool = False,
) -> Denoised:
    """Renders ``scene`` with its own integrator, or with ``integrator``, and denoises the image.

    Half of the ``spp`` samples per pixel use one seed, and the other half use another seed; if ``spp`` is 0, the sample
    count in the scene is used. The integrator's parameter ``noise`` is the error target of the final image. If the
    image reaches the error target without denoising, all images of the result are the image without denoising. The
    render overwrites the sensor's film; the denoised image is only returned, not written to the film. ``fast`` selects
    smaller networks, see :func:`.denoise`.

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
    """Returns a new progressive render that takes two halves of the samples for the denoiser.

    The attribute ``denoiser`` of the returned render is a :class:`FinalImage`, which denoises the image. ``options``
    are passed to :func:`.rendering.progressive`. Raises ValueError for films that store no colours.
    """
    if isinstance(sensor, int):
        sensor = scene.sensors()[sensor]
    check(sensor.film())
    denoiser = FinalImage(scene, sensor, integrator, seed, fast)
    denoiser.render = rendering.progressive(scene, sensor, integrator, seed, spp, denoiser=denoiser, **options)
    return denoiser.render


class FinalImage:
    """Denoises the image of a ``render`` from two images, each with half of the samples, and estimates the error.

    If a render has an error target but no time limit, a large image gets the same first samples as without a denoiser.
    If the image without denoising (the raw image) reaches the error target, the render ends, and the raw image is the
    result. If the raw image still needs many samples to reach the error target, the render begins a second image for
    the other half of the samples. To estimate the error, the denoiser is first called when the error of the raw image
    is at most ``FAR`` times the error target. After the first call of the denoiser, the estimated error of the denoised
    image decides how many samples the next pass takes. Without a time limit, the number of samples depends neither on
    measured times nor on the last bits of the denoiser's output, which differ with the number of threads.

    To estimate the error of the denoised image, the denoiser first uses its smallest neural networks without albedo and
    normals ("plain"), which cost little time. If the image needs many samples even with the networks "plain", the
    denoiser changes to its best networks, unless ``fast`` is true.
    """

    #: Maximum ratio of the raw image's error to the target at which the denoiser is first called. A smaller value would
    #: make images too good whose error the denoiser reduces to a fifth.
    FAR = 3.5
    #: Ratio of the error to its limit at which a pass aims before the denoiser is called, because another pass or
    #: another call costs more than some samples.
    CLOSE = 0.93
    #: Maximum number of calls of the denoiser that estimate the error.
    CALLS = 5
    #: Cost of a call of the denoiser with the smallest networks, in rays per pixel.
    CALL_COST = 48
    #: In multiples of the cost of a call: the minimum number of samples that the raw image lacks when the second half
    #: begins; the minimum number of samples before the first call; the minimum number of samples that the denoiser must
    #: save after a call; and the minimum number of samples of the image for which the best networks are worth their
    #: time.
    BEGIN, FIRST, SAVED, BEST = 6, 3, {"plain": 2, "best": 6}, 32

    def __init__(self, scene: mi.Scene, sensor: mi.Sensor, integrator: Any, seed: int, fast: bool) -> None:
        """Before any other use, the caller must set the attribute ``render`` to the :class:`.Render` whose image is
        denoised. ``fast`` excludes the best networks.
        """
        self.scene, self.sensor, self.integrator, self.seed, self.fast = scene, sensor, integrator, seed, fast
        self.render: Any = None
        self._denoiser = cache(self._load)
        self._latest = lru_cache(maxsize=1)(self._denoise)  # keeps the last result

    @cached_property
    def names(self) -> list[str]:
        """Names of the channels of :attr:`images`: first the film's channels (colours, alpha), then the integrator's
        channels.

        The channel names are read from the film once and stored, because rendering the albedo and normals later changes
        the film's channels.
        """
        return [field.name for field in self.sensor.film().bitmap().struct_()]

    @property
    def images(self) -> list[np.ndarray]:
        """One or two developed images, each from half of the samples so far: all channels, shape (height, width,
        channels).

        The list has only the first image if any pixel has no sample of the second half.
        """
        return self.render.half_images()

    @property
    def colours(self) -> list[np.ndarray]:
        """The colour channels of each image in :attr:`images`, shape (height, width, 1 or 3)."""
        return [image[..., : 1 if self.names[0] == "Y" else 3] for image in self.images]

    def other_channels(self) -> dict[str, np.ndarray]:
        """Returns all channels except the colours, combined from both images of :attr:`images`: name -> array.

        Each array has the shape (height, width). A channel is the mean of this channel in the two images, with two
        exceptions: "samples" is the sum, and "error" is the standard error of the mean of two independent images. If
        :attr:`images` has only the first image, the channels are those of the first image.
        """
        images, names, result = self.images, self.names, {}
        for k in range(1 if names[0] == "Y" else 3, len(names)):
            planes, name = [image[..., k] for image in images], names[k]
            total = np.hypot.reduce(planes) if name == "error" else np.add.reduce(planes)
            result[name] = total if name == "samples" else total / len(images)
        return result

    @cached_property
    def features(self) -> tuple[np.ndarray, np.ndarray]:
        """Albedo and normals of the visible surfaces, see the function :func:`features`."""
        return features(self.scene, self.sensor, self.seed, getattr(self.integrator, "hide_emitters", False))

    def _load(self, networks: str) -> Denoiser:
        """Returns a denoiser with neural networks of the kind ``networks``: "plain", "fast" or "best", see
        :attr:`networks`.
        """
        albedo, normal = (None, None) if networks == "plain" else self.features
        return Denoiser(albedo, normal, networks != "best")

    @property
    def networks(self) -> str:
        """Kind of the denoiser's neural networks for the samples so far: "plain", "fast", "best", or "none" (no
        denoiser).

        The networks "plain" are the fast networks without albedo and normals. The value "none" means that the image has
        reached the error target without denoising. If no samples were added since the error of the denoised image was
        last estimated, the networks of this estimate are used, because the estimate is valid for these networks only.
        In all other cases, the result is "best", or "fast" if the best networks are excluded.
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
        """Returns the denoised image of the samples so far, or the image without denoising if it has reached the error
        target. Raises RuntimeError if an image that needs denoising has no second half.
        """
        return self._latest(self.networks, self._samples)

    def _denoise(self, networks: str, _: float) -> Denoised:
        """Returns the image denoised by neural networks of the kind ``networks``, or the raw image if ``networks`` is
        "none".

        The second argument, the number of samples, is only a part of the cache's key: the cached image is valid until
        samples are added. Raises RuntimeError if the image needs denoising, but :attr:`images` has no second half.
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
        """Mean number of samples per pixel so far; 0 if the render does not measure it (:class:`.Blocking`)."""
        reached = self.render.reached
        return float(reached.samples) if reached else 0.0

    def estimate(self, render: Render) -> Noise:
        """Returns an estimate of the error of the final image, from which ``render`` decides whether more samples are
        needed.

        If this method does not call the denoiser, the estimate is extrapolated from the denoiser's last call, or is the
        error of the raw image. If this method begins a complete second image, ``render`` takes the samples of the
        second image and calls this method again. This method may also set ``target.sample_ratio``, the ratio of the
        samples after and before the next pass.
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
        factor, cost = (excess / AIM) ** (1 / RATE), self._call_cost
        if not second.complete:
            # A complete second half doubles the samples, which is not worth while for an image that needs few samples.
            least = 2 * samples + self.BEGIN * cost
            if samples * factor >= least and self._needed(factor) >= least:
                render.begin_complete_second()
            return raw
        if not estimates and (excess > self.FAR or samples < self.FIRST * cost):
            by_error = (excess / (self.CLOSE * self.FAR)) ** (1 / RATE)
            target.sample_ratio = max(by_error, self.FIRST * cost / samples)
            return raw
        by_raw = self._needed(factor)
        networks = estimates[-1][1] if estimates else "plain"
        # Calls the denoiser at most twice: with the networks so far, and after the first call perhaps with the best.
        while True:
            if estimates:
                last, _, ratio = estimates[-1]  # the samples and the ratio of the errors at the last call
                noise = scaled(raw, ratio * (samples / last) ** RATIO_RATE)
                excess = target.excess(noise)
                by_final = self._needed((excess / AIM) ** (1 / (RATE - RATIO_RATE)))
                if last == samples and excess <= 1:
                    return noise
                saves = by_raw - by_final >= self.SAVED[networks] * cost
                if len(estimates) == 1 and min(by_raw, by_final) > self.BEST * cost and not self.fast:
                    networks = "best"
                elif not saves or len(estimates) >= self.CALLS:  # the denoiser saves too few samples
                    return raw
                elif last == samples or excess > 1:  # more samples are needed before the next call
                    target.sample_ratio = (excess / self.CLOSE) ** (1 / (RATE - RATIO_RATE))
                    return noise
            result = self._latest(networks, samples)
            # Rounded, because the bits of a denoised image depend on the number of threads.
            ratio = float(f"{result.at_most / BOUND / result.raw_noise:.3g}")
            estimates.append((samples, networks, ratio))

    def _needed(self, ratio: float) -> float:
        """Returns the mean number of samples per pixel with which the error is as small as with ``ratio`` times the
        current samples in every pixel.

        The policy of adaptive sampling distributes the samples. If the second image is complete, the result counts the
        samples of both images. The result is infinite if all pixels would need the maximum number of samples of a
        pixel, which may not suffice.
        """
        state, plan = self.render.state, self.render.state.plan
        counts = state.crop(counts_for_ratio(state, ratio), plan.region)
        if counts.min() == plan.max_samples:
            return float("inf")
        return mean(counts) * (2 if self.render.second.complete else 1)

    @property
    def _call_cost(self) -> float:
        """Cost of a call of the denoiser with the smallest networks, in samples per pixel.

        The cost is :attr:`CALL_COST` divided by the number of rays of a sample. If the integrator traces paths, or is
        an integrator of Mitsuba, a sample is assumed to trace 10 rays. If the integrator follows ray trees, a sample is
        assumed to trace one camera ray and one shadow ray to each lamp, and twice as many rays if reflected or
        refracted rays are followed. The number of rays is estimated from the scene, not from measured times, because
        the decisions of a render must be reproducible.
        """
        transport = self.render.state.estimator.transport
        if not hasattr(transport, "lights") or not transport.settings.follows_tree:  # follows paths
            return self.CALL_COST / 10
        follows = transport.settings.max_level > 0 and (transport.reflects or transport.refracts)
        return self.CALL_COST / (1 + transport.lights.lamps) / (2 if follows else 1)


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


def scaled(noise: Sequence[float], factor: float) -> Noise:
    """Returns the four errors of the measurement ``noise`` (:data:`.Noise`), each multiplied by ``factor``."""
    return noise[0] * factor, noise[1] * factor, noise[2] * factor, noise[3] * factor


def check(film: mi.Film) -> None:
    """Raises ValueError for a film that stores no colours."""
    if mi.has_flag(film.flags(), mi.FilmFlags.Special):
        raise ValueError(f"{film.class_name()}: the denoiser needs colours; use an hdrfilm")
