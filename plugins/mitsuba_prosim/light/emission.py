"""What a source emits: its spectrum, and wavelengths drawn from it."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..optics.reading import constant, shown
from ..parameters import reject


def sample_spectrum(texture: mi.Texture, si: mi.SurfaceInteraction3f, sample: mi.Float,
                    active: mi.Bool) -> tuple[mi.Color0f, mi.UnpolarizedSpectrum]:
    """Wavelengths drawn from ``texture``, stratified, and their weight; in colour, its value."""
    wavelengths = dr.zeros(type(si.wavelengths))
    if len(wavelengths):
        wavelengths = mi.sample_shifted(sample)
    return texture.sample_spectrum(si, wavelengths, active)


def emissive(props: mi.Properties, name: str, default: float | None = None) -> mi.Texture | None:
    """The texture of a radiance or intensity; None if it is absent without ``default``.

    Raises ValueError where it is constant and not a finite number >= 0 throughout.
    """
    values = constant(props, name)
    if not all(0 <= v < float("inf") for v in values):
        raise reject(props, name, shown(values), "finite numbers >= 0")
    if name not in props and default is None:
        return None
    if values and not any(values):
        # Mitsuba 3.9 makes no texture of black under an illuminant's spectrum: there would be nothing to sample.
        return mi.load_dict({"type": "uniform", "value": 0.0})
    return props.get_emissive_texture(name) if default is None else props.get_emissive_texture(name, default)
