"""Fresnel's equations (section 2.2.3)."""

from __future__ import annotations

from typing import NamedTuple

import drjit as dr
import mitsuba as mi


class Interface(NamedTuple):
    """How the interface between two dielectrics divides a ray: numbers, or spectra."""

    #: Fresnel's reflectance of unpolarised light, and the cosine of the refracted ray, as ``mi.fresnel`` returns it.
    f: mi.Float
    cos_t: mi.Float
    #: The index beyond the interface over that on the incident side, and its reciprocal.
    eta_it: mi.Float
    eta_ti: mi.Float


def contrast(cos_i: mi.Float, eta: mi.Float) -> mi.Float:
    """eta_it² - 1, eta_it the index beyond the interface over that on the incident side; exact also for eta near 1."""
    difference = (eta - 1) * (eta + 1)
    return dr.select(cos_i >= 0, difference, -difference * dr.square(dr.rcp(eta)))


def interface(cos_i: mi.Float, eta: mi.Float) -> Interface:
    """The interface between two dielectrics.

    ``cos_i`` is the cosine on the incident side, > 0 outside and < 0 inside; ``eta`` = interior / exterior index. The
    reflectance is that of unpolarised light (equation 2.2), total reflection included. Mitsuba's loses its digits if
    eta is near 1; here the differences of the equation, such as cos_i - eta cos_t, are (1 - eta²) over a sum.
    """
    _, cos_t, eta_it, eta_ti = mi.fresnel(cos_i, eta)
    c, t = dr.abs(cos_i), dr.abs(cos_t)
    eta2 = dr.square(eta_it)
    difference = contrast(cos_i, eta)
    s = difference / dr.maximum(dr.square(c + eta_it * t), 1e-30)
    p = difference * (c * c * (eta2 + 1) - 1) / dr.maximum(eta2 * dr.square(eta_it * c + t), 1e-30)
    return Interface(dr.select(t > 0, 0.5 * (s * s + p * p), 1), cos_t, eta_it, eta_ti)


def dielectric(cos_i: mi.Float, eta: mi.Float) -> mi.Float:
    """Unpolarised reflectance of the interface between two dielectrics, see `interface`."""
    return interface(cos_i, eta).f


def conductor(cos_i: mi.Float, eta: mi.UnpolarizedSpectrum, k: mi.UnpolarizedSpectrum) -> mi.UnpolarizedSpectrum:
    """Unpolarised reflectance of a metal, exact: a spectrum, from the relative index eta - i k (spectra)."""
    channels = (mi.fresnel_conductor(cos_i, mi.Complex2f(n, x)) for n, x in zip(eta, k, strict=True))
    return mi.UnpolarizedSpectrum(*channels)


def conductor_thesis(cos_i: mi.Float, eta: mi.UnpolarizedSpectrum, k: mi.UnpolarizedSpectrum) -> mi.UnpolarizedSpectrum:
    """The same under the thesis's assumption eta² + k² >> 1 (section 2.2.3, after Cook and Torrance 1982)."""
    e = eta * eta + k * k
    twice = 2 * eta * cos_i
    square = cos_i * cos_i
    parallel = (e * square - twice + 1) / (e * square + twice + 1)
    perpendicular = (e - twice + square) / (e + twice + square)
    return 0.5 * (parallel + perpendicular)
