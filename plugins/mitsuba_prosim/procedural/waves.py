"""A periodic function of one variable, averaged over a box."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

#: Edges are never sharper than this, in periods: less would drown in single precision, and have no derivative.
SHARPEST = 1e-3


def square_wave(x: mi.Float, duty: mi.Float, width: mi.Float) -> mi.Float:
    """The wave of period 1 that is 1 for |x| <= duty / 2 and 0 elsewhere, averaged over a box of ``width`` around x."""
    width = dr.maximum(width, SHARPEST)
    x = x + 0.5
    x -= dr.floor(x)
    low = 0.5 - duty / 2

    def integral(x: mi.Float) -> mi.Float:
        whole = dr.floor(x)
        return whole * duty + dr.clip(x - whole - low, 0, duty)

    # A box narrower than a band and than a gap meets one edge at most; then nothing is lost to rounding.
    narrow = dr.clip((duty / 2 - dr.abs(x - 0.5)) / width + 0.5, 0, 1)
    wide = dr.clip((integral(x + width / 2) - integral(x - width / 2)) / width, 0, 1)
    return dr.select(width < dr.minimum(duty, 1 - duty), narrow, wide)
