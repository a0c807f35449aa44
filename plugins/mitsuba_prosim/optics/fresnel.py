"""Fresnel's equations (section 2.2.3)."""

from __future__ import annotations

import mitsuba as mi


def dielectric(cos_i: mi.Float, eta: mi.Float) -> mi.Float:
    """Unpolarised reflectance of the interface between two dielectrics (equation 2.2), total reflection included.

    ``cos_i`` is the cosine on the incident side, > 0 outside and < 0 inside; ``eta`` = interior / exterior index.
    """
    return mi.fresnel(cos_i, eta)[0]


def conductor(cos_i: mi.Float, eta: mi.UnpolarizedSpectrum, k: mi.UnpolarizedSpectrum) -> mi.UnpolarizedSpectrum:
    """Unpolarised reflectance of a metal, exact: a spectrum, from the relative index eta - i k (spectra)."""
    return mi.UnpolarizedSpectrum(*[mi.fresnel_conductor(cos_i, mi.Complex2f(n, x)) for n, x in zip(eta, k, strict=True)])


def conductor_thesis(cos_i: mi.Float, eta: mi.UnpolarizedSpectrum, k: mi.UnpolarizedSpectrum) -> mi.UnpolarizedSpectrum:
    """The same under the thesis's assumption eta² + k² >> 1 (section 2.2.3, after Cook and Torrance 1982)."""
    e = eta * eta + k * k
    twice = 2 * eta * cos_i
    square = cos_i * cos_i
    parallel = (e * square - twice + 1) / (e * square + twice + 1)
    perpendicular = (e - twice + square) / (e + twice + square)
    return 0.5 * (parallel + perpendicular)
