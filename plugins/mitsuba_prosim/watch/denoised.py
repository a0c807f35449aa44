"""An image of two halves of its samples, which is denoised in the end."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from typing import Any

import mitsuba as mi
import numpy as np

from ..denoising import halves
from ..engine.waves import part
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
        self._first: dict[str, np.ndarray] = {}
        self._final: dict[str, np.ndarray] = {}
        self._samples = 0.0
        self._noise: float | None = None

    def step(self, between: Callable[[], None]) -> bool:
        """Another wave of the first half, then of the second one; in the end both are denoised."""
        self._between = between
        self._steps = self._steps or self._work()
        self.done = next(self._steps, self) is self
        return not self.done

    def taken(self) -> dict[str, np.ndarray] | None:
        """By both halves; in the end also ``raw`` and ``denoised``, of which the final one is mixed."""
        if self._final:
            return self._final
        now = super().taken()
        if now is not None and self._first:
            now = both(self._first, now)
        if now is not None:
            self._samples = float(now["samples"].mean())
        return now

    def reached(self) -> tuple[float, float | None]:
        """Samples of a pixel in the mean, and about the noise, once it is denoised."""
        return self._samples, self._noise

    def _work(self) -> Iterator[None]:
        done: list[dict[str, np.ndarray]] = []
        for begin, seed in ((0.0, self.seed), (0.48, combine(hash32(self.seed), 1))):
            for snapshot in self._half(seed, begin):
                self._snapshot = snapshot
                yield
                self._snapshot = None
            done.append(of_snapshot(snapshot))
            self._first = done[0]
        albedo, normal = halves.features(
            self.scene, self.sensor, self.seed, getattr(self.integrator, "hide_emitters", False)
        )
        result = halves.Halves(["R", "G", "B"], done[0]["final"], done[1]["final"], albedo, normal).denoised()
        self._final = both(*done) | {
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
                self.integrator.progress = part(self.tell, begin, begin + 0.48)
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
