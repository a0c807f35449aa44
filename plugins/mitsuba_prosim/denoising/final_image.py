"""The final image of a render with a denoiser."""

from __future__ import annotations

import time
from typing import Any

import mitsuba as mi
import numpy as np

from ..engine.error_target import mean
from ..engine.render import Render
from ..scene import rendering
from .denoised import Denoised
from .final_error import FinalError
from .halves import HalvesDenoiser, check
from .mixing import unmixed


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
    final = denoised_progressive(scene, sensor, integrator, seed, spp, fast)
    final.render.run()
    return final.denoised()


def denoised_progressive(
    scene: mi.Scene,
    sensor: int | mi.Sensor,
    integrator: Any,
    seed: int = 0,
    spp: int = 0,
    fast: bool = False,
    **options: Any,
) -> FinalImage:
    """Returns the :class:`FinalImage` of a new progressive render, which takes two halves of the samples.

    The caller takes the steps of its attribute ``render``. ``options`` are passed to :func:`.rendering.progressive`.
    Raises ValueError for films that store no colours.
    """
    if isinstance(sensor, int):
        sensor = scene.sensors()[sensor]
    check(sensor.film())
    hide_emitters, limit = getattr(integrator, "hide_emitters", False), 0.0
    if not spp and rendering.is_progressive(integrator):
        limit, fast = integrator.time, fast or any(integrator.sampling.noises)
    error = FinalError(HalvesDenoiser(scene, sensor, seed, hide_emitters, fast))
    started, why_raw, reserved = time.perf_counter(), "", 0.0
    if limit:
        if not any(integrator.sampling.noises) and has_wide_filter(sensor):
            why_raw = "in equal time, samples help more than a denoiser, as the film's filter is wider than a pixel"
        elif (reserved := error.denoiser.choose_networks(limit)) == np.inf:
            why_raw = f"the denoiser would take too much of the {limit:g} s"
    spent, measure = time.perf_counter() - started, None if why_raw else error
    render = rendering.progressive(scene, sensor, integrator, seed, spp, measure=measure, **options)
    final = FinalImage(render, error.denoiser, why_raw)
    if limit and not why_raw:  # renders the features before the first sample, and the names before, which they change
        assert error.denoiser.names and error.denoiser.features
        render.target.reserved = reserved
        render.target.started -= spent
    return final


def has_wide_filter(sensor: mi.Sensor) -> bool:
    """Tells whether the filter of a sensor's film is wider than a pixel, so that the noise of pixels is dependent."""
    return not sensor.film().rfilter().is_box_filter()


class FinalImage:
    """The denoised image of a ``render``, or its image without denoising if that has reached the error target.

    ``denoiser`` denoises the image. ``why_raw`` says why the image must not be denoised; it is empty if the error
    target decides.
    """

    def __init__(self, render: Any, denoiser: HalvesDenoiser, why_raw: str = "") -> None:
        self.render, self.denoiser, self._why_raw = render, denoiser, why_raw

    def other_channels(self) -> dict[str, np.ndarray]:
        """Returns all channels except the colours, combined from both halves of the samples: name -> array.

        Each array has the shape (height, width). A channel is the mean of this channel in the two images, with two
        exceptions: "samples" is the sum, and "error" is the standard error of the mean of two independent images.
        Without a second half, the channels are those of the first half.
        """
        images, names, result = self.render.half_images(), self.denoiser.names, {}
        for k in range(1 if names[0] == "Y" else 3, len(names)):
            planes, name = [image[..., k] for image in images], names[k]
            total = np.hypot.reduce(planes) if name == "error" else np.add.reduce(planes)
            result[name] = total if name == "samples" else total / len(images)
        return result

    @property
    def why_raw(self) -> str | None:
        """Why the image is not denoised, in words; None if it is denoised."""
        render = self.render
        if not isinstance(render, Render):
            return None
        if self._why_raw:
            return self._why_raw
        if render.second is not None and render.target.excess(render.second.noise(render.state)) <= 1:
            reached = " and ".join(f"{limit:g}" for limit in render.target.limits if limit)
            return f"the image reached {reached} without denoising, which would have taken longer"
        return None

    def denoised(self) -> Denoised:
        """Returns the denoised image of the samples so far, or the image without denoising if it has reached the error
        target. Raises RuntimeError if an image that needs denoising has no second half.
        """
        if self.why_raw is None:
            samples = mean(self.render.counts()) if isinstance(self.render, Render) else 0.0
            return self.denoiser(self.render.half_images, samples)
        colours = self.denoiser.colours(self.render.half_images())
        # ``error`` shows where the noise is, but is too large: it is the error of independent samples of the first
        # image. ``noise`` [0] is the measured RMS error.
        second = self.render.second
        noise = self.render.noise_bound() if second is None else second.noise(self.render.state)[0]
        return unmixed(np.add.reduce(colours) / len(colours), self.render.error(), noise)
