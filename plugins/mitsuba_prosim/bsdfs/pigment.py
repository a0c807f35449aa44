"""A specular lobe over a pigment: the methods that prosim_composite and prosim_phong have in common.

A BSDF that uses them has components [specular, diffuse], and

- ``specular_type``: GlossyReflection or DeltaReflection;
- ``diffuse_reflectance``: a texture;
- ``specular_weight(si, active)``: spectrum, about the share of light that the specular component reflects, exact if
  that is a mirror;
- ``specular_sample(si, sample2, active)``: a direction drawn from the lobe;
- ``specular_eval_pdf(si, wo, active)``: the lobe times the cosine (spectrum), and the density of the former.
"""

import drjit as dr
import mitsuba as mi


def set_components(bsdf):
    """Declares the components of a BSDF whose ``specular_type`` is known."""
    bsdf.m_components = [bsdf.specular_type | mi.BSDFFlags.FrontSide,
                         mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide]
    bsdf.m_flags = bsdf.m_components[0] | bsdf.m_components[1]


def enabled(bsdf, ctx):
    return ctx.is_enabled(bsdf.specular_type, 0), ctx.is_enabled(mi.BSDFFlags.DiffuseReflection, 1)


def share(bsdf, ctx, si, kd, active):
    """Probability with which the specular component is sampled: 1 or 0 if it is the only one, or not, enabled."""
    specular, diffuse = enabled(bsdf, ctx)
    if specular != diffuse:
        return mi.Float(1 if specular else 0)
    ks = dr.mean(bsdf.specular_weight(si, active))
    total = ks + dr.mean(kd)
    return dr.select(total > 0, ks / dr.maximum(total, 1e-8), 0.5)


def eval_pdf(bsdf, ctx, si, wo, active=True):
    specular, diffuse = enabled(bsdf, ctx)
    active &= (si.wi.z > 0) & (wo.z > 0)
    value, pdf = mi.UnpolarizedSpectrum(0), mi.Float(0)
    if active is False or not (specular or diffuse):
        return mi.Spectrum(0), pdf
    kd = bsdf.diffuse_reflectance.eval(si, active)
    p = share(bsdf, ctx, si, kd, active)
    if diffuse:
        density = mi.warp.square_to_cosine_hemisphere_pdf(wo)
        value += kd * density
        pdf += (1 - p) * density
    if specular and bsdf.specular_type == mi.BSDFFlags.GlossyReflection:
        lobe, density = bsdf.specular_eval_pdf(si, wo, active)
        value += lobe
        pdf += p * density
    return mi.depolarizer(value) & active, dr.select(active, pdf, 0)


def evaluate(bsdf, ctx, si, wo, active=True):
    return eval_pdf(bsdf, ctx, si, wo, active)[0]


def pdf(bsdf, ctx, si, wo, active=True):
    return eval_pdf(bsdf, ctx, si, wo, active)[1]


def sample(bsdf, ctx, si, sample1, sample2, active=True):
    bs = dr.zeros(mi.BSDFSample3f)
    active &= si.wi.z > 0
    specular, diffuse = enabled(bsdf, ctx)
    if active is False or not (specular or diffuse):
        return bs, mi.Spectrum(0)
    kd = bsdf.diffuse_reflectance.eval(si, active)
    p = share(bsdf, ctx, si, kd, active)
    chosen = sample1 < p                           # the specular component
    bs.eta = 1
    bs.sampled_component = dr.select(chosen, mi.UInt32(0), mi.UInt32(1))
    bs.sampled_type = dr.select(chosen, mi.UInt32(+bsdf.specular_type), mi.UInt32(+mi.BSDFFlags.DiffuseReflection))
    mirror = bsdf.specular_type == mi.BSDFFlags.DeltaReflection
    wo = mi.warp.square_to_cosine_hemisphere(sample2) if diffuse else mi.Vector3f(0, 0, 1)
    if specular:
        lobe = mi.reflect(si.wi) if mirror else bsdf.specular_sample(si, sample2, active)
        wo = dr.select(chosen, lobe, wo)
    bs.wo = wo
    value, bs.pdf = eval_pdf(bsdf, ctx, si, wo, active)
    if mirror and specular:
        value = dr.select(chosen, mi.depolarizer(bsdf.specular_weight(si, active)), value)
        bs.pdf = dr.select(chosen, p, bs.pdf)
    active &= (bs.pdf > 0) & (wo.z > 0)
    return bs, value / dr.select(active, bs.pdf, 1) & active
