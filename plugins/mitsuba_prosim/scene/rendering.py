"""Starts a progressive render, also with an integrator that can only render a whole image at once."""

from __future__ import annotations

import re
from collections.abc import Generator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compat import denormals_rounded, description, is_users
from ..engine.work import Step, Steps
from ..optics.nested import all_flags, all_shapes
from ..parameters import check_samples
from ..registry import create
from ..sampling.hash import combine, hash32
from .overrides import FROM_LAMPS


def is_progressive(integrator: mi.Integrator) -> bool:
    """Tells whether an integrator renders progressively: ``prosim`` and ``prosim_adaptive``, not in scalar variants."""
    return hasattr(integrator, "progressive") and dr.is_jit_v(mi.Float)


def is_denoised(integrator: mi.Integrator) -> bool:
    """Tells whether ``integrator`` is ``prosim_denoised``, which denoises the image of the integrator in it."""
    return getattr(integrator, "name", "") == "prosim_denoised"


def with_targets(integrator: mi.Integrator, scene: mi.Scene) -> Any:
    """Returns a progressive integrator that gives the same image of ``scene``: ``integrator`` itself if it is
    progressive, ``prosim`` in place of ``path`` as in :func:`.overrides.apply`, else ``prosim_adaptive`` around it.
    """
    if is_progressive(integrator):
        return integrator
    limits = re.fullmatch(r"PathIntegrator\[\s*max_depth = (\d+),\s*rr_depth = (\d+)\s*\]", description(integrator))
    if not isinstance(integrator, mi.SamplingIntegrator):
        raise ValueError(FROM_LAMPS.format(description(integrator).partition("[")[0]))
    if limits is None:
        return create("prosim_adaptive", nested=integrator)
    media = [shape for shape in all_shapes(scene) if shape.is_medium_transition()]
    media += [sensor for sensor in scene.sensors() if sensor.get_medium() is not None]
    hides, depth = integrator.hide_emitters, int(limits[1])
    if depth < 2 or media or (hides and all_flags(scene) & int(mi.BSDFFlags.Null)):
        return create("prosim_adaptive", nested=integrator)
    # A path of max_depth 2 has one reflection, as has level 0. Without a limit, Mitsuba's max_depth is 2^32 - 1.
    level = depth - 2 if depth < 2**31 else -1
    return create("prosim", diffuse_bounces=-1, max_level=level, rr_depth=int(limits[2]), hide_emitters=hides)


def require_progressive(integrator: mi.Integrator, what: str) -> None:
    """Raises ValueError if an integrator does not render progressively, as ``what``, an option or a function, needs."""
    if not is_progressive(integrator):
        raise ValueError(
            f"{what} needs prosim or prosim_adaptive, in all but scalar variants; this scene's integrator is "
            f"{description(integrator).partition('[')[0]}. Give the parameter noise (--noise 0.01, in Python "
            'integrator={"noise": 0.01}), or adaptive (--adaptive none --samples 8), for example: one of them then '
            "takes its place."
        )


def progressive(scene: mi.Scene, sensor: mi.Sensor, integrator: Any, seed: int = 0, spp: int = 0, **how: Any) -> Any:
    """Returns a new render, an iterator over its steps: a :class:`.Render`, or a :class:`Blocking` if
    :func:`is_progressive` is false.

    ``spp`` is the number of samples of each pixel; 0 stands for the number in the scene. ``how`` are further arguments
    for the integrator's method ``progressive``, of which :class:`Blocking` uses only ``measure``. Raises ValueError if
    not each pixel can get exactly ``spp`` samples.
    """
    in_halves = how.get("measure") is not None
    if spp > 0 and (taken := samples_taken(integrator, sensor, spp, 1 + in_halves)) != spp:
        why = "a denoised image has two halves" if spp % 2 and in_halves else "the scene's sampler rounds the number up"
        raise ValueError(f"each pixel can't get exactly {spp} samples (--spp, in Python spp), as {why}; take {taken}")
    if not is_progressive(integrator):
        return Blocking(integrator, scene, sensor, seed, spp, in_halves)
    return integrator.progressive(scene, sensor, seed, spp, **how)


