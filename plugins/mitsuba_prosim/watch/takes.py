"""Images of one scene that grow side by side: its own, and that of Mitsuba's path tracer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from math import isnan
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compare.scenes import can_light, seen_by, sky
from ..engine.work import Local, samples_of_a_second
from ..registry import create
from ..transport.dispersion import disperses
from .picture import of_render, over

#: Seconds that a work item takes, about; and into how many a second is cut where the time must have no say.
SECONDS, STEPS = 0.25, 4


class Take:
    """An image that grows. ``spp``: samples per pixel, 0 for those of the integrator."""

    def __init__(self, integrator: Any, scene: mi.Scene, sensor: mi.Sensor, spp: int, seed: int) -> None:
        self.integrator = integrator
        self.sampling = integrator.sampling
        if integrator.sampler is not None:
            # It is seeded for each work item, so that these must not depend on the time.
            band = max(2**10, samples_of_a_second() // STEPS // (spp or integrator.samples**2))
            self.sampling = replace(self.sampling, band=band)
        self.done = False
        self.scene, self.sensor, self.spp, self.seed = scene, sensor, spp, seed
        self._render: Any = None
        self._coarse: np.ndarray | None = None
        self._part = 0.0

    @property
    def part(self) -> float:
        """The part that is done, 0 to 1. It never falls: an estimate that has become worse is not shown."""
        return 1.0 if self.done else self._part

    def step(self, between: Callable[[], None]) -> bool:
        """Another pass; returns whether there was one. ``between``: called between work items; what it raises ends the
        image.
        """
        if self._render is None:
            self._render = self.begin(self.seed, sampling=self.sampling)
        try:
            for step in self._render:
                self.tell(step.done)
                if step.complete:
                    return True
                between()
        except BaseException:
            self._render.close()
            raise
        self.done = True
        return False

    def tell(self, part: float) -> None:
        """Notes the part that is done, as far as the integrator knows."""
        self._part = max(self._part, part)

    def begin(self, seed: int, **how: Any) -> Any:
        """A render that takes its samples in short work items."""
        executor = None if self.integrator.sampler is not None else Local(SECONDS)
        return self.integrator.progressive(
            self.scene, self.sensor, seed, how.pop("spp", self.spp), executor=executor, **how
        )

    def layers(self) -> Mapping[str, np.ndarray] | None:
        """What there is to see after a wave, or between two portions of one, as :class:`.Picture` has it. Within the
        first wave there is no more than ``final``, which is that of :meth:`coarse`, or black, where it has no samples
        yet. None where within a wave there is nothing new to see.
        """
        now = self.taken()
        if now is None:
            return None
        known = now["samples"] > 0
        return now if known.all() else {"final": over(known, now["final"], self._coarse)}

    def taken(self) -> dict[str, np.ndarray] | None:
        """What has been taken, as :func:`.of_render` has it; None where there is nothing new."""
        return None if self._render is None or not self._render.current else of_render(self._render)

    @property
    def last(self) -> Any:
        """How far it came, as :class:`.Reached`; None before it has begun."""
        return None if self._render is None else self._render.reached

    def reached(self) -> tuple[float, float | None]:
        """Samples of a pixel in the mean, and the noise where it is measured."""
        return self.last.samples, None if isnan(self.last.noise) else self.last.noise

    def coarse(self) -> np.ndarray:
        """The colours of one sample of each pixel, while the film has few; to be seen before there are others. Behind
        glass that disperses a sample has one colour, so that a pixel has a row of a pattern with as many as there are.
        """
        each = dr.size_v(mi.Spectrum) if disperses(self.scene) else 1
        render = self.integrator.progressive(self.scene, self.sensor, self.seed, each**2)
        next(step for step in render if step.complete)
        self._coarse = of_render(render)["final"]
        return self._coarse


def in_waves(integrator: Any, sensor: mi.Sensor, spp: int) -> tuple[Any, int]:
    """``integrator``, within ``prosim_adaptive`` if it knows no waves, and its samples per pixel."""
    from ..engine.integrator import ProgressiveIntegrator

    if isinstance(integrator, ProgressiveIntegrator):
        return integrator, spp
    within = create("prosim_adaptive", nested=integrator, adaptive="none")
    return within, spp or sensor.sampler().sample_count()


def name(integrator: Any) -> str:
    """What the image of a take is rendered by, in a word."""
    integrator = getattr(integrator, "nested", integrator)
    if hasattr(integrator, "parameter_names"):  # one of ours
        return str(integrator.name())
    return str(integrator.class_name()).removesuffix("Integrator").lower()


def alone(integrator: Any) -> str | None:
    """Why an image can't be compared with that of ``path``, if it can't."""
    if name(integrator) == "path":
        return "this is the path tracer already"
    if not can_light(getattr(integrator, "background", None)):
        return "path can't be lit by this background, which is no bitmap"
    return None


def rival(own: Take) -> Take:
    """The image of Mitsuba's ``path``, sampled as ``own`` is, and lit by its background, which is no source to
    ``prosim``. It may be begun, and grow, while ``own`` is between two work items.
    """
    path = create("prosim_adaptive", nested=create("path"), channels=own.integrator.channels, **asdict(own.sampling))
    scene, background = own.scene, getattr(own.integrator, "background", None)
    if background is not None:
        scene = seen_by(own.sensor, scene, background=sky(background))
    return Take(path, scene, own.sensor, own.spp, own.seed)
