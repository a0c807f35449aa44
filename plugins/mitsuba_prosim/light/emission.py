"""What a source emits: wavelengths drawn from its spectrum."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


def sample_spectrum(texture: mi.Texture, si: mi.SurfaceInteraction3f, sample: mi.Float,
                    active: mi.Bool) -> tuple[mi.Color0f, mi.UnpolarizedSpectrum]:
    """Wavelengths drawn from ``texture``, stratified, and their weight; in colour, its value."""
    wavelengths = dr.zeros(type(si.wavelengths))
    if len(wavelengths):
        wavelengths = mi.sample_shifted(sample)
    return texture.sample_spectrum(si, wavelengths, active)