def samples_taken(integrator: mi.Integrator, sensor: mi.Sensor, spp: int, images: int = 1) -> int:
    """Returns the number of samples that a pixel gets in all ``images``, of which each takes an equal part of the
    requested ``spp``. The sensor's sampler, which progressive integrators do not use, may round this part up.
    """
    each = -(-spp // images)
    if not is_progressive(integrator) and not is_denoised(integrator):  # which counts itself
        sampler = sensor.sampler().clone()
        sampler.set_sample_count(each)
        each = int(sampler.sample_count())
    return images * each


def with_all_channels(integrator: mi.Integrator, image: Any, film: mi.Film) -> mi.TensorXf:
    """Returns the ``image`` that ``render()`` has returned, or that of ``film``, which has all channels, where ``aov``
    returns the first ones. Warns if the class of a user has returned something else.
    """
    stored = film.develop()
    shape = tuple(getattr(image, "shape", ()))
    if shape == stored.shape:
        return image
    shown = shape[:2] == stored.shape[:2] and np.array_equal(image, np.array(stored)[..., : shape[-1]], equal_nan=True)
    if is_users(integrator) and not shown:
        mi.Log(
            mi.LogLevel.Warn,
            f"render() of {description(integrator).partition('[')[0]} returns {shape or type(image).__name__}, but the "
            f"film's image has the shape {stored.shape}; the film's image is used.",
        )
    return stored


class Blocking(Steps):
    """Renders a whole image in one :class:`.Step`, with an integrator that does not render progressively, but with the
    interface of :class:`.Render`.

    ``spp`` is the number of samples per pixel; 0 means that of the sensor's sampler. If ``in_halves`` is true, two
    independent images are rendered in two steps, each with half of the samples, rounded up.
    """

    #: A progressive :class:`.Render` may have a second image and measured errors; this class has neither.
    second = reached = None

    def __init__(
        self, integrator: Any, scene: mi.Scene, sensor: mi.Sensor, seed: int, spp: int, in_halves: bool = False
    ) -> None:
        self._in_halves, self._sensor, self._spp = in_halves, sensor, check_samples(sensor, spp)
        self._images: list[mi.TensorXf] = []
        super().__init__(self._render(integrator, scene, seed))
        self.close = self._steps.close  # no further image is rendered

    def _render(self, integrator: Any, scene: mi.Scene, seed: int) -> Generator[Step, None, None]:
        seeds, sensor = [seed], self._sensor
        if self._in_halves:
            self._spp = ((self._spp or sensor.sampler().sample_count()) + 1) // 2
            # The second seed is not a neighbour of the first seed, which may be the seed of another image.
            seeds.append(combine(hash32(seed), 1))
        for number, seed in enumerate(seeds, 1):
            with denormals_rounded():
                image = integrator.render(scene, sensor, seed=seed, spp=self._spp)
                self._images.append(with_all_channels(integrator, image, sensor.film()))
                dr.sync_thread()
            yield Step(number / len(seeds), number == len(seeds))

    def half_images(self) -> list[np.ndarray]:
        """Returns the developed images so far, shape (height, width, channels): at most one, or two in halves."""
        return [np.array(image) for image in self._images]

    def counts(self) -> np.ndarray:
        """Returns the number of samples of each pixel so far, shape (height, width), as the sampler has rounded it."""
        sampler = self._sensor.sampler().clone()
        sampler.set_sample_count(self._spp or sampler.sample_count())
        width, height = self._sensor.film().crop_size()
        return np.full((height, width), sampler.sample_count() * len(self._images))

    def update_film(self) -> None:
        """Does nothing, because Mitsuba has already stored the image in the film."""
