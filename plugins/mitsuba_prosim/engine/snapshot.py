"""What can be seen of an image while it is rendered."""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from .error import in_display_units
from .plan import index_within, pixels
from .record import Record
from .state import State


@dataclass(frozen=True)
class Reached:
    """How far an image came."""

    #: Mean number of samples of a pixel, and that of the one which has the fewest.
    samples: float
    least: int
    #: Root mean square over the pixels of the error of the displayed value, white being 1; not a number where no noise
    #: was asked for, as nobody has measured it then.
    noise: float
    #: What the error of 99 pixels in 100 is within; likewise.
    noise_99: float
    #: Since the beginning.
    seconds: float

    @classmethod
    def of(cls, state: State, seconds: float) -> Reached:
        """How far ``state`` came in so many seconds."""
        counts = np.array(state.counts())
        return cls(float(np.mean(counts, dtype=np.float64)), int(counts.min()), state.noise, state.noise_99, seconds)


@dataclass(frozen=True)
class Snapshot:
    """An image after a wave, or within one. Its methods show the state as it is when they are called."""

    state: State
    film: mi.Film
    reached: Reached

    def image(self) -> mi.TensorXf:
        """The developed image, shape (height, width, channels)."""
        put(self.state, self.film)
        return self.film.develop()

    def error(self) -> np.ndarray:
        """Standard error of the luminance of each pixel as its own samples show it, shape (height, width)."""
        return self._picture(self.state.estimate.error(self.state.plan.pass_size))

    def counts(self) -> np.ndarray:
        """Number of samples of each pixel, shape (height, width)."""
        return self._picture(self.state.estimate.count)

    def known(self) -> np.ndarray:
        """Which pixels have samples, and so have all around whose samples reach them, shape (height, width): within the
        first wave some have not.
        """
        plan, side = self.state.plan, 2 * self.state.plan.reach + 1
        (left, top, right, bottom), window = plan.region, plan.window
        taken = np.array(self.state.counts()).reshape(bottom - top, right - left) > 0
        # Beyond the domain there are none to wait for.
        above, below = plan.reach - (window[1] - top), plan.reach - (bottom - window[3])
        before, after = plan.reach - (window[0] - left), plan.reach - (right - window[2])
        taken = np.pad(taken, ((above, below), (before, after)), constant_values=True)
        return np.asarray(np.lib.stride_tricks.sliding_window_view(taken, (side, side)).all(axis=(2, 3)))

    def noise_at_most(self) -> float:
        """Root mean square of the error of the displayed pixels, white being 1, as the samples within each pixel show
        it; not a number where some have less than two.

        It is what these samples would come to if they had been drawn without a pattern, or in passes that knew nothing
        of each other. Their pattern makes the error smaller, by how much only another image can show.
        """
        state = self.state
        x, y, *_ = pixels(state.plan.region)
        estimate = replace(state.estimate, sums=[]).at(state.index(x, y))
        error = in_display_units(estimate.error(state.plan.pass_size), estimate.total / mi.Float(estimate.count))
        values = np.array(error, dtype=np.float64)
        result = float(np.sqrt(np.mean(values**2))) * state.estimator.smoothing
        return result if int(dr.min(estimate.count)[0]) > 1 and np.isfinite(result) else float("nan")

    def record(self) -> Record:
        """What a process that goes on with it has to know."""
        return Record.of(self.state, self.reached.seconds)

    def _picture(self, values: mi.Float) -> np.ndarray:
        outer, window = self.state.outer, self.state.plan.window
        if outer != window:
            x, y, *_ = pixels(window)
            values = dr.gather(type(values), values, index_within(outer, x, y))
        return np.array(values).reshape(window[3] - window[1], window[2] - window[0])


def put(state: State, film: mi.Film) -> None:
    """Makes the image of ``state`` what ``film`` holds."""
    image = state.image()
    film.prepare(state.aov_names)  # another image on this film may have had others meanwhile
    film.put_block(mi.ImageBlock(image.tensor(), mi.ScalarPoint2i(image.window[:2]), border=False))
