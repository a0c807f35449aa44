"""Glass and water: prosim_dielectric."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi

from ..optics import attenuation, dispersion, dispersive, fresnel, half_vectors, visible
from ..optics.half_vectors import GRAZING
from ..optics.reading import ambient, reflectance, roughness
from ..parameters import describe, expose, reject
from ..registry import plugin


@plugin("bsdf", "prosim_dielectric")
class Dielectric(mi.BSDF):
    r"""
    .. _bsdf-prosim_dielectric:

    Glass and water (:monosp:`prosim_dielectric`)
    ---------------------------------------------------------

    .. pluginparameters::

     * - int_ior, ext_ior
       - |float| or |string|
       - Indices of refraction inside and outside, > 0, or names such as ``water``. (Default: ``bk7``, ``air``)

     * - eta
       - |float|
       - Relative index ``int_ior / ext_ior``: no parameter, but exposed if both are numbers.
       - |exposed|, |differentiable|

     * - int_material, ext_material
       - |string|
       - Instead of an index, a dispersive material: ``bk7``, ``f2``, ``sf10``, ``sf11``, ``lasf9``,
         ``silica``, ``diamond``, ``zirconia`` or ``water``. (Default: none)

     * - int_abbe, ext_abbe
       - |float|
       - Abbe number :math:`V_d` of a material of which ``int_ior`` or ``ext_ior`` is the index at 587.6 nm, for
         Cauchy's formula. (Default: none)

     * - int_cauchy, ext_cauchy
       - |string|
       - Instead of an index, A and B (and C) of Cauchy's formula :math:`n = A + B/\lambda^2 + C/\lambda^4`,
         wavelengths in µm. (Default: none)

     * - int_sellmeier, ext_sellmeier
       - |string|
       - Instead of an index, :math:`B_1, C_1, B_2, C_2, ...` of Sellmeier's formula
         :math:`n^2 = 1 + \sum_i B_i \lambda^2 / (\lambda^2 - C_i)`, wavelengths in µm. (Default: none)

     * - int_A, int_B, ..., int_B1, int_C1, ..., ext_A, ...
       - |float|
       - Coefficients of dispersive materials, as they are exposed.
       - |exposed|, |differentiable|

     * - distribution
       - |string|
       - Distribution of the microfacets' normals: ``beckmann``, ``phong`` or ``gaussian``. (Default: ``phong`` if
         ``exponent`` is given, else ``beckmann``)

     * - alpha
       - |float| or |texture|
       - Roughness of ``beckmann`` (RMS slope, the thesis's :math:`m`) and of ``gaussian`` (radians, at most 2). 0 or
         none: ideally smooth. (Default: none)
       - |exposed|, |differentiable|

     * - exponent
       - |float| or |texture|
       - Roughness of ``phong``, :math:`n = 2/m^2 - 2`, between 0 and 1e6. (Default: none)
       - |exposed|, |differentiable|

     * - specular_reflectance, specular_transmittance
       - |spectrum| or |texture|
       - Factors on the reflected and the transmitted light, in [0, 1]; physically 1. (Default: none)
       - |exposed|, |differentiable|

     * - ambient
       - |spectrum| or |texture|
       - Fraction of the ambient light that the surface reflects, for integrators with ambient light. (Default: black)
       - |exposed|, |differentiable|

    Reflects and refracts by Fresnel's equations and Snell's law (thesis, sections 2.2.3 and 5.1), total reflection
    included; from both sides. If rough, the reflected light follows Torrance and Sparrow, as for
    :ref:`prosim_conductor <bsdf-prosim_conductor>`, and the refracted light Walter et al. (2007), with the product of
    the V-cavities' :math:`G_1` of both directions. Ideally smooth, it equals Mitsuba's
    :ref:`dielectric <bsdf-dielectric>`. Components: reflected, transmitted.

    Where an index depends on the wavelength, glass disperses (Thomas 1986). A smooth surface refracts only one of the
    wavelengths of a ray (in RGB variants one of r, g and b, which stand for 635, 544 and 437 nm) and increases its
    weight. It reflects all of them. Rough surfaces evaluate each wavelength. :ref:`prosim <integrator-prosim>` chooses
    among the wavelengths that the ray still carries; Mitsuba's integrators choose again at each surface, which is
    unbiased and noisier.

    .. tabs::
        .. code-tab:: xml

            <bsdf type="prosim_dielectric">
                <string name="int_ior" value="water"/>
                <float name="alpha" value="0.1"/>
            </bsdf>

        .. code-tab:: python

            'type': 'prosim_dielectric',
            'int_ior': 'water',
            'alpha': 0.1
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.indices = dispersion.Indices.read(props)
        #: Whether they depend on the wavelength; ``eta`` is then none.
        self.disperses = self.indices.disperse
        self.eta = self.indices.quotient()
        dr.make_opaque(self.eta)
        self.specular_reflectance = reflectance(props, "specular_reflectance")
        self.specular_transmittance = reflectance(props, "specular_transmittance")
        self.ambient = ambient(props)
        self.distribution, self.roughness = roughness(props)
        flags = mi.BSDFFlags
        if self.roughness is None:
            self.types = flags.DeltaReflection, flags.DeltaTransmission
        elif self.indices.inside == self.indices.outside:
            raise reject(props, "int_ior", self.indices.inside, "another index than ext_ior, for a rough surface")
        else:
            self.types = flags.GlossyReflection, flags.GlossyTransmission
        sides = flags.FrontSide | flags.BackSide
        self.m_components = [self.types[0] | sides, self.types[1] | sides | flags.NonSymmetric]
        self.m_flags = self.m_components[0] | self.m_components[1]

    def traverse(self, callback: mi.TraversalCallback) -> None:
        expose(
            callback,
            eta=self.eta,
            specular_reflectance=self.specular_reflectance,
            specular_transmittance=self.specular_transmittance,
            ambient=self.ambient,
            **{self.distribution.parameter: self.roughness},
            **self.indices.coefficients(),
        )

    def enabled(self, ctx: mi.BSDFContext) -> tuple[bool, bool]:
        """Whether ``ctx`` asks for the reflected, and for the transmitted component."""
        return ctx.is_enabled(self.types[0], 0), ctx.is_enabled(self.types[1], 1)

    def share(self, ctx: mi.BSDFContext, reflected: mi.Bool, f: mi.Float) -> mi.Float:
        """Probability of the component that was chosen, given Fresnel's reflectance ``f``."""
        return dr.select(reflected, f, 1 - f) if all(self.enabled(ctx)) else mi.Float(1)

    def energy(
        self,
        ctx: mi.BSDFContext,
        si: mi.SurfaceInteraction3f,
        reflected: mi.Bool,
        f: mi.Float,
        eta: mi.Float,
        active: mi.Bool,
    ) -> mi.UnpolarizedSpectrum:
        """Share of the light that a facet reflects or transmits, as a spectrum.

        ``eta`` is the index on wo's side over that on wi's: radiance that crosses is divided by its square, for it
        fills another solid angle; importance is not. It and Fresnel's reflectance ``f`` may be spectra.
        """
        r, t = (
            1 if texture is None else texture.eval(si, active)
            for texture in (self.specular_reflectance, self.specular_transmittance)
        )
        if ctx.mode == mi.TransportMode.Radiance:
            t = t * dr.square(dr.rcp(eta))
        return mi.UnpolarizedSpectrum(dr.select(reflected, f * r, (1 - f) * t))

    def sample(
        self,
        ctx: mi.BSDFContext,
        si: mi.SurfaceInteraction3f,
        sample1: mi.Float,
        sample2: mi.Point2f,
        active: mi.Bool = True,
    ) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
        if self.disperses:
            return dispersive.sample(self, ctx, si, sample1, sample2, active)
        bs = dr.zeros(mi.BSDFSample3f)
        reflection, transmission = self.enabled(ctx)
        active = active & (dr.abs(si.wi.z) > GRAZING)
        if active is False or not (reflection or transmission):
            return bs, mi.Spectrum(0)
        m, width = self.facet(si, sample2, active)
        i_m = dr.dot(si.wi, m)
        f, cos_t, eta_it, eta_ti = fresnel.interface(i_m, self.eta)
        reflected = sample1 <= f if reflection and transmission else mi.Mask(reflection)
        bs.wo = dr.select(reflected, mi.reflect(si.wi, m), mi.refract(si.wi, m, cos_t, eta_ti))
        bs.eta = dr.select(reflected, 1, eta_it)
        bs.sampled_component = dr.select(reflected, mi.UInt32(0), mi.UInt32(1))
        bs.sampled_type = dr.select(reflected, mi.UInt32(+self.types[0]), mi.UInt32(+self.types[1]))
        share = dr.detach(self.share(ctx, reflected, f))
        value = self.energy(ctx, si, reflected, f, eta_it, active)
        if self.roughness is None:
            pdf = share
        else:
            o_m = dr.select(reflected, i_m, cos_t)
            lit, density = self.facets(si, bs.wo, m, i_m, o_m, reflected, width, self.eta)
            pdf = density * share
            active = active & (i_m * si.wi.z > 0) & (bs.wo.z != 0) & (((si.wi.z > 0) == (bs.wo.z > 0)) == reflected)
            value *= lit / dr.select(density > 0, density, 1)
        active = active & (pdf > 0)
        bs.pdf = dr.select(active, pdf, 0)
        return bs, mi.depolarizer(value / dr.select(active, share, 1)) & active

    def facet(
        self, si: mi.SurfaceInteraction3f, sample2: mi.Point2f, active: mi.Bool
    ) -> tuple[mi.Normal3f, mi.Float | None]:
        """``(m, width)``: a facet by the area that is visible from ``wi``, and the roughness, None if there is none."""
        if self.roughness is None:
            return mi.Normal3f(0, 0, 1), None
        width = self.roughness.eval_1(si, active)
        m = visible.sample(dr.mulsign(si.wi, si.wi.z), sample2, self.distribution.polar, width)
        return mi.Normal3f(m), width

    def sample_carried(
        self,
        ctx: mi.BSDFContext,
        si: mi.SurfaceInteraction3f,
        sample1: mi.Float,
        sample2: mi.Point2f,
        weights: Sequence[mi.Float] | None,
        active: mi.Bool,
    ) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
        """The same as `sample` where glass disperses, for who knows what a ray carries: probabilities ``weights`` of
        the wavelengths that a smooth surface chooses from; or None: all go the way of the middle one.
        """
        return dispersive.sample(self, ctx, si, sample1, sample2, active, weights, together=weights is None)

    def facets(
        self,
        si: mi.SurfaceInteraction3f,
        wo: mi.Vector3f,
        m: mi.Vector3f,
        i_m: mi.Float,
        o_m: mi.Float,
        reflected: mi.Bool,
        width: mi.Float,
        eta: mi.Float,
    ) -> tuple[mi.Float, mi.Float]:
        """``(value, pdf)`` of the facets ``m`` that send light from ``wo`` to ``wi``, without Fresnel's share.

        Both are D(m) <wi, m> / cos_i, times the solid angle of m over that of wo (Walter et al. 2007, equations 14 and
        17), the one times G, the other times G1 of wi. ``i_m`` and ``o_m`` are the facet's cosines; by Snell's law
        (i_m + eta o_m) (i_m - eta o_m) is 1 - eta², eta the index on wo's side over that on wi's. ``eta``: the index
        inside over that outside.
        """
        cos_i, cos_o = dr.abs(si.wi.z), dr.abs(wo.z)
        a, b = dr.abs(i_m), dr.maximum(dr.abs(o_m), 1e-30)
        seen = dr.minimum(a / cos_i, 2 * m.z)  # G1 <wi, m> / cos_i
        eta_it = dr.select(si.wi.z > 0, eta, dr.rcp(eta))
        spread = (a + eta_it * b) / dr.maximum(dr.abs(fresnel.contrast(si.wi.z, eta)), 1e-7)
        jacobian = dr.select(reflected, 0.25 / dr.maximum(a, 1e-30), dr.square(eta_it * spread) * b)
        density = self.distribution.D(m, width) * jacobian
        lit = dr.select(reflected, dr.minimum(seen, 2 * m.z * cos_o / cos_i), seen * attenuation.g1(cos_o, m.z, b))
        return density * lit, density * seen

    def eval(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool = True
    ) -> mi.Spectrum:
        return self.eval_pdf(ctx, si, wo, active)[0]

    def pdf(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool = True
    ) -> mi.Float:
        return self.eval_pdf(ctx, si, wo, active)[1]

    def eval_pdf(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool = True
    ) -> tuple[mi.Spectrum, mi.Float]:
        if self.disperses:
            return dispersive.eval_pdf(self, ctx, si, wo, active)
        reflected = (si.wi.z > 0) == (wo.z > 0)
        reflection, transmission = self.enabled(ctx)
        active = active & (dr.abs(si.wi.z) > GRAZING) & (wo.z != 0) & dr.select(reflected, reflection, transmission)
        if active is False or self.roughness is None or not (reflection or transmission):
            return mi.Spectrum(0), mi.Float(0)
        m, i_m, o_m = half_vectors.between(si.wi, wo, self.eta)
        # A facet's front is seen from the front of the surface, its back from the back.
        active = active & (i_m * si.wi.z > 0) & (o_m * wo.z > 0)
        if active is False:
            return mi.Spectrum(0), mi.Float(0)
        lit, density = self.facets(si, wo, m, i_m, o_m, reflected, self.roughness.eval_1(si, active), self.eta)
        f, _, eta_it, _ = fresnel.interface(i_m, self.eta)
        value = self.energy(ctx, si, reflected, f, eta_it, active) * lit
        return mi.depolarizer(value) & active, dr.select(active, density * self.share(ctx, reflected, f), 0)

    def to_string(self) -> str:
        return describe(
            self,
            eta=self.eta,
            indices=self.indices.shown(),
            specular_reflectance=self.specular_reflectance,
            specular_transmittance=self.specular_transmittance,
            ambient=self.ambient,
            distribution=self.distribution.name,
            **{self.distribution.parameter: self.roughness},
        )
