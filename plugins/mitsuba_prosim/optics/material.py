"""The base classes of materials, and the parameters that materials share: reflectances and roughness.

Like the modules of plugins, this module is executed again after each change of Mitsuba's variant (see ``registry``).
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, TypeAlias

import drjit as dr
import mitsuba as mi

from ..compat import is_users
from ..parameters import choice, constant_values, describe, expose, for_message, reject
from . import grooves
from .facets import DISTRIBUTIONS, GRAZING, Distribution, sample_visible, torrance_sparrow

#: Weight of a sample, without the cosine, below which the sample is negligible relative to 1 in single precision.
LEAST_WEIGHT = 2**-24
#: Sum kd + ks of given numbers that is not yet above 1: their decimals are rounded.
LARGEST_SUM = 1 + 1e-6

#: Value of a lobe times the cosine of the direction, and density of the direction per solid angle.
Evaluated: TypeAlias = "tuple[mi.UnpolarizedSpectrum, mi.Float]"


def depolarized(value: Any) -> mi.Spectrum:
    """Returns ``value`` as unpolarised light. ``dr.select`` changes the type of spectra, and Mitsuba's ``depolarizer``
    takes only the first channel of other types; so the value is converted to a spectrum first.
    """
    return mi.depolarizer(mi.UnpolarizedSpectrum(value))


class Material(mi.BSDF):
    """A one-sided BSDF, whose back is black.

    A subclass defines :meth:`sample_direction` and :meth:`evaluate`, and lists the names of its parameters in
    ``PARAMETERS``. A subclass that scatters light on both sides defines :meth:`sample` and :meth:`eval_pdf` instead.
    (abc cannot say so: Mitsuba's classes have another metaclass.)
    """

    #: Names of the attributes that ``to_string`` shows; ``mi.traverse`` shows the attributes that are textures or
    #: Dr.Jit values.
    PARAMETERS: tuple[str, ...] = ()
    #: The type of each component, in the order of the components.
    types: tuple[mi.BSDFFlags, ...] = ()
    #: The :class:`.Distribution` of microfacets, and the texture of their roughness; None if the material has no such
    #: facets.
    distribution: Any = None
    roughness: Any = None
    #: Whether light is reflected between the two facets of a cavity.
    multiple_scattering = False

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.ambient = reflectance(props, "ambient")

    def set_components(self, components: dict[mi.BSDFFlags, int]) -> None:
        """Declares the components of the BSDF; ``components`` maps the type of each to its other flags."""
        self.types = tuple(components)
        self.m_components = [kind | further for kind, further in components.items()]
        self.m_flags = functools.reduce(operator.or_, self.m_components)

    def specular_type(self) -> mi.BSDFFlags:
        """Returns ``DeltaReflection`` for an ideally smooth surface, else ``GlossyReflection``."""
        return mi.BSDFFlags.DeltaReflection if self.roughness is None else mi.BSDFFlags.GlossyReflection

    def enabled(self, ctx: mi.BSDFContext) -> list[bool]:
        """Returns for each component of the BSDF whether ``ctx`` asks for it."""
        return [ctx.is_enabled(kind, i) for i, kind in enumerate(self.types)]

    def parameters(self) -> dict[str, Any]:
        """Returns name -> value of what ``to_string`` and ``mi.traverse`` show; None for an absent parameter."""
        own = {name: getattr(self, name) for name in (*self.PARAMETERS, "ambient")}
        if self.distribution is None:
            return own
        own |= {"distribution": self.distribution.name, self.distribution.parameter: self.roughness}
        return own | {"multiple_scattering": True} if self.multiple_scattering else own

    # A subclass defines the next two methods. (abc cannot say so: Mitsuba's classes have another metaclass.)

    def sample_direction(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, sample1: mi.Float, sample2: mi.Point2f, active: mi.Bool
    ) -> tuple[mi.Vector3f, mi.UInt32, mi.Float, mi.UnpolarizedSpectrum]:
        """Samples a direction from an enabled component of the BSDF, for a viewer in front of the surface.

        Returns ``(wo, component, pdf, weight)``. ``wo`` is a unit vector in the local frame. ``component`` is the
        number of the sampled component, 0 or 1. ``pdf`` is the density of ``wo`` per solid angle, or the probability of
        a Dirac peak; 0 if no direction was sampled. ``weight`` is the value of the BSDF times the cosine of ``wo``,
        divided by ``pdf``.
        """
        raise NotImplementedError

    def evaluate(self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool) -> Evaluated:
        """Returns the value and the density (:data:`Evaluated`) of the components that ``ctx`` enables, without Dirac
        peaks, for directions ``si.wi`` and ``wo`` on the front side.
        """
        raise NotImplementedError

    def sample_facets(
        self, si: mi.SurfaceInteraction3f, sample1: mi.Float, sample2: mi.Point2f, active: mi.Bool
    ) -> mi.Vector3f:
        """Returns a direction in which the facets of a rough surface reflect light from ``si.wi``."""
        width = self.roughness.eval_1(si, active)
        m = sample_visible(si.wi, sample2, self.distribution, width)
        if self.multiple_scattering:
            return grooves.leave(si.wi, m, sample1, self.distribution, width)
        return mi.reflect(si.wi, m)

    def eval_facets(
        self, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, reflected: Callable[[mi.Float], Any], active: mi.Bool
    ) -> Evaluated:
        """Returns the value of the facets of a rough surface times the cosine of ``wo``, and the density of
        :meth:`sample_facets`; ``reflected`` is the reflectance of a facet, a function of the cosine to it.
        """
        width = self.roughness.eval_1(si, active)
        if self.multiple_scattering:
            return grooves.reflect((si.wi, wo), self.distribution, width, reflected, active)
        i_m, value, pdf = torrance_sparrow(si.wi, wo, self.distribution, width)
        return reflected(i_m) * value, pdf

    def sample(
        self,
        ctx: mi.BSDFContext,
        si: mi.SurfaceInteraction3f,
        sample1: mi.Float,
        sample2: mi.Point2f,
        active: mi.Bool = True,
    ) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
        """Samples a direction; returns ``(bs, weight)``. ``weight`` is the value of the BSDF times the cosine of the
        direction, divided by the density ``bs.pdf``; both are 0 if the viewer is not in front of the surface, if
        ``ctx`` enables no component, or if no direction was sampled.
        """
        bs = dr.zeros(mi.BSDFSample3f)
        active = active & (si.wi.z > GRAZING)
        if active is False or not any(self.enabled(ctx)):
            return bs, mi.Spectrum(0)
        bs.wo, component, pdf, weight = self.sample_direction(ctx, si, sample1, sample2, active)
        bs.eta = 1
        bs.sampled_component = component
        # A material has one or two components.
        bs.sampled_type = dr.select(component == 0, mi.UInt32(+self.types[0]), mi.UInt32(+self.types[-1]))
        active = active & (pdf > 0)
        bs.pdf = dr.select(active, pdf, 0)
        return bs, depolarized(weight) & active

    def eval_pdf(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool = True
    ) -> tuple[mi.Spectrum, mi.Float]:
        """Returns the value of the BSDF times the cosine of ``wo``, and the density with which :meth:`sample` samples
        ``wo``, without Dirac peaks; 0 unless the viewer and ``wo`` are both in front of the surface.
        """
        active = active & (si.wi.z > GRAZING) & (wo.z > 0)
        smooth = mi.has_flag(self.m_flags, mi.BSDFFlags.Smooth)
        if active is False or not smooth or not any(self.enabled(ctx)):
            return mi.Spectrum(0), mi.Float(0)
        value, pdf = self.evaluate(ctx, si, wo, active)
        return depolarized(value) & active, dr.select(active, pdf, 0)

    def eval(self, *args: Any, **kwargs: Any) -> mi.Spectrum:
        """Returns the value of the BSDF times the cosine of ``wo``; the arguments are those of :meth:`eval_pdf`."""
        return self.eval_pdf(*args, **kwargs)[0]

    def pdf(self, *args: Any, **kwargs: Any) -> mi.Float:
        """Returns the density with which :meth:`sample` samples ``wo``; the arguments are those of :meth:`eval_pdf`."""
        return self.eval_pdf(*args, **kwargs)[1]

    def directional_albedo(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.UnpolarizedSpectrum:
        """Returns the colour of the surface, for denoisers: the same from all directions.

        The default is that of Mitsuba, pi times the BRDF, for light and a viewer along the normal: exact for an ideally
        diffuse surface, and 0 for a mirror.
        """
        normal = mi.Vector3f(0, 0, 1)
        along_normal = mi.SurfaceInteraction3f(si)
        along_normal.wi = normal
        value = self.eval_pdf(mi.BSDFContext(), along_normal, normal, active)[0]
        return mi.unpolarized_spectrum(value) * dr.pi

    def eval_diffuse_reflectance(self, si: mi.SurfaceInteraction3f, active: mi.Bool = True) -> mi.Spectrum:
        """Returns the colour of the surface, in [0, 1], also for a material without a diffuse component."""
        return depolarized(dr.clip(self.directional_albedo(si, active), 0, 1))

    def traverse(self, callback: mi.TraversalCallback) -> None:
        expose(callback, **self.parameters())

    def to_string(self) -> str:
        return describe(self, **self.parameters())


class Pigmented(Material):
    """A one-sided BSDF with two components: component 0 is specular, component 1 is diffuse.

    A subclass defines :meth:`specular_weight`, and :meth:`specular_sample` and :meth:`specular_eval_pdf`, which are
    called only if the specular lobe is no Dirac peak.
    """

    #: The texture ks, or None.
    specular_reflectance: Any = None
    #: Whether the reflectances are limited at each point and wavelength, so that their sum kd + ks is at most 1.
    is_limited = False

    def __init__(self, props: mi.Properties, distributions: tuple[str, ...] = tuple(DISTRIBUTIONS)) -> None:
        super().__init__(props)
        self.diffuse_reflectance = reflectance(props, "diffuse_reflectance", 0.5)
        self.distribution, self.roughness = roughness(props, distributions)
        front = mi.BSDFFlags.FrontSide
        self.set_components({self.specular_type(): front, mi.BSDFFlags.DiffuseReflection: front})

    def parameters_changed(self, keys: list[str]) -> None:
        """Limits the reflectances if one of them has changed, because the new values are not checked."""
        self.is_limited = self.is_limited or not keys or any("reflectance" in key for key in keys)

    def diffuse_factor(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.UnpolarizedSpectrum:
        """Returns the diffuse reflectance kd."""
        kd = self.diffuse_reflectance.eval(si, active)
        return dr.minimum(kd, 1) if self.is_limited else kd

    def specular_factor(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.UnpolarizedSpectrum:
        """Returns the specular reflectance ks: 1 - kd without the parameter ``specular_reflectance``."""
        if self.specular_reflectance is None:
            return dr.maximum(1 - self.diffuse_factor(si, active), 0)
        ks = self.specular_reflectance.eval(si, active)
        return dr.minimum(ks, dr.maximum(1 - self.diffuse_factor(si, active), 0)) if self.is_limited else ks

    # A subclass defines the next three methods. (abc cannot say so: Mitsuba's classes have another metaclass.)

    def specular_weight(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.UnpolarizedSpectrum:
        """Returns the fraction that the specular component reflects: exact for a mirror, else an estimate."""
        raise NotImplementedError

    def specular_sample(
        self, si: mi.SurfaceInteraction3f, sample1: mi.Float, sample2: mi.Point2f, active: mi.Bool
    ) -> mi.Vector3f:
        """Returns a direction, in the local frame, that is sampled from the specular lobe."""
        raise NotImplementedError

    def specular_eval_pdf(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
    ) -> Evaluated:
        """Returns the value of the specular lobe times the cosine of ``wo``, and the density of its samples."""
        raise NotImplementedError

    def specular_probability(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, kd: mi.UnpolarizedSpectrum, active: mi.Bool
    ) -> mi.Float:
        """Returns the probability of sampling the specular component; ``kd`` is the diffuse reflectance at ``si``.

        If ``ctx`` enables both components, it is ks / (ks + kd), where ks and kd are the means of the specular weight
        and of the diffuse reflectance over the channels, or 1/2 if both are black.
        """
        specular, diffuse = self.enabled(ctx)
        if specular != diffuse:
            return mi.Float(1 if specular else 0)
        ks = dr.mean(self.specular_weight(si, active))
        total = ks + dr.mean(kd)
        return dr.select(total > 0, ks / dr.maximum(total, 1e-8), 0.5)

    def sample_direction(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, sample1: mi.Float, sample2: mi.Point2f, active: mi.Bool
    ) -> tuple[mi.Vector3f, mi.UInt32, mi.Float, mi.UnpolarizedSpectrum]:
        """Samples a direction from the specular or the diffuse component (:meth:`Material.sample_direction`).

        ``pdf`` and ``weight`` are those of all enabled components together, without the Dirac peak of a mirror. If the
        mirror is sampled, ``pdf`` is the probability of the specular component, and ``weight`` counts only the mirror.
        """
        specular, diffuse = self.enabled(ctx)
        p_specular = self.specular_probability(ctx, si, self.diffuse_factor(si, active), active)
        is_specular, mirror = sample1 < p_specular, self.roughness is None
        wo = mi.warp.square_to_cosine_hemisphere(sample2) if diffuse else mi.Vector3f(0, 0, 1)
        if specular:
            u1 = sample1 / p_specular
            lobe = mi.reflect(si.wi) if mirror else dr.detach(self.specular_sample(si, u1, sample2, active))
            wo = dr.select(is_specular, lobe, wo)
        value, pdf = self.eval_pdf(ctx, si, wo, active)
        value = mi.unpolarized_spectrum(value)
        if mirror and specular:
            value = dr.select(is_specular, self.specular_weight(si, active), value)
            pdf = dr.select(is_specular, p_specular, pdf)
        pdf = dr.select(wo.z > 0, pdf, 0)
        return wo, dr.select(is_specular, mi.UInt32(0), 1), pdf, value / dr.detach(dr.select(pdf > 0, pdf, 1))

    def evaluate(self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool) -> Evaluated:
        specular, diffuse = self.enabled(ctx)
        value, pdf = mi.UnpolarizedSpectrum(0), mi.Float(0)
        kd = self.diffuse_factor(si, active)
        p_specular = self.specular_probability(ctx, si, kd, active)
        if diffuse:
            density = mi.warp.square_to_cosine_hemisphere_pdf(wo)
            value += kd * density
            pdf += (1 - p_specular) * density
        if specular and self.roughness is not None:
            lobe, density = self.specular_eval_pdf(ctx, si, wo, active)
            value += lobe
            pdf += p_specular * density
        # The integrator prb divides the remaining radiance of a path by this value. If the lobe is nearly 0 and a
        # channel has no pigment, the result would be rounding error divided by 1e-30. prb skips a value of 0. The
        # subtraction sets a negligible value to 0, but keeps the derivatives of the value.
        value -= dr.detach(dr.select(value > LEAST_WEIGHT * pdf * wo.z, 0, value))
        return value, pdf

    def directional_albedo(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.UnpolarizedSpectrum:
        return self.diffuse_reflectance.eval(si, active)


# ---------------------------------------------------------------- parameters
# Each function reads from the plugin's ``props`` and raises ValueError for wrong values.


def factor(texture: Any, si: mi.SurfaceInteraction3f, active: mi.Bool) -> Any:
    """Returns the value of ``texture`` at ``si``; 1 if it is None."""
    return 1 if texture is None else texture.eval(si, active)


def reflectance(props: mi.Properties, name: str, default: float | None = None) -> Any:
    """Returns the reflectance ``name`` as a texture; ``default`` (a number, or None) if the parameter is absent.

    Raises ValueError if a constant reflectance (a number, a colour or a spectrum) is outside [0, 1]; the values of a
    texture, such as an image or a user's, are not checked, nor those of a plugin as ``ambient`` reflectance.
    """
    values, allowed = constant_values(props, name), "reflectances between 0 and 1"
    if not all(0 <= v <= 1 for v in values):
        raise reject(props, name, for_message(values), allowed)
    if name not in props:
        return None if default is None else props.get_texture(name, default)
    texture = props.get_texture(name)
    if not (values or name == "ambient" or is_users(texture) or texture.is_spatially_varying()):
        with suppress(RuntimeError):  # of a mesh_attribute, which has no max()
            if texture.max() > 1:
                raise reject(props, name, f"a spectrum up to {texture.max():.6g}", allowed)
    return texture


def pigment_sums(props: mi.Properties, specular: Sequence[float]) -> list[float]:
    """Returns the sum kd + ks of each channel; ``specular`` is ks if it is not given. Empty if a reflectance is a
    texture or a spectrum. Call this before the reflectances become textures.
    """
    names = {"diffuse_reflectance": [0.5], "specular_reflectance": specular}
    kd, ks = (constant_values(props, name) if name in props else default for name, default in names.items())
    if any(not v or (len(v) > 1 and hasattr(props.get(name), "values")) for name, v in zip(names, (kd, ks))):
        return []
    return [kd[i % len(kd)] + ks[i % len(ks)] for i in range(max(len(kd), len(ks)))]


def roughness(props: mi.Properties, allowed: tuple[str, ...] = tuple(DISTRIBUTIONS)) -> tuple[Distribution, Any]:
    """Reads the microfacet ``distribution`` and its roughness; returns ``(distribution, texture of the roughness)``.

    ``allowed`` are the names of the allowed distributions. The default is Phong's if the parameter ``exponent`` is
    present, else the first name. The roughness is ``exponent`` for Phong's distribution, else ``alpha``. The texture is
    None for an ideally smooth surface: if the roughness is absent, or if ``alpha`` is the number 0. Raises ValueError
    for a distribution that is not allowed, for the roughness of another distribution, and for a constant out of range.
    """
    name = choice(props, "distribution", allowed, "phong" if "exponent" in props else None)
    distribution = DISTRIBUTIONS[name]
    parameter = distribution.parameter
    for other in ("alpha", "exponent"):
        if other != parameter and other in props:
            raise reject(props, other, props[other], f'"{parameter}" with distribution {name}')
    if parameter not in props:
        return distribution, None
    values = constant_values(props, parameter)
    low, high, within = distribution.range
    if not all(low <= v <= high for v in values):
        raise reject(props, parameter, for_message(values), within)
    texture = props.get_unbounded_texture(parameter)
    return distribution, None if parameter == "alpha" and values == [0] else texture
