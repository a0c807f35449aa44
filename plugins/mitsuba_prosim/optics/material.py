"""The base classes of materials, of all and of those with a specular lobe over a pigment; and the parameters that they
share: reflectances and roughness.

Like the plugins, this module runs again when the variant changes (see ``registry``).
"""

from __future__ import annotations

import functools
import operator
from typing import Any, TypeAlias

import drjit as dr
import mitsuba as mi

from ..parameters import choice, constant, describe, expose, reject, shown
from .facets import DISTRIBUTIONS, GRAZING, Distribution

#: A sample that weighs less than this, without the cosine, is negligible relative to 1 in single precision.
LEAST_WEIGHT = 2**-24

#: Value of a lobe times the cosine of the direction, and its density per solid angle.
Evaluated: TypeAlias = "tuple[mi.UnpolarizedSpectrum, mi.Float]"


class Material(mi.BSDF):
    """A BSDF that a subclass defines by ``sample``, ``eval_pdf`` and the names of its parameters.

    (Classes of Mitsuba's cannot be abstract by ``abc``: their metaclass is another.)
    """

    #: Names of the attributes that ``to_string`` shows, and of which ``mi.traverse`` shows textures and Dr.Jit values.
    PARAMETERS: tuple[str, ...] = ()
    #: The types of the components, in their order.
    types: tuple[mi.BSDFFlags, ...] = ()
    #: The :class:`.Distribution` of its microfacets, and the texture of their roughness; None if it has no such facets.
    distribution: Any = None
    roughness: Any = None

    def __init__(self, props: mi.Properties) -> None:
        """Reads ``ambient``, the reflectance of ambient light; None if absent."""
        super().__init__(props)
        self.ambient = reflectance(props, "ambient")

    def set_components(self, components: dict[mi.BSDFFlags, int]) -> None:
        """Declares the components: type -> further flags."""
        self.types = tuple(components)
        self.m_components = [kind | further for kind, further in components.items()]
        self.m_flags = functools.reduce(operator.or_, self.m_components)

    def specular_type(self) -> mi.BSDFFlags:
        """Type of a specular reflection: a Dirac peak if the surface has no roughness."""
        return mi.BSDFFlags.DeltaReflection if self.roughness is None else mi.BSDFFlags.GlossyReflection

    def enabled(self, ctx: mi.BSDFContext) -> list[bool]:
        """Whether ``ctx`` asks for each of the components."""
        return [ctx.is_enabled(kind, i) for i, kind in enumerate(self.types)]

    def parameters(self) -> dict[str, Any]:
        """The values that ``to_string`` shows, by name."""
        own = {name: getattr(self, name) for name in (*self.PARAMETERS, "ambient")}
        if self.distribution is None:
            return own
        return {**own, "distribution": self.distribution.name, self.distribution.parameter: self.roughness}

    def eval_pdf(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool = True
    ) -> tuple[mi.Spectrum, mi.Float]:
        raise NotImplementedError  # a subclass defines it; Mitsuba's own would call eval and pdf, and these call it

    def eval(self, *args: Any, **kwargs: Any) -> mi.Spectrum:
        """The first result of :meth:`eval_pdf`, with its arguments."""
        return self.eval_pdf(*args, **kwargs)[0]

    def pdf(self, *args: Any, **kwargs: Any) -> mi.Float:
        """The second result of :meth:`eval_pdf`, with its arguments."""
        return self.eval_pdf(*args, **kwargs)[1]

    def traverse(self, callback: mi.TraversalCallback) -> None:
        expose(callback, **self.parameters())

    def to_string(self) -> str:
        return describe(self, **self.parameters())


