"""Wavelengths that divide the spectrum evenly among samples."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from .hash import GOLDEN
from .nrook import to_unit


def shared(key: mi.UInt32, t: mi.UInt32, n: mi.UInt32) -> mi.Float:
    """The number in [0, 1) that the wavelengths of the ``t``-th samples of all pixels are drawn by, and those of their
    photons, under the ``key`` of an image.

    Mitsuba draws four wavelengths a quarter apart. The ``n`` numbers of a pass divide that quarter into equal parts,
    pass after pass at another place (which turns by the golden ratio): as all pixels have the same wavelengths, the
    image would else be tinted.
    """
    r = t // n
    return to_unit(key + (t - r * n) * (dr.opaque(mi.UInt32, 1 << 30) // n) + r * GOLDEN // (4 * n))
