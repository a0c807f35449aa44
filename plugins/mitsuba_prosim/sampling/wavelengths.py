"""Wavelengths that divide the spectrum evenly among the samples of a pixel; the choice of a wavelength at dispersive
glass.

Mitsuba samples four wavelengths that are a quarter of the spectrum apart, so one number determines all four: the
position within a quarter. Behind dispersive glass a ray keeps only one of them. The samples of a pixel still cover the
whole spectrum evenly if each of the four is kept equally often for each position within a quarter.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from .hash import GOLDEN, combine
from .nrook import to_unit


def wavelength_number(key: mi.UInt32, t: mi.UInt32, n: int | mi.UInt32) -> mi.Float:
    """Returns the number in [0, 1) that determines the four wavelengths of the sample number ``t``.

    The hash key ``key`` of a pixel, or of the image if all pixels share wavelengths, shifts all numbers, modulo 1. The
    numbers of a pass of ``n`` samples are evenly spaced over a quarter of [0, 1). From pass to pass, they are shifted
    by their distance over the golden ratio. Integration over a shifted lattice of wavelengths is nearly exact for
    smooth spectra (Cranley and Patterson 1976).
    """
    r = t // n  # number of the pass
    return to_unit(key + (t - r * n) * (dr.opaque(mi.UInt32, 1 << 30) // n) + r * GOLDEN // (4 * n))


def wavelength_choice(key: mi.UInt32, t: mi.UInt32, n: int | mi.UInt32, rest: mi.Float) -> mi.Float:
    """Returns the number in [0, 1) by which the sample number ``t`` of a pixel chooses one of its four wavelengths,
    which :func:`wavelength_number` has sampled with the same ``n``.

    In 4 n samples, each of the n parts of a quarter of the spectrum is combined once with each of the four wavelengths;
    in four samples, each wavelength is chosen once. The result is (k + ``rest``) / 4 for the wavelength k and ``rest``
    in [0, 1). ``key`` is the hash key of the choice.
    """
    n = mi.UInt32(n)
    # Each part must meet all four wavelengths. After ``around`` samples (the least common multiple of n and 4), t alone
    # would combine the same parts with the same wavelengths again, so ``turns`` then shifts the wavelengths by one,
    # and by a random number after every 4 n samples.
    around = n * (4 // dr.minimum(n & (~n + 1), 4))
    turns = t // around + combine(key, t // (4 * n))
    return (mi.Float((t + turns) & 3) + rest) * 0.25
