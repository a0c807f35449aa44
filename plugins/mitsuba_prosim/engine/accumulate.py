"""The window of a film, and the values that gather there."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from .plan import Rectangle, index_within, pixels


class Image:
    """The window of a film, as means of weighted values that bands are added to from top to bottom.

    Each pixel gathers what the samples around it have for it, row after row, so that the sum has one order, whatever
    the bands are. The values lie as a film has them, channel by channel within each pixel, so that none is copied.
    """

    def __init__(self, window: Rectangle, channels: Sequence[str], aovs: int) -> None:
        self.window, self.sampled, self.weight = window, len(channels), channels.index("W")
        self.channels = self.sampled + aovs
        self.width, self.height = window[2] - window[0], window[3] - window[1]
        self.values = dr.zeros(mi.Float, self.width * self.height * self.channels)
        dr.make_opaque(self.values)

    def add(
        self,
        outer: Rectangle,
        band: Rectangle,
        sums: list[mi.Float],
        count: mi.UInt32,
        aovs: list[mi.Float],
        reach: int,
    ) -> None:
        """Adds the pixels of ``band``. ``sums`` of ``count`` samples and ``aovs`` are laid out over the rectangle
        ``outer``.
        """
        top, bottom = max(band[1] - reach, self.window[1]), min(band[3] + reach, self.window[3])
        if top >= bottom:
            return
        x, y, *_ = pixels((self.window[0], top, self.window[2], bottom))
        index = self.channels * index_within(self.window, x, y)
        totals = [dr.gather(mi.Float, self.values, index + c) for c in range(self.sampled)]
        left, first, right, last = (dr.opaque(mi.Int32, v) for v in band)
        offsets = range(-reach, reach + 1)
        share = dr.select(count > 0, dr.rcp(mi.Float(count)), 0)
        dr.eval(share, sums, aovs)
        for dy in reversed(offsets):
            for dx in reversed(offsets):
                sx, sy = x - dx, y - dy
                there = (sx >= left) & (sx < right) & (sy >= first) & (sy < last)
                source = index_within(outer, sx, sy)
                weight = dr.gather(mi.Float, share, source, there)
                place = ((dy + reach) * (2 * reach + 1) + dx + reach) * self.sampled
                for c in range(self.sampled):
                    totals[c] += weight * dr.gather(mi.Float, sums[place + c], source, there)
        own = (y >= first) & (y < last)
        source = index_within(outer, x, y)
        dr.eval(totals)  # to scatter where the same kernel gathers would copy the image
        for c, total in enumerate(totals):
            dr.scatter(self.values, total, index + c)
        for c, aov in enumerate(aovs):
            dr.scatter(self.values, dr.gather(mi.Float, aov, source, own), index + self.sampled + c, own)

    def wait(self) -> None:
        """Waits until what was added is there."""
        dr.eval(self.values)
        dr.sync_thread()

    def planes(self) -> np.ndarray:
        """The values as they are, shape (height, width, channels)."""
        return np.array(self.values).reshape(self.height, self.width, self.channels)

    def tensor(self) -> mi.TensorXf:
        """Shape (height, width, channels), the integrator's own channels multiplied by the weight, as films expect."""
        values = self.values
        if self.channels > self.sampled:
            i = dr.arange(mi.UInt32, dr.width(values))
            channel = i % self.channels
            weight = dr.gather(mi.Float, values, i - channel + self.weight)
            values = values * dr.select(channel >= self.sampled, weight, 1)
        return mi.TensorXf(values, (self.height, self.width, self.channels))
