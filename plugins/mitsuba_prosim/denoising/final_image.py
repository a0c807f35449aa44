"""The final image of a render with a denoiser."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import mitsuba as mi
import numpy as np

from ..engine.error_target import mean
from ..engine.film import put
from ..engine.render import Render
from ..parameters import check_seed, check_whole, pick_sensor
from ..scene import rendering
from ..scene.black import innermost
from ..scene.channels import of_channels, planes
from ..transport.transport import RAYS_PER_PATH
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
    fast: bool | None = None,
) -> Denoised:
    """Renders ``scene`` with its own integrator, or with ``integrator``, and denoises the image.

    The two halves of the ``spp`` samples per pixel (0: the scene's number) use different seeds. The integrator's
    parameter ``noise`` is the error target of the final image. An image that reaches it without denoising is not
    denoised: then all images of the result are equal. The sensor's film gets the image without denoising. ``fast``
    tells whether smaller networks are used; None: if the image has less than 2400 rays per pixel.

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
    fast: bool | None = None,
    **options: Any,
) -> FinalImage:
    """Returns the :class:`FinalImage` of a new render in two halves; the caller takes the steps of its ``render``.

    ``options`` are passed to :func:`.rendering.progressive`. Raises ValueError for films that store no colours.
    """
    sensor, seed, spp = pick_sensor(scene, sensor), check_seed(seed), check_whole("spp", spp)
    check(sensor.film())
    hide_emitters, limit, targets = getattr(innermost(integrator), "hide_emitters", False), 0.0, False
    if not spp and rendering.is_progressive(integrator):
        limit, targets = integrator.time, any(integrator.sampling.noises)
    denoiser = HalvesDenoiser(scene, sensor, seed, hide_emitters, targets or fast)
    started, why_raw = time.perf_counter(), ""
    if limit and not targets and has_wide_filter(sensor):
        why_raw = "in equal time, samples help more than a denoiser, as the film's filter is wider than a pixel"
    elif limit:
        tree = getattr(integrator, "diffuse_bounces", -1) == 0 and not targets
        why_raw = denoiser.plan(limit, 2 * (1 + len(scene.emitters())) if tree else np.inf)
    spent, measure = time.perf_counter() - started, None if why_raw else FinalError(denoiser)
    render = rendering.progressive(scene, sensor, integrator, seed, spp, measure=measure, **options)
    final = FinalImage(render, denoiser, why_raw)
    if limit:
        render.target.reserved = 0.0 if why_raw else denoiser.reserved
        render.target.started, render.target.prepared = render.target.started - spent, spent
    return final


def has_wide_filter(sensor: mi.Sensor) -> bool:
    """Tells whether the film's filter is wider than a pixel, so that the noise of neighbouring pixels is dependent."""
    return not sensor.film().rfilter().is_box_filter()


class FinalImage:
    """The denoised image of a ``render``, or its image without denoising if that has reached the error target.

    ``why_raw`` says why the image must not be denoised; it is empty if the error target decides.
    """

    def __init__(self, render: Any, denoiser: HalvesDenoiser, why_raw: str = "") -> None:
        self.render, self.denoiser, self._why_raw = render, denoiser, why_raw
        #: The latest image without denoising, its samples, and its measured error.
        self._raw: tuple[float, float | None, Denoised] | None = None

    def other_channels(self) -> dict[str, np.ndarray]:
        """Returns the channels except the colours: name -> array of shape (height, width).

        A channel is the mean of the halves so far, but "samples" is their sum, and "error" the standard error of their
        mean.
        """
        images, names, result = self.render.half_images(), self.denoiser.names, {}
        for k in range(1 if names[0] == "Y" else 3, len(names)):
            both, name = [image[..., k] for image in images], names[k]
            total = np.hypot.reduce(both) if name == "error" else np.add.reduce(both)
            result[name] = total if name == "samples" else total / len(images)
        return result

    @property
    def why_raw(self) -> str | None:
        """Why the image is not denoised, in words; None if it is denoised."""
        render = self.render
        if self._why_raw or not isinstance(render, Render):
            return self._why_raw or None
        if render.second is not None and render.target.excess(render.second.noise(render.state)) <= 1:
            reached = " and ".join(f"{limit:g}" for limit in render.target.limits if limit)
            return f"the image reached {reached} without denoising, which would have taken longer"
        return None

    def denoised(self) -> Denoised:
        """Returns the image of the samples so far, denoised unless :attr:`why_raw`. Raises RuntimeError if it must be
        denoised and has no second half.
        """
        render = self.render
        samples = mean(render.counts())
        if self.why_raw is None:
            rays = render.state.estimator.transport.rays_per_sample if isinstance(render, Render) else RAYS_PER_PATH
            return self.denoiser(render.half_images, samples, rays)
        measured = None if render.second is None else render.second.noise(render.state)[0]
        if self._raw is None or self._raw[:2] != (samples, measured):
            colours = self.denoiser.colours(render.half_images())
            # ``error`` shows where the noise is, but is too large: it is the error of independent samples of the first
            # image. ``noise`` is the measured RMS error.
            noise = render.noise_bound() if measured is None else measured
            raw = unmixed(np.add.reduce(colours) / len(colours), render.error(), noise)
            self._raw = samples, measured, raw
        return self._raw[2]

    def channels(self, colours: Sequence[str]) -> dict[str, np.ndarray]:
        """Returns the channels of the final image and of all layers: name -> array of shape (height, width).

        They are the colours of the final image, alpha and AOVs, the layers ``raw`` and ``denoised``, and the errors
        ``error.Y``, ``error_raw.Y`` and ``error_denoised.Y``. ``colours`` are names such as "RGB"; the three colours of
        a grey image are equal.
        """
        result = self.denoised()
        errors = {"": result.final_error, "_raw": result.raw_error, "_denoised": result.denoised_error}
        found = planes("", result.final, colours) | self.other_channels()
        found |= planes("raw.", result.raw, colours) | planes("denoised.", result.denoised, colours)
        return found | {f"error{name}.Y": error for name, error in errors.items()}

    def bitmap(self) -> mi.Bitmap:
        """Returns a bitmap with all :meth:`channels`."""
        return of_channels(self.channels(self.denoiser.names[: 1 if self.denoiser.names[0] == "Y" else 3]))

    def update_film(self, names: Sequence[str]) -> None:
        """Writes the colours, alpha and the :meth:`channels` with these ``names`` to the film of the sensor. Raises
        ValueError if the film stores neither RGB colours nor the luminance.
        """
        film = self.denoiser.sensor.film()
        if self.denoiser.names[0] not in ("R", "Y"):
            raise ValueError(
                f"{film.class_name()}: its colours are {', '.join(self.denoiser.names[:3])}; take pixel_format rgb, "
                "rgba, luminance or luminance_alpha to denoise"
            )
        found = self.channels("RGB")
        found["W"] = np.ones(found["R"].shape)  # the film divides by this weight
        alpha = ["A"] * bool(mi.has_flag(film.flags(), mi.FilmFlags.Alpha))
        values = np.stack([found[name] for name in (*"RGB", *alpha, "W", *names)], axis=2, dtype=np.float32)
        put(film, mi.TensorXf(values), names)
