"""The base class of the light sources of this package, which have an emitted spectrum and an angular distribution.

Like the modules of plugins, this module is executed again after each change of Mitsuba's variant (see ``registry``).
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi

from ..optics import cosine
from ..parameters import choice, constant_values, describe, expose, flag, for_message, number, reject, vector
from ..registry import create
from . import beam

#: Allowed values of the parameter ``distribution`` -> the further parameters that each value needs.
DISTRIBUTIONS = {"uniform": (), "cone": ("direction", "angle"), "spot": ("direction", "angle", "exponent")}


class Source(mi.Emitter):
    """A light source with an emitted spectrum, and with an angular distribution about an axis (:mod:`.beam`)."""

    #: The position in world coordinates; None if the source has a shape.
    position: Any = None

    def __init__(self, props: mi.Properties, quantity: str, place: str) -> None:
        """Reads the parameters, of which ``quantity`` is the emitted spectrum; ``place`` tells in the error message for
        ``to_world`` how to place the light source. Raises ValueError for wrong values, and for parameters that the
        distribution does not have.
        """
        super().__init__(props)
        if "to_world" in props:
            raise reject(props, "to_world", "a transform", place)
        self.quantity, self.emission = quantity, read_emission(props, quantity, 1.0)
        self.unattenuated = flag(props, "unattenuated")
        self.distribution = choice(props, "distribution", tuple(DISTRIBUTIONS))
        for name in DISTRIBUTIONS["spot"]:  # a spot has all further parameters
            if name in props and name not in DISTRIBUTIONS[self.distribution]:
                raise reject(props, name, props[name], f'no "{name}" with distribution {self.distribution}')
        #: The axis in world coordinates, of any length; the angle in degrees; the exponent. Each is None if the
        #: distribution has no such parameter.
        self.direction = self.angle = self.exponent = None
        if self.uniform:
            return
        allowed = "a vector of finite length > 0"
        direction = mi.ScalarVector3f(vector(props, "direction", (0, -1, 0), allowed))
        if not 0 < dr.norm(direction) < math.inf:
            raise reject(props, "direction", list(direction), allowed)
        default, widest = (90.0, 90) if self.distribution == "spot" else (None, 180)
        self.direction = mi.Vector3f(direction)
        self.angle = mi.Float(number(props, "angle", default, 0, widest, open_below=True))
        if self.distribution == "spot":
            self.exponent = mi.Float(number(props, "exponent", None, 0))
        dr.make_opaque(self.direction, self.angle, self.exponent)

    @property
    def uniform(self) -> bool:
        """Whether the light source emits the same intensity in every direction."""
        return self.distribution == "uniform"

    def limit_versine(self) -> mi.Float:
        """Returns 1 - cos of the greatest angle from the axis at which the source emits light."""
        return 2 * dr.square(dr.sin(0.5 * dr.deg2rad(self.angle)))

    def relative_intensity(self, d: mi.Vector3f) -> mi.Float:
        """Returns the intensity in the unit direction ``d``, divided by the intensity on the axis."""
        if self.uniform:
            return mi.Float(1)
        return beam.falloff(cosine.versine(d, dr.normalize(self.direction)), self.limit_versine(), self.exponent)

    def sample_beam(self, sample2: mi.Point2f) -> tuple[mi.Vector3f, mi.Float]:
        """Returns a direction, by intensity, and the integral of the relative intensity in steradians."""
        if self.uniform:
            return mi.warp.square_to_uniform_sphere(sample2), mi.Float(4 * dr.pi)
        local = beam.sample_falloff(sample2, self.limit_versine(), self.exponent)
        d = mi.Frame3f(dr.normalize(self.direction)).to_world(local)
        return d, beam.total(self.limit_versine(), self.exponent)

    def traverse(self, callback: mi.TraversalCallback) -> None:
        super().traverse(callback)
        edge = mi.ParamFlags.Differentiable | mi.ParamFlags.Discontinuous
        expose(callback, **{self.quantity: shown(self.emission)}, exponent=self.exponent)
        expose(callback, edge, direction=self.direction, angle=self.angle)

    def parameters_changed(self, keys: list[str]) -> None:
        dr.make_opaque(self.position, self.direction, self.angle, self.exponent)
        super().parameters_changed(keys)

    def sample_wavelengths(
        self, si: mi.SurfaceInteraction3f, sample: mi.Float, active: mi.Bool = True
    ) -> tuple[mi.Color0f, mi.UnpolarizedSpectrum]:
        """Samples stratified wavelengths; returns ``(wavelengths, weight)``, where ``weight`` is the emitted spectrum
        divided by their density.
        """
        wavelengths = dr.zeros(type(si.wavelengths))
        if len(wavelengths):
            wavelengths = mi.sample_shifted(sample)
        return self.emission.sample_spectrum(si, wavelengths, active)

    def parameters(self) -> dict[str, Any]:
        """Returns a dictionary of the parameters that ``to_string`` shows: name -> value."""
        own = {name: getattr(self, name) for name in ("distribution", *DISTRIBUTIONS["spot"], "unattenuated")}
        return {self.quantity: self.emission, **own}

    def to_string(self) -> str:
        return describe(self, **self.parameters())


def shown(emission: Any) -> Any:
    """Returns the texture that ``mi.traverse`` shows for ``emission``: ``emission`` itself, or, if it is black, its
    factor of D65, because the parameter then has the same name as that of other colours.
    """
    parameters: Any = {} if emission is None else mi.traverse(emission)
    if "nested_texture.value" not in parameters:
        return emission
    return next(node for node in parameters.hierarchy if "value" in mi.traverse(node))


def read_emission(props: mi.Properties, name: str, default: float | None = None) -> Any:
    """Returns the emitted spectrum of a light source, read from the parameter ``name``, as a texture; None if the
    parameter is absent and ``default`` is None.

    Raises ValueError unless all its numbers are finite and not negative, including the texels of an image. In spectral
    variants, Mitsuba converts texels to coefficients of spectra, which may be negative, so that only NaN is an error;
    a black number or colour is a factor 0 of the illuminant D65, and a black spectrum is uniform.
    """
    allowed = "finite numbers >= 0"
    values = constant_values(props, name)
    if not all(0 <= v < math.inf for v in values):
        raise reject(props, name, for_message(values), allowed)
    if name not in props and default is None:
        return None
    if values and not any(values) and mi.is_spectral:
        # Mitsuba 3.9 cannot multiply black with an illuminant's spectrum: the product would have no density to sample.
        black = create("uniform", value=0.0)
        return black if hasattr(props[name], "values") else create("d65", nested=black)
    texture = props.get_emissive_texture(name) if default is None else props.get_emissive_texture(name, default)
    if not values:
        import numpy as np  # slow to import, and seldom needed

        parameters = mi.traverse(texture)
        if mi.is_spectral and "data" in parameters:
            mi.Log(
                mi.LogLevel.Warn,
                f"{props.plugin_name()} {props.id()!r}: in spectral variants, Mitsuba takes the texels of the bitmap "
                f'"{name}" for reflectances: values above 1 are lost, and white has no illuminant. A background may be '
                "an envmap; for other light, nest a bitmap of values up to 1 in the texture d65.",
            )
        for key, parameter in parameters:
            if key.rpartition(".")[2] in ("value", "values", "data"):
                numbers = np.ravel(np.array(parameter, dtype=np.float32))
                bad = np.isnan(numbers) if mi.is_spectral else ~((numbers >= 0) & (numbers < math.inf))
                if wrong := numbers[bad][:1].tolist():
                    raise reject(props, name, f"a texture whose {key} has {wrong[0]:g}", allowed)
    return texture
