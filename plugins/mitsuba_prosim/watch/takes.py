"""Images of one scene that grow side by side: its own, and that of Mitsuba's path tracer."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from math import isnan
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compare.scenes import can_light, seen_by, sky
from ..engine.plan import SAMPLING
from ..engine.snapshot import Snapshot
from ..registry import create
from ..scene import rendering
from ..transport.dispersion import disperses
from .picture import of_snapshot, over
from .portions import Growing

#: Into how many parts a step of about a second is cut where portions can't be measured.
STEPS = 4


class Take:
    """An image that grows. ``spp``: samples per pixel, 0 for those of the integrator."""

    def __init__(self, integrator: Any, scene: mi.Scene, sensor: mi.Sensor, spp: int, seed: int) -> None:
        self.integrator = integrator
        if integrator.sampler is None:
            integrator.taker = Growing()
        else:  # it is seeded anew for each portion, so that these have to be the same each time
            per_pixel = spp or integrator.samples**2
            integrator.band = max(2**10, rendering.samples_of_a_step() // STEPS // per_pixel)
        #: How it samples; what makes halves of it changes that of the integrator for a while.
        self.sampling = {name: getattr(integrator, name) for name in (*SAMPLING, "channels")}
        self.done = False
        self.scene, self.sensor, self.spp, self.seed = scene, sensor, spp, seed
        self._waves: Iterator[Snapshot] | None = None
        self._snapshot: Snapshot | None = None  # after a wave
        self._coarse: np.ndarray | None = None
        self._part = 0.0
        self._between: Callable[[], None] | None = None

    @property
    def part(self) -> float:
        """The part that is done, 0 to 1. It never falls: an estimate that has become worse is not shown."""
        return 1.0 if self.done else self._part

    def step(self, between: Callable[[], None]) -> bool:
        """Another wave; returns whether there was one. ``between``: called between portions; what it raises ends the
        image.
        """
        self._between = between
        self.integrator.progress = self.tell
        if self._waves is None:
            self._waves = self.integrator.waves(self.scene, self.sensor, self.seed, self.spp)
        self._snapshot = None
        try:
            self._snapshot = next(self._waves, None)
        finally:
            self.integrator.progress = None
        self.done = self._snapshot is None
        return not self.done

    def tell(self, part: float) -> None:
        """Is called between portions with the part that is done, as far as the integrator knows."""
        self._part = max(self._part, part)
        if self._between is not None:
            self._between()

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
        """What has been taken, as :func:`.of_snapshot` has it; None where there is nothing new."""
        snapshot = self._snapshot or self.integrator.so_far()
        return None if snapshot is None else of_snapshot(snapshot)

    def reached(self) -> tuple[float, float | None]:
        """Samples of a pixel in the mean, and the noise where it is measured."""
        reached = self.integrator.reached
        return reached.samples, None if isnan(reached.noise) else reached.noise

    def coarse(self) -> np.ndarray:
        """The colours of one sample of each pixel, while the film has few; to be seen before there are others. Behind
        glass that disperses a sample has one colour, so that a pixel has a row of a pattern with as many as there are.
        """
        each = dr.size_v(mi.Spectrum) if disperses(self.scene) else 1
        taker, self.integrator.taker = self.integrator.taker, None  # so few samples say nothing of their speed
        try:
            snapshot = next(self.integrator.waves(self.scene, self.sensor, self.seed, each**2))
            self._coarse = of_snapshot(snapshot)["final"]
            return self._coarse
        finally:
            self.integrator.taker = taker


def in_waves(integrator: Any, sensor: mi.Sensor, spp: int) -> tuple[Any, int]:
    """``integrator``, within ``prosim_adaptive`` if it knows no waves, and its samples per pixel."""
    from ..engine.integrator import WaveIntegrator

    if isinstance(integrator, WaveIntegrator):
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
    ``prosim``. It may be begun, and grow, while ``own`` is between two portions, unless there is a crop window.
    """
    path = create("prosim_adaptive", nested=create("path"), **own.sampling)
    scene, background = own.scene, getattr(own.integrator, "background", None)
    if background is not None:
        scene = seen_by(own.sensor, scene, background=sky(background))
    return Take(path, scene, own.sensor, own.spp, own.seed)
