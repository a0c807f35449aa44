"""An image of two halves of its samples, which is denoised in the end."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from typing import Any

import mitsuba as mi
import numpy as np

from ..denoising import halves
from ..rendering.waves import part
from ..sampling.hash import combine, hash32
from .picture import of_snapshot
from .takes import Take


class DenoisedTake(Take):
    """A :class:`.Take` whose image is that of two halves, as :func:`.halves.halves` has them. Raises ValueError for a
    film that stores no colours.
    """

    def __init__(self, integrator: Any, scene: mi.Scene, sensor: mi.Sensor, spp: int, seed: int) -> None:
        super().__init__(integrator, scene, sensor, spp, seed)
        halves.check(sensor.film())
        self._steps: Iterator[None] | None = None
        self._between: Callable[[float], None] | None = None
        self._now: dict[str, np.ndarray] = {}
        self._noise: float | None = None

    def step(self, between: Callable[[float], None]) -> bool:
        """Another wave of the first half, then of the second one; in the end both are denoised."""
        self._between = between
        self._steps = self._steps or self._work()
        self.done = next(self._steps, self) is self
        return not self.done

    def layers(self) -> Mapping[str, np.ndarray]:
        """As for every take; in the end also ``raw`` and ``denoised``, of which the final one is mixed."""
        return self._now

    def reached(self) -> tuple[float, float | None]:
        """Samples of a pixel in the mean, and about the noise, once it is denoised."""
        return float(self._now["samples"].mean()), self._noise

    def _work(self) -> Iterator[None]:
        done: list[dict[str, np.ndarray]] = []
        for begin, seed in ((0.0, self.seed), (0.48, combine(hash32(self.seed), 1))):
            now: dict[str, np.ndarray] = {}
            for snapshot in self._half(seed, begin):
                now = of_snapshot(snapshot)
                self._now = both(done[0], now) if done else now
                yield
            done.append(now)
        albedo, normal = halves.features(
            self.scene, self.sensor, self.seed, getattr(self.integrator, "hide_emitters", False)
        )
        result = halves.Halves(["R", "G", "B"], done[0]["final"], done[1]["final"], albedo, normal).denoised()
        self._now |= {
            "final": result.final,
            "error": result.final_error,
            "raw": result.raw,
            "denoised": result.denoised,
        }
        self._noise = result.noise(result.final_error)
        yield

    def _half(self, seed: int, begin: float) -> Iterator[Any]:
        """The waves of a half. How it samples is asked of the integrator when it begins, and only then."""
        with ExitStack() as stack:
            _, spp = stack.enter_context(halves.halved(self.integrator, self.sensor, self.spp))
            waves = self.integrator.waves(self.scene, self.sensor, seed, spp)
            while True:
                self.integrator.progress = part(self._between, begin, begin + 0.48)
                try:
                    snapshot = next(waves, None)
                finally:
                    self.integrator.progress = None
                    stack.close()
                if snapshot is None:
                    return
                yield snapshot


def both(first: Mapping[str, np.ndarray], second: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Two independent images together, each pixel by the samples that it has in either."""
    samples = first["samples"] + second["samples"]
    share = second["samples"] / samples
    return {
        "final": first["final"] + share[..., None] * (second["final"] - first["final"]),
        "error": np.hypot((1 - share) * first["error"], share * second["error"]),
        "samples": samples,
    }
