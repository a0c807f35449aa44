"""Phong's empirical reflection model: prosim_phong."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..optics import cosine
from ..optics.material import LARGEST_SUM, Evaluated, Pigmented, pigment_sums, reflectance
from ..parameters import flag
from ..registry import plugin


@plugin("bsdf", "prosim_phong")
class Phong(Pigmented):
    r"""
    .. _bsdf-prosim_phong:

    Phong's model (:monosp:`prosim_phong`)
    --------------------------------------

    .. pluginparameters::

     * - diffuse_reflectance
       - |spectrum| or |texture|
       - Weight of the diffuse component, :math:`k_d`. (Default: 0.5)
       - |exposed|, |differentiable|

     * - specular_reflectance
       - |spectrum| or |texture|
       - Weight of the specular lobe, :math:`k_s`. (Default: 0.2)
       - |exposed|, |differentiable|

     * - exponent
       - |float| or |texture|
       - The lobe is :math:`\cos^n` of the angle to the mirror direction, n between 0 and 1e6. None: a mirror.
         (Default: none)
       - |exposed|, |differentiable|

     * - normalized
       - |bool|
       - Whether the lobe has the factor that conserves energy; ``false``: the equation of the thesis. (Default: true)

     * - distribution
       - |string|
       - ``phong``, the only distribution of this model. (Default: ``phong``)

     * - ambient
       - |spectrum| or |texture|
       - Fraction of the ambient light that the surface reflects, for integrators with ambient light. (Default: black)
       - |exposed|, |differentiable|

    The empirical model (thesis, sections 3.1.2 and 4.2.2.2) in the normalisation of Lafortune and Willems (1994):
    :math:`\rho = k_d / \pi + k_s (n + 2) / (2 \pi) \cos^n \alpha`, where :math:`\alpha` is the angle to the mirror
    direction. The model conserves energy if :math:`k_d + k_s \le 1`. A scene may have a
    greater sum, because the listing in the thesis has such surfaces; but if the reflectances change later, :math:`k_s`
    is limited to :math:`1 - k_d`, and so it is in spectral variants at wavelengths where only the spectra of colours
    have a greater sum. The model has no Fresnel reflectance and no off-specular peak. It is one-sided. Its
    components are specular and diffuse.

    With ``normalized`` false, the model is the equation of section 3.1.2 as it stands, :math:`I_r = I_i (k_d \cos
    \theta + k_s \cos^n \alpha)`, where :math:`\theta` is the angle of incidence, and :math:`\pi I_i` the irradiance on
    a surface that faces the light. So the lobe is :math:`\rho = k_s \cos^n \alpha / (\pi \cos \theta)`. It is not
    reciprocal. It does not conserve energy: at normal incidence it reflects about :math:`2 k_s / (n + 1)`, and at
    grazing incidence more light than arrives. So in path tracing, surfaces that light each other may become ever
    brighter with the number of bounces; each value is finite.

    .. tabs::
        .. code-tab:: xml

            <bsdf type="prosim_phong">
                <rgb name="diffuse_reflectance" value="0.5, 0.4, 0.1"/>
                <float name="specular_reflectance" value="0.3"/>
                <float name="exponent" value="50"/>
            </bsdf>

        .. code-tab:: python

            'type': 'prosim_phong',
            'diffuse_reflectance': {
                'type': 'rgb',
                'value': [0.5, 0.4, 0.1]
            },
            'specular_reflectance': 0.3,
            'exponent': 50.0
    """

    PARAMETERS = ("diffuse_reflectance", "specular_reflectance")

    def __init__(self, props: mi.Properties) -> None:
        sums = pigment_sums(props, [0.2])
        super().__init__(props, ("phong",))
        self.specular_reflectance = reflectance(props, "specular_reflectance", 0.2)
        self.normalized = flag(props, "normalized", True)
        # Loaded values may have a sum kd + ks above 1: the model is empirical, and the thesis's listing has the sums
        # 1.2 and 1.4 (appendix A). Changed values are limited, because an optimisation may find any sum; and so are
        # the spectra that Mitsuba makes of colours with sums of at most 1: at some wavelengths, theirs may be 2.
        self.is_limited = mi.is_spectral and self.normalized and 0 < max(sums, default=0) <= LARGEST_SUM

    def parameters(self) -> dict[str, Any]:
        return super().parameters() | ({} if self.normalized else {"normalized": False})

    def specular_weight(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.UnpolarizedSpectrum:
        ks = self.specular_factor(si, active)
        if self.normalized or self.roughness is None:
            return ks
        return ks * (2 / (self.roughness.eval_1(si, active) + 1))

    def specular_sample(
        self, si: mi.SurfaceInteraction3f, sample1: mi.Float, sample2: mi.Point2f, active: mi.Bool
    ) -> mi.Vector3f:
        sin, cos = cosine.sample(sample2.x, self.roughness.eval_1(si, active))  # thesis, equation 4.10
        sin_phi, cos_phi = dr.sincos(2 * dr.pi * sample2.y)
        return mi.Frame3f(mi.reflect(si.wi)).to_world(mi.Vector3f(sin * cos_phi, sin * sin_phi, cos))

    def specular_eval_pdf(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
    ) -> Evaluated:
        n = self.roughness.eval_1(si, active)
        lobe = cosine.power(cosine.versine(mi.reflect(si.wi), wo), n) * dr.inv_two_pi
        if self.normalized:
            scale = (n + 2) * wo.z
        else:  # the cosine of the light cancels; the light is at wo for radiance, at wi for importance
            scale = mi.Float(2) if ctx.mode == mi.TransportMode.Radiance else 2 * wo.z / si.wi.z
        return self.specular_factor(si, active) * (scale * lobe), (n + 1) * lobe
