"""Gradient noise from an integer hash, as a pure function."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi

from ..sampling.hash import combine


def gradient_noise(coordinates: Sequence[mi.Float], key: mi.UInt32) -> mi.Float:
    """Gradient noise on the integer lattice of as many dimensions as there are ``coordinates``; zero on its points.

    ``key`` is a 32-bit unsigned integer. The components of the gradients are uniform over [-1, 1].
    """
    corners: list[tuple] = [(key, mi.Float(1), ())]  # hash, weight of the interpolation, offset from the corner
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
