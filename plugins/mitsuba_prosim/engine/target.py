"""When an image is good enough: noise that is small enough, or time that has passed."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import drjit as dr
import mitsuba as mi
import numpy as np

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


def first_in_time(
    target: Target, state: State, wanted: mi.UInt32, tell: Callable[[float], None] | None, cancelled: Callable[[], bool]
) -> bool:
    """A first wave that the time can cut short: sample by sample, as after one of them there is an image.

    Returns whether it got to its end.
    """
    most = int(dr.max(wanted)[0])
    for count in range(1, most + 1):
        start = time.perf_counter()
        soon = dr.minimum(wanted, dr.opaque(mi.UInt32, count))
        if not state.grow(soon, None, None, cancelled if count == 1 else lambda: cancelled() or target.over):
            return False
        passed = (0.1 if count == 1 else 1) * (time.perf_counter() - start)  # the first had to compile
        state.portion = target.portion(state, 1 / max(passed, 1e-9))
        if tell is not None:
            tell(count / most)
    return True
