"""The empirical model: prosim_phong."""

import drjit as dr
import mitsuba as mi

from ..registry import plugin
from . import pigment
from .common import ambient, describe, expose, reflectance, roughness


@plugin("bsdf", "prosim_phong")
class Phong(mi.BSDF):
    r"""
    .. _bsdf-prosim_phong:

    Phong's model (:monosp:`prosim_phong`)
    --------------------------------------
    """

    def __init__(self, props):
        super().__init__(props)
        # The sum may exceed 1: an empirical model, and the thesis's own listing has kd + ks = 1.2 and 1.4 (appendix A).
        self.diffuse_reflectance = reflectance(props, "diffuse_reflectance", 0.5)
        self.specular_reflectance = reflectance(props, "specular_reflectance", 0.2)
        self.ambient = ambient(props)
        self.exponent = roughness(props, ("phong",))[1]
        self.specular_type = mi.BSDFFlags.GlossyReflection if self.exponent else mi.BSDFFlags.DeltaReflection
        pigment.set_components(self)

    def traverse(self, callback):
        expose(callback, diffuse_reflectance=self.diffuse_reflectance, specular_reflectance=self.specular_reflectance,
               ambient=self.ambient, exponent=self.exponent)

    def specular_weight(self, si, active):
        return self.specular_reflectance.eval(si, active)

    def specular_sample(self, si, sample2, active):
        cos = dr.power(1 - sample2.x, 1 / (self.exponent.eval_1(si, active) + 1))     # equation 4.10
        sin = dr.safe_sqrt(1 - cos * cos)
        sin_phi, cos_phi = dr.sincos(2 * dr.pi * sample2.y)
        return mi.Frame3f(mi.reflect(si.wi)).to_world(mi.Vector3f(sin * cos_phi, sin * sin_phi, cos))

    def specular_eval_pdf(self, si, wo, active):
        n = self.exponent.eval_1(si, active)
        cos = dr.dot(mi.reflect(si.wi), wo)
        lobe = dr.select(cos > 0, dr.power(dr.maximum(cos, 1e-8), n), 0) * dr.inv_two_pi
        return self.specular_reflectance.eval(si, active) * ((n + 2) * lobe * wo.z), (n + 1) * lobe

    sample, eval, pdf, eval_pdf = pigment.sample, pigment.evaluate, pigment.pdf, pigment.eval_pdf

    def eval_diffuse_reflectance(self, si, active=True):
        return mi.depolarizer(self.diffuse_reflectance.eval(si, active))

    def to_string(self):
        return describe(self, diffuse_reflectance=self.diffuse_reflectance,
                        specular_reflectance=self.specular_reflectance, ambient=self.ambient, exponent=self.exponent)
