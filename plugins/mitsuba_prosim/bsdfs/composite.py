"""Painted and enamelled surfaces: prosim_composite."""

import drjit as dr
import mitsuba as mi

from ..optics import attenuation, fresnel, visible
from ..registry import plugin
from . import pigment
from .common import ambient, conserve, describe, expose, index, reflectance, roughness


@plugin("bsdf", "prosim_composite")
class Composite(mi.BSDF):
    r"""
    .. _bsdf-prosim_composite:

    Composite material (:monosp:`prosim_composite`)
    -----------------------------------------------
    """

    def __init__(self, props):
        super().__init__(props)
        conserve(props, "diffuse_reflectance", "specular_reflectance")
        self.diffuse_reflectance = reflectance(props, "diffuse_reflectance", 0.5)
        self.specular_reflectance = reflectance(props, "specular_reflectance")
        self.ambient = ambient(props, self.diffuse_reflectance)
        self.eta = mi.Float(index(props, "int_ior", "polypropylene") / index(props, "ext_ior", "air"))
        self.distribution, self.roughness = roughness(props)
        self.specular_type = mi.BSDFFlags.GlossyReflection if self.roughness else mi.BSDFFlags.DeltaReflection
        pigment.set_components(self)

    def traverse(self, callback):
        expose(callback, diffuse_reflectance=self.diffuse_reflectance, specular_reflectance=self.specular_reflectance,
               ambient=self.ambient, eta=self.eta, **{self.distribution.parameter: self.roughness})

    def reflected(self, si, cos, active):
        """Fresnel's reflectance times ks."""
        ks = 1 - self.diffuse_reflectance.eval(si, active) if self.specular_reflectance is None \
            else self.specular_reflectance.eval(si, active)
        return ks * fresnel.dielectric(cos, self.eta)

    def specular_weight(self, si, active):
        return self.reflected(si, si.wi.z, active)

    def specular_sample(self, si, sample2, active):
        m = visible.sample(si.wi, sample2, self.distribution.polar, self.roughness.eval_1(si, active))
        return mi.reflect(si.wi, mi.Normal3f(m))

    def specular_eval_pdf(self, si, wo, active):
        m = dr.normalize(si.wi + wo)
        i_m = dr.dot(si.wi, m)
        density = self.distribution.D(m, self.roughness.eval_1(si, active)) / (4 * si.wi.z)
        value = self.reflected(si, i_m, active) * (density * attenuation.g(si.wi.z, wo.z, m.z, i_m))
        return value, density * attenuation.g1(si.wi.z, m.z, i_m)

    sample, eval, pdf, eval_pdf = pigment.sample, pigment.evaluate, pigment.pdf, pigment.eval_pdf

    def eval_diffuse_reflectance(self, si, active=True):
        return mi.depolarizer(self.diffuse_reflectance.eval(si, active))

    def to_string(self):
        return describe(self, diffuse_reflectance=self.diffuse_reflectance,
                        specular_reflectance=self.specular_reflectance, ambient=self.ambient, eta=self.eta,
                        distribution=self.distribution.name, **{self.distribution.parameter: self.roughness})
