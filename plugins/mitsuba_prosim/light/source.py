"""The base class of this package's sources: an emitted spectrum and a beam.

Like the plugins, this module runs again when the variant changes (see ``registry``).
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi

from ..parameters import constant, describe, expose, reject, shown
from ..registry import create
from .beam import read_beam


class Source(mi.Emitter):
    """A source with the parameters of :class:`.Beam`, ``unattenuated``, and its emission, the parameter ``quantity``.
    ``place``: the parameters that it has instead of ``to_world``.
    """

    def __init__(self, props: mi.Properties, quantity: str, place: str) -> None:
        super().__init__(props)
        if "to_world" in props:
            raise reject(props, "to_world", "a transform", place)
        self.quantity, self.emission = quantity, read_emission(props, quantity, 1.0)
        self.unattenuated = props.get("unattenuated", False)
        self.beam = read_beam(props)

    def traverse(self, callback: mi.TraversalCallback) -> None:
        super().traverse(callback)
        edge = mi.ParamFlags.Differentiable | mi.ParamFlags.Discontinuous
        expose(callback, **{self.quantity: self.emission}, exponent=self.beam.exponent)
        expose(callback, edge, direction=self.beam.direction, angle=self.beam.angle)

    def parameters_changed(self, keys: list[str]) -> None:
        self.beam.make_opaque()
        super().parameters_changed(keys)

    def sample_spectrum(
        self, si: mi.SurfaceInteraction3f, sample: mi.Float, active: mi.Bool
    ) -> tuple[mi.Color0f, mi.UnpolarizedSpectrum]:
        """``(wavelengths, weight)``: sampled from the emission, stratified; in colour, its value."""
        wavelengths = dr.zeros(type(si.wavelengths))
        if len(wavelengths):
            wavelengths = mi.sample_shifted(sample)
        return self.emission.sample_spectrum(si, wavelengths, active)

    def parameters(self) -> dict[str, Any]:
        """The values that ``to_string`` shows, by name."""
        return {self.quantity: self.emission, **vars(self.beam), "unattenuated": self.unattenuated}

    def to_string(self) -> str:
        return describe(self, **self.parameters())


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
