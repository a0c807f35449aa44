"""The base class of materials that have a specular lobe over a pigment: prosim_composite and prosim_phong.

Like the plugins, this module runs again when the variant changes (see ``registry``).
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from .half_vectors import GRAZING
from .material import Material

#: A sample that weighs less than this, without the cosine, is negligible relative to 1 in single precision.
LEAST_WEIGHT = 2**-24


class Pigmented(Material):
    """A one-sided BSDF with the components [specular, diffuse].

    A subclass sets ``diffuse_reflectance``, a texture, calls `set_components`, and defines the three methods
    ``specular_...``, of which the last two are for lobes that are no Dirac peak.
    """

    diffuse_reflectance: mi.Texture

    def set_components(self, glossy: bool) -> None:
        """Declares the components; the specular one is a Dirac peak unless ``glossy``."""
        flags = mi.BSDFFlags
        self.specular_type = flags.GlossyReflection if glossy else flags.DeltaReflection
        self.m_components = [self.specular_type | flags.FrontSide, flags.DiffuseReflection | flags.FrontSide]
        self.m_flags = self.m_components[0] | self.m_components[1]

    def specular_weight(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.UnpolarizedSpectrum:
        """About the share of light that the specular component reflects; exact if that is a mirror."""
        raise NotImplementedError

    def specular_sample(self, si: mi.SurfaceInteraction3f, sample2: mi.Point2f, active: mi.Bool) -> mi.Vector3f:
        """A sampled direction of the specular lobe."""
        raise NotImplementedError

    def specular_eval_pdf(
        self, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
    ) -> tuple[mi.UnpolarizedSpectrum, mi.Float]:
        """The specular lobe times the cosine of ``wo``, and its density."""
        raise NotImplementedError

    def enabled(self, ctx: mi.BSDFContext) -> tuple[bool, bool]:
        """Whether ``ctx`` asks for the specular, and for the diffuse component."""
        return ctx.is_enabled(self.specular_type, 0), ctx.is_enabled(mi.BSDFFlags.DiffuseReflection, 1)

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
        bs.sampled_type = dr.select(chosen, mi.UInt32(+self.specular_type), mi.UInt32(+mi.BSDFFlags.DiffuseReflection))
        mirror = self.specular_type == mi.BSDFFlags.DeltaReflection
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
        if specular and self.specular_type == mi.BSDFFlags.GlossyReflection:
            lobe, density = self.specular_eval_pdf(si, wo, active)
            value += lobe
            pdf += p * density
        # prb divides the remaining radiance of a path by this value. Where a channel has no pigment and the lobe has
        # ended, that would be a rounding error over 1e-30; a value of 0 it leaves out.
        value -= dr.detach(dr.select(value > LEAST_WEIGHT * pdf * wo.z, 0, value))
        return mi.depolarizer(value) & active, dr.select(active, pdf, 0)

    def eval_diffuse_reflectance(self, si: mi.SurfaceInteraction3f, active: mi.Bool = True) -> mi.Spectrum:
        return mi.depolarizer(self.diffuse_reflectance.eval(si, active))
