"""An image of two halves of its samples, which is denoised in the end."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from typing import Any

import mitsuba as mi
import numpy as np

from ..denoising import halves
from ..sampling.hash import combine, hash32
from .picture import of_render
from .takes import Take


class DenoisedTake(Take):
    """A :class:`.Take` whose image is that of two halves, as :func:`.halves.halves` has them. Raises ValueError for a
    film that stores no colours.
    """

    def __init__(self, integrator: Any, scene: mi.Scene, sensor: mi.Sensor, spp: int, seed: int) -> None:
        super().__init__(integrator, scene, sensor, spp, seed)
        halves.check(sensor.film())
        self._steps = self._work()
        self._first: dict[str, np.ndarray] = {}
        self._final: dict[str, np.ndarray] = {}
        self._samples = 0.0
        self._noise: float | None = None

    def step(self, between: Callable[[], None]) -> bool:
        """Another pass of the first half, then of the second one; in the end both are denoised."""
        try:
            for shown in self._steps:
                if shown:
                    return True
                between()
        except BaseException:
            self._steps.close()
            self._render.close()
            raise
        self.done = True
        return False

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

    def _work(self) -> Generator[bool, None, None]:
        """Yields whether there is something new to see after each work item."""
        done: list[dict[str, np.ndarray]] = []
        for begin, seed in ((0.0, self.seed), (0.48, combine(hash32(self.seed), 1))):
            self._render = self.begin(seed, **halves.half(self.integrator, self.sensor, self.spp))
            for step in self._render:
                self.tell(begin + 0.48 * step.done)
                yield step.complete
            done.append(of_render(self._render))
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
        yield True


def both(first: Mapping[str, np.ndarray], second: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Two independent images together, each pixel by the samples that it has in either."""
    samples = first["samples"] + second["samples"]
    share = second["samples"] / samples
    return {
        "final": first["final"] + share[..., None] * (second["final"] - first["final"]),
        "error": np.hypot((1 - share) * first["error"], share * second["error"]),
        "samples": samples,
    }
