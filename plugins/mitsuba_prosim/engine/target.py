"""When an image is good enough: noise that is small enough, or time that has passed."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import drjit as dr
import numpy as np

from .plan import Plan
from .state import State

#: Seconds between two looks at whether to stop; where the samples are slower than those before, it is more.
STEP = 0.5


@dataclass(frozen=True)
class Target:
    """When an image is good enough. ``noise``: root mean square over the pixels of the error of the displayed value,
    white being 1; ``noise_99``: what that of 99 pixels in 100 is within; ``seconds`` from the beginning. 0: not asked
    for. Both of the noise that are asked for, or the time, whichever comes first, end it.
    """

    noise: float = 0.0
    seconds: float = 0.0
    begun: float = field(default_factory=time.perf_counter)
    noise_99: float = 0.0

    @classmethod
    def of(cls, plan: Plan, passed: float) -> Target:
        """What ``plan`` asks for; ``passed``: seconds since the beginning."""
        sampling = plan.sampling
        return cls(sampling.noise, sampling.time, time.perf_counter() - passed, sampling.noise_99)

    def __bool__(self) -> bool:
        return self.noisy or self.seconds > 0

    @property
    def noisy(self) -> bool:
        """Whether it is a noise that is asked for."""
        return self.noise > 0 or self.noise_99 > 0

    def excess(self, state: State) -> float:
        """How many times what was asked for the noise of ``state`` is, as measured last; the worse of the two."""
        asked = ((state.noise, self.noise), (state.noise_99, self.noise_99))
        return min(max((measured / most for measured, most in asked if most), default=np.nan), 1e100)

    def work(self, state: State, aim: float = 1.0) -> float:
        """How many times its samples ``state`` takes until the noise is ``aim`` times the one asked for: the work grows
        with the inverse square of the noise.
        """
        return (self.excess(state) / aim) ** 2

    @property
    def passed(self) -> float:
        """Seconds since the beginning."""
        return time.perf_counter() - self.begun

    @property
    def left(self) -> float:
        """Seconds until the end."""
        return self.seconds - self.passed if self.seconds else np.inf

    @property
    def over(self) -> bool:
        """Whether the time is up."""
        return self.left <= self.seconds / 100

    def portion(self, state: State, speed: float) -> int:
        """Samples of a portion that ends soon enough to look at whether to stop, where a pixel gets ``speed`` samples
        in a second.
        """
        step = min(STEP, self.seconds / 100) if self.seconds else STEP
        return max(1, int(speed * dr.width(state.estimate.count) * step))
