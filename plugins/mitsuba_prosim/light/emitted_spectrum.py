"""Emission of sources: radiance or intensity, and wavelengths sampled from its spectrum."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi

from ..parameters import constant, reject, shown
from ..registry import create


def read_emission(props: mi.Properties, name: str, default: float | None = None) -> Any:
    """The texture of the emission; None if the parameter is absent and has no ``default``.

    Raises ValueError unless all its numbers, those of the texels of an image included, are finite and not negative. In
    spectral variants Mitsuba turns texels into the coefficients of spectra, of any sign; only NaN among those has a
    warning.
    """
    allowed = "finite numbers >= 0"
    values = constant(props, name)
    if not all(0 <= v < math.inf for v in values):
        raise reject(props, name, shown(values), allowed)
    if name not in props and default is None:
        return None
    if values and not any(values):
        # Mitsuba 3.9 makes no texture of black under an illuminant's spectrum: there would be nothing to sample.
        return create("uniform", value=0.0)
    texture = props.get_emissive_texture(name) if default is None else props.get_emissive_texture(name, default)
    if not values:
        import numpy as np  # slow to import, and seldom needed

        for key, parameter in mi.traverse(texture):
            if key.rpartition(".")[2] in ("value", "values", "data"):
                numbers = np.ravel(np.array(parameter, dtype=np.float32))
                bad = np.isnan(numbers) if mi.is_spectral else ~((numbers >= 0) & (numbers < math.inf))
                if wrong := numbers[bad][:1].tolist():
                    raise reject(props, name, f"a texture whose {key} has {wrong[0]:g}", allowed)
    return texture


def sample_spectrum(
    texture: mi.Texture, si: mi.SurfaceInteraction3f, sample: mi.Float, active: mi.Bool
) -> tuple[mi.Color0f, mi.UnpolarizedSpectrum]:
    """``(wavelengths, weight)``: sampled from ``texture``, stratified; in colour, its value."""
    wavelengths = dr.zeros(type(si.wavelengths))
    if len(wavelengths):
        wavelengths = mi.sample_shifted(sample)
    return texture.sample_spectrum(si, wavelengths, active)
