"""Glass and water: prosim_dielectric."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi

from ..optics import dispersion, facets, fresnel, grooves
from ..optics.facets import GRAZING, Facet
from ..optics.fresnel import Interface
from ..optics.material import Material, factor, reflectance, roughness
from ..parameters import flag, reject
from ..registry import plugin


@plugin("bsdf", "prosim_dielectric")
class Dielectric(Material):
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
         ``silica``, ``diamond``, ``zirconia`` or ``water``; or the numbers :math:`B_1, C_1, B_2, C_2, ...` of
         Sellmeier's formula. (Default: none)

     * - int_abbe, ext_abbe
       - |float|
       - Abbe number :math:`V_d` of a material of which ``int_ior`` or ``ext_ior`` is the index at 587.6 nm.
         (Default: none)

     * - int_A, int_B, int_B1, int_C1, ..., ext_A, ...
       - |float|
       - Coefficients of dispersive materials, as they are exposed: of Cauchy's formula :math:`n = A + B/\lambda^2` for
         an Abbe number, of Sellmeier's formula :math:`n^2 = 1 + \sum_i B_i \lambda^2 / (\lambda^2 - C_i)` for a
         material, wavelengths in µm.
       - |exposed|, |differentiable|

     * - distribution
       - |string|
       - Distribution of the microfacets' normals: ``beckmann``, ``phong`` or ``gaussian``. (Default: ``phong`` if
         the parameter ``exponent`` exists, else ``beckmann``)

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

     * - multiple_scattering
       - |bool|
       - Whether the two facets of a cavity reflect light to each other. Light that is refracted after a reflection
         between facets stays lost. (Default: false, as in the thesis)

     * - ambient
       - |spectrum| or |texture|
       - Fraction of the ambient light that the surface reflects, for integrators with ambient light. (Default: black)
       - |exposed|, |differentiable|

    The surface reflects and refracts by Fresnel's equations and Snell's law (thesis, sections 2.2.3 and 5.1), total
    reflection included, from both sides. A rough surface reflects by the model of Torrance and Sparrow, as
    :ref:`prosim_conductor <bsdf-prosim_conductor>` does. It refracts by the model of Walter et al. (2007), with the
    product of the V-cavities' :math:`G_1` of both directions. An ideally smooth surface is equal to Mitsuba's
    :ref:`dielectric <bsdf-dielectric>`. The components are reflected and transmitted.

    If an index depends on the wavelength, the glass is dispersive (Thomas 1986). A smooth surface then refracts only
    one of the wavelengths of a ray, and increases the weight of this wavelength. RGB variants choose one of r, g and b,
    which stand for 635, 544 and 437 nm. The surface reflects all wavelengths. A rough surface evaluates each
    wavelength. :ref:`prosim <integrator-prosim>` chooses among the wavelengths that the ray still carries. Mitsuba's
    integrators choose again at each surface, which is unbiased and noisier.

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

    PARAMETERS = ("specular_reflectance", "specular_transmittance")

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.indices = dispersion.Indices(props)
        #: Whether an index of refraction depends on the wavelength.
        self.disperses = self.indices.eta is None
        self.specular_reflectance = reflectance(props, "specular_reflectance")
        self.specular_transmittance = reflectance(props, "specular_transmittance")
        self.distribution, self.roughness = roughness(props)
        self.multiple_scattering = flag(props, "multiple_scattering")
        # Without refraction, the facet between two directions is not defined.
        if self.roughness is not None and self.indices.inside == self.indices.outside:
            raise reject(props, "int_ior", self.indices.inside, "another index than ext_ior, for a rough surface")
        flags = mi.BSDFFlags
        sides = flags.FrontSide | flags.BackSide
        transmission = flags.DeltaTransmission if self.roughness is None else flags.GlossyTransmission
        self.set_components({self.specular_type(): sides, transmission: sides | flags.NonSymmetric})

    def probability(self, ctx: mi.BSDFContext, reflected: mi.Bool, f: mi.Float) -> mi.Float:
        """Returns the probability of sampling the reflection where ``reflected``, else that of the transmission."""
        return dr.select(reflected, f, 1 - f) if all(self.enabled(ctx)) else mi.Float(1)

    def fraction(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, reflected: mi.Bool, face: Interface, active: mi.Bool
    ) -> mi.UnpolarizedSpectrum:
        """Returns the fraction of the light that a facet reflects (where ``reflected`` is true) or transmits
        (elsewhere), as a spectrum.

        ``face`` has the facet's reflectance and relative index of refraction, for one wavelength or for each channel.
        Transmitted radiance is divided by the square of the relative index, because refraction changes the solid angle
        of the light; transmitted importance is not.
        """
        r, t = (factor(each, si, active) for each in (self.specular_reflectance, self.specular_transmittance))
        if ctx.mode == mi.TransportMode.Radiance:
            t = t * dr.square(dr.rcp(face.eta_it))
        return mi.UnpolarizedSpectrum(dr.select(reflected, face.f * r, (1 - face.f) * t))

    def directional_albedo(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.UnpolarizedSpectrum:
        f = fresnel.interface(mi.Float(1), self.indices.etas(si)[0]).f
        r, t = (factor(each, si, active) for each in (self.specular_reflectance, self.specular_transmittance))
        return mi.UnpolarizedSpectrum(f * r + (1 - f) * t)

    def sample(
        self,
        ctx: mi.BSDFContext,
        si: mi.SurfaceInteraction3f,
        sample1: mi.Float,
        sample2: mi.Point2f,
        active: mi.Bool = True,
        weights: Sequence[mi.Float] | None = None,
        undispersed: bool = False,
    ) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
        """Samples a direction; returns ``(bs, weight)``. ``weight`` is the value of the BSDF times the cosine of the
        direction, divided by the density ``bs.pdf``; both are 0 if no direction was sampled.

        Smooth dispersive glass reflects all wavelengths of a ray, but refracts only one, which is chosen with the
        probabilities ``weights``: an integrator that knows the ray's throughput passes ``weights`` proportional to it,
        which is less noisy than equal probabilities (None). Rough dispersive glass ignores ``weights``: an equally
        probable wavelength determines the direction, and the weight counts all wavelengths. If ``undispersed`` is true,
        all wavelengths are refracted in the direction of the middle wavelength, which is biased, but avoids colour
        noise in an albedo image.
        """
        bs = dr.zeros(mi.BSDFSample3f)
        reflection, transmission = self.enabled(ctx)
        active = active & (dr.abs(si.wi.z) > GRAZING)
        if active is False or not (reflection or transmission):
            return bs, mi.Spectrum(0)
        m, front = mi.Normal3f(0, 0, 1), dr.mulsign(si.wi, si.wi.z)
        if self.roughness is not None:
            width = self.roughness.eval_1(si, active)
            m = facets.sample_visible(front, sample2, self.distribution, width)
        i_m = dr.dot(si.wi, m)
        etas = self.indices.etas(si)
        faces = [fresnel.interface(i_m, eta) for eta in etas]
        p = [1 / len(etas)] * len(etas) if weights is None or self.roughness is not None else list(weights)
        if undispersed:
            p = [float(k == len(etas) // 2) for k in range(len(etas))]
        k, rest = dispersion.choose(p, sample1)
        face = Interface(*(dispersion.pick(k, values) for values in zip(*faces)))
        reflected = rest <= face.f if reflection and transmission else mi.Mask(reflection)
        mirrored = mi.reflect(si.wi, m)
        if self.multiple_scattering and self.roughness is not None:
            u = rest / face.f if transmission else rest
            mirrored = dr.mulsign(grooves.leave(front, m, u, self.distribution, width), si.wi.z)
        bs.wo = dr.select(reflected, mirrored, mi.refract(si.wi, m, face.cos_t, face.eta_ti))
        bs.eta = dr.select(reflected, 1, face.eta_it)
        bs.sampled_component = dr.select(reflected, mi.UInt32(0), mi.UInt32(1))
        bs.sampled_type = dr.select(reflected, mi.UInt32(+self.types[0]), mi.UInt32(+self.types[1]))
        if self.roughness is None:
            spectra = Interface(*map(dispersion.spectrum, zip(*faces)))
            # If the ray is refracted, only the channel of the chosen wavelength keeps its value.
            kept = [dr.select(reflected | undispersed | (k == j), 1.0, 0.0) for j in range(len(faces))]
            value = self.fraction(ctx, si, reflected, spectra, active) * mi.UnpolarizedSpectrum(*kept)
            mean = sum((p[j] * each.f for j, each in enumerate(faces)), mi.Float(0))
            chosen = dispersion.pick(k, p)
            both = reflection and transmission
            pdf = dr.select(reflected, mean, chosen * (1 - face.f)) if both else dr.select(reflected, 1, chosen)
            pdf = divisor = dr.detach(mi.Float(pdf))
        else:
            bs.wo = dr.detach(bs.wo)
            active = active & (i_m * si.wi.z > 0) & (bs.wo.z != 0) & (((si.wi.z > 0) == (bs.wo.z > 0)) == reflected)
            # The total reflection of this wavelength may be partial for others.
            value, pdf = self.eval_pdf(ctx, si, bs.wo, active & (reflected | (face.cos_t != 0)))
            value, divisor = mi.unpolarized_spectrum(value), dr.detach(pdf)
        active = active & (pdf > 0)
        bs.pdf = dr.select(active, pdf, 0)
        return bs, mi.depolarizer(value / dr.select(active, divisor, 1)) & active

    def eval_facet(
        self, wi: mi.Vector3f, wo: mi.Vector3f, facet: Facet, reflected: mi.Bool, width: mi.Float, eta: mi.Float
    ) -> tuple[mi.Float, mi.Float]:
        """Returns ``(value, pdf)`` of the microfacets with the normal of ``facet``, which scatter light from ``wo`` to
        ``wi``, without Fresnel's factors.

        ``value`` and ``pdf`` have the common factor D(m) <wi, m> / cos_i times dm / dwo, the ratio of the solid angles
        of m and wo (Walter and others 2007, equations 14 and 17). ``value`` has the further factor G (masking and
        shadowing), ``pdf`` G1(wi) (masking). ``width`` is the roughness; ``eta`` is the index inside divided by the
        index outside, eta_it that on the side of wo divided by that on the side of wi. By Snell's law, i_m - eta_it o_m
        is (1 - eta_it²) / (i_m + eta_it o_m), which loses no digits for indices near 1.
        """
        cos_i, cos_o, m = dr.abs(wi.z), dr.abs(wo.z), facet.m
        a, b = dr.abs(facet.i_m), dr.maximum(dr.abs(facet.o_m), 1e-30)
        visible = dr.minimum(a / cos_i, 2 * m.z)  # G1 <wi, m> / cos_i
        eta_it = dr.select(wi.z > 0, eta, dr.rcp(eta))
        inverse_length = (a + eta_it * b) / dr.maximum(dr.abs(fresnel.eta2_minus_1(wi.z, eta)), 1e-7)
        jacobian = dr.select(reflected, 0.25 / dr.maximum(a, 1e-30), dr.square(eta_it * inverse_length) * b)
        density = self.distribution.D(m, width) * jacobian
        lit = dr.select(reflected, dr.minimum(visible, 2 * m.z * cos_o / cos_i), visible * facets.g1(cos_o, m.z, b))
        return density * lit, density * visible

    def eval_pdf(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool = True
    ) -> tuple[mi.Spectrum, mi.Float]:
        """Returns the value times the cosine of ``wo``, and the density of :meth:`sample`; 0 for smooth glass."""
        # Each wavelength has its own facet and its own value. The density is the mean of their densities.
        reflected = (si.wi.z > 0) == (wo.z > 0)
        reflection, transmission = self.enabled(ctx)
        active = active & (dr.abs(si.wi.z) > GRAZING) & (wo.z != 0) & dr.select(reflected, reflection, transmission)
        if active is False or self.roughness is None or not (reflection or transmission):
            return mi.Spectrum(0), mi.Float(0)
        width, etas = self.roughness.eval_1(si, active), self.indices.etas(si)
        values, faces, further, pdf = [], [], [], mi.Float(0)
        for eta in etas:
            facet = facets.facet_between(si.wi, wo, eta)
            # The front of a facet is visible only from the front of the surface, and its back only from the back.
            facing = active & (facet.i_m * si.wi.z > 0) & (facet.o_m * wo.z > 0)
            lit, density = self.eval_facet(si.wi, wo, facet, reflected, width, eta)
            faces.append(fresnel.interface(facet.i_m, eta))
            values.append(dr.select(facing, lit, 0))
            if self.multiple_scattering:
                density = dr.select(reflected, lit, density)

                def reflectance(cos: mi.Float, eta: mi.Float = eta) -> mi.Float:
                    return fresnel.interface(dr.mulsign(cos, si.wi.z), eta).f

                again, p = grooves.reflect_again(
                    (dr.mulsign(si.wi, si.wi.z), dr.mulsign(wo, si.wi.z)),
                    self.distribution,
                    width,
                    reflectance,
                    active & reflected,
                    lambda f: self.probability(ctx, mi.Mask(True), f),
                )
                further.append(again)
                pdf += p / len(etas)
            pdf += dr.select(facing, density * self.probability(ctx, reflected, faces[-1].f), 0) / len(etas)
        spectra = Interface(*map(dispersion.spectrum, zip(*faces)))
        value = self.fraction(ctx, si, reflected, spectra, active) * dispersion.spectrum(values)
        if self.multiple_scattering:
            value += dispersion.spectrum(further) * factor(self.specular_reflectance, si, active)
        return mi.depolarizer(value) & active, pdf

    def parameters(self) -> dict[str, Any]:
        return {**self.indices.parameters(), **super().parameters()}