class Pigmented(Material):
    """A one-sided BSDF with the components [specular, diffuse].

    A subclass defines the three methods ``specular_...``, of which the last two are for lobes that are no Dirac peak.
    (Mitsuba's classes cannot be abstract by ``abc``: their metaclass is another.)
    """

    def __init__(self, props: mi.Properties, distributions: tuple[str, ...] = tuple(DISTRIBUTIONS)) -> None:
        """Reads ``diffuse_reflectance`` and the roughness, of one of the ``distributions``."""
        super().__init__(props)
        self.diffuse_reflectance = reflectance(props, "diffuse_reflectance", 0.5)
        self.distribution, self.roughness = roughness(props, distributions)
        front = mi.BSDFFlags.FrontSide
        self.set_components({self.specular_type(): front, mi.BSDFFlags.DiffuseReflection: front})

    def specular_weight(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.UnpolarizedSpectrum:
        """About the share of light that the specular component reflects; exact if that is a mirror."""
        raise NotImplementedError

    def specular_sample(self, si: mi.SurfaceInteraction3f, sample2: mi.Point2f, active: mi.Bool) -> mi.Vector3f:
        """A sampled direction of the specular lobe."""
        raise NotImplementedError

    def specular_eval_pdf(self, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool) -> Evaluated:
        """The specular lobe times the cosine of ``wo``, and its density."""
        raise NotImplementedError

    def specular_probability(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, kd: mi.UnpolarizedSpectrum, active: mi.Bool
    ) -> mi.Float:
        """Probability of sampling the specular component; 1 or 0 where only one component is enabled."""
        specular, diffuse = self.enabled(ctx)
        if specular != diffuse:
            return mi.Float(1 if specular else 0)
        ks = dr.mean(self.specular_weight(si, active))
        total = ks + dr.mean(kd)
        return dr.select(total > 0, ks / dr.maximum(total, 1e-8), 0.5)

    def sample(
        self,
        ctx: mi.BSDFContext,
        si: mi.SurfaceInteraction3f,
        sample1: mi.Float,
        sample2: mi.Point2f,
        active: mi.Bool = True,
    ) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
        bs = dr.zeros(mi.BSDFSample3f)
        active = active & (si.wi.z > GRAZING)
        specular, diffuse = self.enabled(ctx)
        if active is False or not (specular or diffuse):
            return bs, mi.Spectrum(0)
        kd = self.diffuse_reflectance.eval(si, active)
        p = self.specular_probability(ctx, si, kd, active)
        chosen = sample1 < p  # the specular component
        bs.eta = 1
        bs.sampled_component = dr.select(chosen, mi.UInt32(0), mi.UInt32(1))
        bs.sampled_type = dr.select(chosen, *(mi.UInt32(+kind) for kind in self.types))
        mirror = self.roughness is None
        wo = mi.warp.square_to_cosine_hemisphere(sample2) if diffuse else mi.Vector3f(0, 0, 1)
        if specular:
            lobe = mi.reflect(si.wi) if mirror else self.specular_sample(si, sample2, active)
            wo = dr.select(chosen, lobe, wo)
        bs.wo = wo
        value, pdf = self.eval_pdf(ctx, si, wo, active)
        if mirror and specular:
            value = dr.select(chosen, mi.depolarizer(self.specular_weight(si, active)), value)
            pdf = dr.select(chosen, p, pdf)
        active = active & (pdf > 0) & (wo.z > 0)
        bs.pdf = dr.select(active, pdf, 0)
        return bs, value / dr.select(active, pdf, 1) & active

    def eval_pdf(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool = True
    ) -> tuple[mi.Spectrum, mi.Float]:
        specular, diffuse = self.enabled(ctx)
        active = active & (si.wi.z > GRAZING) & (wo.z > 0)
        value, pdf = mi.UnpolarizedSpectrum(0), mi.Float(0)
        if active is False or not (specular or diffuse):
            return mi.Spectrum(0), pdf
        kd = self.diffuse_reflectance.eval(si, active)
        p = self.specular_probability(ctx, si, kd, active)
        if diffuse:
            density = mi.warp.square_to_cosine_hemisphere_pdf(wo)
            value += kd * density
            pdf += (1 - p) * density
        if specular and self.roughness is not None:
            lobe, density = self.specular_eval_pdf(si, wo, active)
            value += lobe
            pdf += p * density
        # prb divides the remaining radiance of a path by this value. Where a channel has no pigment and the lobe has
        # ended, that would be a rounding error over 1e-30; a value of 0 it leaves out.
        value -= dr.detach(dr.select(value > LEAST_WEIGHT * pdf * wo.z, 0, value))
        return mi.depolarizer(value) & active, dr.select(active, pdf, 0)

    def eval_diffuse_reflectance(self, si: mi.SurfaceInteraction3f, active: mi.Bool = True) -> mi.Spectrum:
        return mi.depolarizer(self.diffuse_reflectance.eval(si, active))


# ---------------------------------------------------------------- parameters
# Each function reads from the plugin's ``props`` and raises ValueError for wrong values.


def reflectance(props: mi.Properties, name: str, default: float | None = None) -> Any:
    """The texture of a reflectance, checked to lie in [0, 1] where it is constant; None if absent without default."""
    values = constant(props, name)
    if not all(0 <= v <= 1 for v in values):
        raise reject(props, name, shown(values), "reflectances between 0 and 1")
    if name in props:
        return props.get_texture(name)
    return None if default is None else props.get_texture(name, default)


def roughness(props: mi.Properties, allowed: tuple[str, ...] = tuple(DISTRIBUTIONS)) -> tuple[Distribution, Any]:
    """Reads ``distribution`` and the roughness that it calls for: (distribution, texture).

    The texture is None for an ideally smooth surface, i.e. if the roughness is absent or ``alpha`` is 0. An
    ``exponent`` alone means Phong's distribution, else Beckmann's is the default.
    """
    name = choice(props, "distribution", allowed, "phong" if "exponent" in props else None)
    distribution = DISTRIBUTIONS[name]
    parameter = distribution.parameter
    for other in ("alpha", "exponent"):
        if other != parameter and other in props:
            raise reject(props, other, props[other], f'"{parameter}" with distribution {name}')
    if parameter not in props:
        return distribution, None
    values = constant(props, parameter)
    low, high, within = distribution.range
    if not all(low <= v <= high for v in values):
        raise reject(props, parameter, shown(values), within)
    texture = props.get_unbounded_texture(parameter)
    return distribution, None if parameter == "alpha" and values == [0] else texture
