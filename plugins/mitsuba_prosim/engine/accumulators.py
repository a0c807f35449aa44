"""The sums over the samples of each pixel (thesis, section 5.3.2)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compat import double, dr_array

#: Maximum brightness of a sample in the estimated error, so that the squares of N² samples are finite. Sums of 64 bits
#: allow its square.
BRIGHTEST = 1e16

#: Minimum absolute value of a sample in the image. A darker value counts as black, so that no value of the image is a
#: denormal number: some processors and threads round these to zero.
DARKEST = 1e-30


@dataclass
class Accumulators:
    """Sums over the first ``count`` samples of each pixel, as Dr.Jit arrays with one entry per pixel.

    The samples of a pixel are always added in the order of their sample numbers, even if the render is interrupted and
    continued. Because samples are added in a fixed order, the bits of a pixel's sums depend only on the number of its
    samples, not on interruptions.

    The sums have 64 bits (:func:`.compat.double`). In a sum of 32 bits, the rounding errors of a million equal samples
    add up to one percent.
    """

    #: Sums of the film's values, weighted by the filter, for every pixel within the filter's reach, row by row, channel
    #: by channel: one array with the sums of a pixel side by side, because a processor reads and writes adjacent
    #: numbers together. New sums, which an image does not store yet, are a list of arrays.
    sums: Any
    #: Sum of the luminance; sum of its square; sum of the squared mean luminance of each complete pass.
    total: mi.Float64
    squares: mi.Float64
    pass_squares: mi.Float64
    #: Sum of the luminance over the current pass.
    in_pass: mi.Float64
    #: Number of samples, and of those that are infinite or NaN, which count as black.
    count: mi.UInt32
    lost: mi.UInt32

    @classmethod
    def empty(cls, sums_per_pixel: int, pixels: int) -> Accumulators:
        """Returns accumulators without samples, with ``sums_per_pixel`` sums for each pixel of an image."""
        sums = dr.zeros(double(), pixels * sums_per_pixel)
        total, squares, pass_squares, in_pass = (dr.zeros(double(), pixels) for _ in range(4))
        return cls(sums, total, squares, pass_squares, in_pass, *(dr.zeros(mi.UInt32, pixels) for _ in range(2)))

    @classmethod
    def of_arrays(cls, named: Mapping[str, np.ndarray]) -> Accumulators:
        """Returns the accumulators of an image from the NumPy arrays ``named``: the inverse of :meth:`arrays`."""
        sums = [named[f"sum{k}"] for k in range(sum(name.startswith("sum") for name in named))]
        return cls(dr_array(np.stack(sums, axis=1)), *(dr_array(named[f.name]) for f in fields(cls)[1:]))

    def arrays(self, own: slice) -> dict[str, np.ndarray]:
        """Returns the accumulators of the pixels ``own`` of an image as NumPy arrays by name: name -> array."""
        named = {f.name: np.array(getattr(self, f.name))[own] for f in fields(self)[1:]}
        columns = np.array(self.sums).reshape(len(self.count), -1)[own].T
        return named | {f"sum{k}": values for k, values in enumerate(columns)}

    @property
    def others(self) -> tuple[mi.Float64, mi.Float64, mi.Float64, mi.Float64, mi.UInt32, mi.UInt32]:
        """All attributes but ``sums``."""
        return self.total, self.squares, self.pass_squares, self.in_pass, self.count, self.lost

    def film_sums(
        self, pixel: mi.UInt32, place: int | mi.UInt32, channels: int, active: mi.Bool = True
    ) -> list[mi.Float64]:
        """Returns the sums of the ``channels`` of the neighbour number ``place`` of each ``pixel`` of an image.

        The sums are 0 for pixels that are not ``active``.
        """
        index = pixel * (len(self.sums) // len(self.count) // channels) + place
        return list(dr.gather(packets(), self.sums, index, active, shape=(channels, len(index))))

    def of(self, pixel: mi.UInt32) -> Accumulators:
        """Returns the accumulators of some pixels of an image."""
        number = len(self.sums) // len(self.count)
        lane = dr.arange(mi.UInt32, number * len(pixel))
        index = dr.gather(mi.UInt32, pixel, lane // number) * number + lane % number
        return Accumulators(dr.gather(double(), self.sums, index), *dr.gather(tuple, self.others, pixel))

    def store(self, pixel: mi.UInt32, values: Accumulators) -> None:
        """Replaces the accumulators of some pixels of an image by ``values``, the result of
        :meth:`.Estimator.accumulate`.
        """
        rows = len(values.count) // len(pixel)
        lane = dr.arange(mi.UInt32, len(values.count))
        row, pixel = lane % rows, dr.gather(mi.UInt32, pixel, lane // rows)
        dr.scatter(self.sums, packets()(values.sums), pixel * rows + row, mode=dr.ReduceMode.NoConflicts)
        for mine, new in zip(self.others, values.others):
            dr.scatter(mine, new, pixel, row == 0, mode=dr.ReduceMode.NoConflicts)
        dr.eval(self)


def packets() -> Any:
    """Returns the type of Dr.Jit arrays that have several 64-bit floats (:func:`.compat.double`) in each entry."""
    return dr.replace_type_t(mi.ArrayXf, dr.type_v(double()))
