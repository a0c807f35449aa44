"""Lambertian material: prosim_lambertian."""

from __future__ import annotations

import mitsuba as mi

from ..optics.material import Evaluated, Material, reflectance
from ..registry import plugin


@plugin("bsdf", "prosim_lambertian")
class Lambertian(Material):
    r"""
    .. _bsdf-prosim_lambertian:

    Lambertian material (:monosp:`prosim_lambertian`)
    -------------------------------------------------

    .. pluginparameters::

     * - reflectance
       - |spectrum| or |texture|
       - Fraction of the incident light that the surface reflects, in [0, 1]. (Default: 0.5)
       - |exposed|, |differentiable|

     * - ambient
       - |spectrum| or |texture|
       - Fraction of the ambient light that the surface reflects, for integrators with ambient light. (Default:
         ``reflectance``)
       - |exposed|, |differentiable|

    The surface reflects light diffusely by Lambert's law (thesis, section 5.1; equation :math:`\rho_d = R / \pi` of
    section 2.2.1). The material is equal to Mitsuba's :ref:`diffuse <bsdf-diffuse>`, except for the attribute
    ``ambient``. It is one-sided: its back is black.

    .. tabs::
        .. code-tab:: xml

            <bsdf type="prosim_lambertian">
                <rgb name="reflectance" value="0.5, 0.3, 0.1"/>
            </bsdf>

        .. code-tab:: python

            'type': 'prosim_lambertian',
            'reflectance': {
                'type': 'rgb',
                'value': [0.5, 0.3, 0.1]
            }
    """

    PARAMETERS = ("reflectance",)

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.reflectance = reflectance(props, "reflectance", 0.5)
        self.ambient = self.ambient or self.reflectance
        self.set_components({mi.BSDFFlags.DiffuseReflection: mi.BSDFFlags.FrontSide})

    def sample_direction(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, sample1: mi.Float, sample2: mi.Point2f, active: mi.Bool
    ) -> tuple[mi.Vector3f, mi.UInt32, mi.Float, mi.UnpolarizedSpectrum]:
        """Samples a direction with a density proportional to its cosine (see :meth:`.Material.sample_direction`)."""
        wo = mi.warp.square_to_cosine_hemisphere(sample2)
        pdf = mi.warp.square_to_cosine_hemisphere_pdf(wo)
        return wo, mi.UInt32(0), pdf, self.reflectance.eval(si, active & (pdf > 0))

    def evaluate(self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool) -> Evaluated:
        pdf = mi.warp.square_to_cosine_hemisphere_pdf(wo)
        return self.reflectance.eval(si, active) * pdf, pdf

    def directional_albedo(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.UnpolarizedSpectrum:
        return self.reflectance.eval(si, active)
