"""Fresnel's equations: the reflectance of smooth surfaces (thesis, section 2.2.3)."""

from __future__ import annotations

from typing import NamedTuple

import drjit as dr
import mitsuba as mi


class Interface(NamedTuple):
    """Reflectance and refraction at the interface between two dielectrics; the fields are numbers or spectra."""

    #: Fresnel's reflectance of unpolarised light, and the cosine of the refracted ray with the sign of ``mi.fresnel``.
    f: mi.Float
    cos_t: mi.Float
    #: The index of refraction beyond the interface divided by the index on the incident side, and the reciprocal.
    eta_it: mi.Float
    eta_ti: mi.Float


def eta2_minus_1(cos_i: mi.Float, eta: mi.Float) -> mi.Float:
    """Returns eta_it² - 1 without cancellation; eta_it is ``eta`` from outside (``cos_i`` >= 0), else 1 / ``eta``."""
    difference = (eta - 1) * (eta + 1)
    return dr.select(cos_i >= 0, difference, -difference * dr.square(dr.rcp(eta)))


def interface(cos_i: mi.Float, eta: mi.Float) -> Interface:
    """Returns the :class:`Interface` between two dielectrics.

    ``cos_i`` is the cosine of the incident direction, > 0 if light arrives from outside, else < 0; ``eta`` is the index
    of refraction inside divided by the index outside. The reflectance is that of unpolarised light (thesis, equation
    2.2), and is 1 at total reflection. Each difference in Fresnel's equations, such as cos_i - eta cos_t, is computed
    as a multiple of eta² - 1, because Mitsuba's formula loses precision if ``eta`` is near 1.
    """
    _, cos_t, eta_it, eta_ti = mi.fresnel(cos_i, eta)
    c, t = dr.abs(cos_i), dr.abs(cos_t)
    eta2 = dr.square(eta_it)
    difference = eta2_minus_1(cos_i, eta)
    # The amplitudes that s- and p-polarised light have after reflection, except for the sign.
    s = difference / dr.maximum(dr.square(c + eta_it * t), 1e-30)
    p = difference * (c * c * (eta2 + 1) - 1) / dr.maximum(eta2 * dr.square(eta_it * c + t), 1e-30)
    return Interface(dr.select(t > 0, 0.5 * (s * s + p * p), 1), cos_t, eta_it, eta_ti)


def conductor(cos_i: mi.Float, eta: mi.UnpolarizedSpectrum, k: mi.UnpolarizedSpectrum) -> mi.UnpolarizedSpectrum:
    """Returns the exact reflectance, for unpolarised light, of a metal with the relative index eta - i k."""
    channels = (mi.fresnel_conductor(cos_i, mi.Complex2f(n, x)) for n, x in zip(eta, k, strict=True))
    return mi.UnpolarizedSpectrum(*channels)


def conductor_thesis(cos_i: mi.Float, eta: mi.UnpolarizedSpectrum, k: mi.UnpolarizedSpectrum) -> mi.UnpolarizedSpectrum:
    """Returns a metal's approximate reflectance, good if eta² + k² >> 1 (thesis, 2.2.3; Cook and Torrance 1982)."""
    e = eta * eta + k * k
    twice = 2 * eta * cos_i
    square = cos_i * cos_i
    parallel = (e * square - twice + 1) / (e * square + twice + 1)
    perpendicular = (e - twice + square) / (e + twice + square)
    return 0.5 * (parallel + perpendicular)
