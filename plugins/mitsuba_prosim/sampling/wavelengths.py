"""Wavelengths that divide the spectrum evenly among samples, and the choice of one wavelength at dispersive glass.

Mitsuba samples four wavelengths that are a quarter of the spectrum apart, so one number determines all four
wavelengths: the position within a quarter. Behind dispersive glass a ray keeps only one of the four wavelengths. The
samples of a pixel together cover the whole spectrum if they keep each of the four wavelengths equally often, for each
part of a quarter.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from .hash import GOLDEN, combine
from .nrook import to_unit


def wavelength_number(key: mi.UInt32, t: mi.UInt32, n: int | mi.UInt32) -> mi.Float:
    """Returns the number in [0, 1) that determines the wavelengths of the ``t``-th sample under ``key``.

    ``key`` is the hash key of a pixel, or the hash key of the image if all pixels and photons share wavelengths. The
    ``n`` numbers of a pass divide a quarter of the spectrum into equal parts. The numbers of different passes are
    shifted by the golden ratio. A shifted lattice of wavelengths is nearly exact for smooth spectra (Cranley and
    Patterson 1976).
    """
    r = t // n
    return to_unit(key + (t - r * n) * (dr.opaque(mi.UInt32, 1 << 30) // n) + r * GOLDEN // (4 * n))


def wavelength_choice(key: mi.UInt32, t: mi.UInt32, n: int | mi.UInt32, rest: mi.Float) -> mi.Float:
    """Returns the number in [0, 1) by which the ``t``-th sample of a pixel chooses one of four wavelengths.

    The function :func:`wavelength_number`, with the same ``n``, has sampled the four wavelengths. In 4 n samples, each
    of the n parts of a quarter is combined once with each of the four wavelengths; in four samples, each of the four
    wavelengths is chosen once. ``rest`` in [0, 1) is the place in the chosen quarter; ``key`` is the hash key of the
    choice.
    """
    n = mi.UInt32(n)
    # Without the turns, after the least common multiple of n and 4 samples the same parts would meet the same quarters
    # again.
    around = n * (4 // dr.minimum(n & (~n + 1), 4))
    turns = t // around + combine(key, t // (4 * n))
    return (mi.Float((t + turns) & 3) + rest) * 0.25
