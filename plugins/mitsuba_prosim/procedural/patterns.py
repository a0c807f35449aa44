"""Functions that form patterns: gradient noise from an integer hash, and a periodic wave averaged over a box."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi

from ..sampling.hash import combine

#: Minimum width of an edge, in periods. A narrower edge would be below single precision, and have no derivative.
SHARPEST = 1e-3


def square_wave(x: mi.Float, duty: mi.Float, width: mi.Float) -> mi.Float:
    """Returns a square wave of period 1, averaged over a box of ``width`` (at least :data:`SHARPEST`) around x. In the
    period |x| <= 1/2, the wave is 1 for |x| <= ``duty`` / 2, and 0 elsewhere.
    """
    width = dr.maximum(width, SHARPEST)
    x = x + 0.5  # from here on, the band with the value 1 is in the middle of the period [0, 1)
    x -= dr.floor(x)
    low = 0.5 - duty / 2

    def integral(x: mi.Float) -> mi.Float:
        """Returns the integral from 0 to ``x`` of the wave."""
        whole = dr.floor(x)
        return whole * duty + dr.clip(x - whole - low, 0, duty)

    # A box that is narrower than a band and than the gap between two bands contains at most one edge. This formula has
    # no rounding error.
    narrow = dr.clip((duty / 2 - dr.abs(x - 0.5)) / width + 0.5, 0, 1)
    wide = dr.clip((integral(x + width / 2) - integral(x - width / 2)) / width, 0, 1)
    return dr.select(width < dr.minimum(duty, 1 - duty), narrow, wide)


def gradient_noise(coordinates: Sequence[mi.Float], key: mi.UInt32) -> mi.Float:
    """Returns gradient noise (Perlin noise) on the integer lattice, at whose points it is 0.

    The lattice has one dimension for each of the ``coordinates``, at most three. ``key`` is the seed of the hash. The
    components of the random gradients are uniform over [-1, 1].
    """
    corners: list[tuple] = [(key, mi.Float(1), ())]  # hash, interpolation weight, and offset from the corner
    for x in coordinates:
        cell = dr.floor(x)
        f = x - cell
        cell = mi.UInt32(mi.Int32(cell))
        fade = f * f * f * (f * (f * 6 - 15) + 10)
        corners = [
            (combine(hashed, cell + side), weight * (fade if side else 1 - fade), (*offset, f - side))
            for hashed, weight, offset in corners
            for side in (0, 1)
        ]
    total = mi.Float(0)
    for hashed, weight, offset in corners:
        gradients = (((hashed >> 10 * axis) & 1023) for axis in range(len(offset)))
        total += weight * sum((mi.Float(g) / 511.5 - 1) * d for g, d in zip(gradients, offset, strict=True))
    return total
