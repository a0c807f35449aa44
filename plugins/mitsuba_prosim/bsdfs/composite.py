"""Painted and enamelled surfaces: prosim_composite."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi

from ..optics import fresnel
from ..optics.dispersion import index, optical_constant
from ..optics.material import LARGEST_SUM, Evaluated, Pigmented, pigment_sums, reflectance
from ..parameters import flag, for_message, reject
from ..registry import plugin


@plugin("bsdf", "prosim_composite")
class Composite(Pigmented):
    r"""
    .. _bsdf-prosim_composite:

    Painted and enamelled surfaces (:monosp:`prosim_composite`)
    -----------------------------------------------------------

    .. pluginparameters::

     * - diffuse_reflectance
       - |spectrum| or |texture|
       - Fraction of the light that the pigment reflects, :math:`k_d`. (Default: 0.5)
       - |exposed|, |differentiable|

     * - specular_reflectance
       - |spectrum| or |texture|
       - Weight of the specular lobe, :math:`k_s`. Numbers and colours with :math:`k_d + k_s > 1` are an error, also if
         :math:`k_d` has its default. Where textures, spectra or changed values have a sum above 1, :math:`k_s` is
         reduced to :math:`1 - k_d`. (Default: ``1 - diffuse_reflectance``)
       - |exposed|, |differentiable|

     * - int_ior
       - |float|, |string|, |spectrum| or |texture|
       - Index of refraction of the varnish, > 0, or a name such as ``water``. With a colour, each channel has its
         index. (Default: ``polypropylene``)
       - |exposed| and |differentiable| if it is a spectrum or a texture

     * - ext_ior
       - |float| or |string|
       - Index of refraction of the medium outside, > 0, or a name. (Default: ``air``)

     * - eta
       - |float|
       - Relative index ``int_ior / ext_ior`` of a number or a name: no parameter, but exposed.
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

     * - multiple_scattering
       - |bool|
       - Whether the two facets of a cavity reflect light to each other. (Default: false, as in the thesis)

     * - ambient
       - |spectrum| or |texture|
       - Fraction of the ambient light that the surface reflects, for integrators with ambient light. (Default:
         ``diffuse_reflectance``)
       - |exposed|, |differentiable|

    A dielectric over a pigment (thesis, sections 3.1.1 and 5.1), :math:`\rho = k_s \rho_s + k_d / \pi`: a white
    highlight on a coloured body. :math:`\rho_s` is the lobe of :ref:`prosim_conductor <bsdf-prosim_conductor>` with the
    reflectance of a dielectric. As in the thesis, the varnish does not dim the light of the pigment. The condition
    :math:`k_s + k_d \le 1` bounds the energy. The material is one-sided. Its components are specular and diffuse.

    .. tabs::
        .. code-tab:: xml

            <bsdf type="prosim_composite">
                <rgb name="diffuse_reflectance" value="0.5, 0.1, 0.1"/>
                <float name="specular_reflectance" value="0.4"/>
                <float name="int_ior" value="1.5"/>
                <float name="exponent" value="50"/>
            </bsdf>

        .. code-tab:: python

            'type': 'prosim_composite',
            'diffuse_reflectance': {
                'type': 'rgb',
                'value': [0.5, 0.1, 0.1]
            },
            'specular_reflectance': 0.4,
            'int_ior': 1.5,
            'exponent': 50.0
    """

    PARAMETERS = ("diffuse_reflectance", "specular_reflectance", "eta", "int_ior", "ext_ior")
    is_limited = True
    #: The relative index if it is a number; otherwise the texture of the index inside, and the index outside.
    eta: Any = None
    int_ior: Any = None
    ext_ior: Any = None

    def __init__(self, props: mi.Properties) -> None:
        check_sum(props)  # before the parameters become textures
        super().__init__(props)
        self.specular_reflectance = reflectance(props, "specular_reflectance")
        self.ambient = self.ambient or self.diffuse_reflectance
        outside = index(props, "ext_ior", "air")
        if isinstance(props.get("int_ior", ""), (int, float, str)):
            self.eta = mi.Float(index(props, "int_ior", "polypropylene") / outside)
            dr.make_opaque(self.eta)
        else:
            self.int_ior, self.ext_ior = optical_constant(props, "int_ior", 1.0, open_below=True), outside
        self.multiple_scattering = flag(props, "multiple_scattering")

    def reflected(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> Callable[[mi.Float], Any]:
        """Returns a function: the reflectance of the varnish for light at a given cosine to a facet."""
        if self.int_ior is None:
            return lambda cos: fresnel.interface(cos, self.eta).f
        eta = self.int_ior.eval(si, active) / self.ext_ior
        return lambda cos: mi.UnpolarizedSpectrum(*(fresnel.interface(cos, channel).f for channel in eta))

    def specular_weight(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.UnpolarizedSpectrum:
        return self.specular_factor(si, active) * self.reflected(si, active)(si.wi.z)

    specular_sample = Pigmented.sample_facets

    def specular_eval_pdf(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
    ) -> Evaluated:
        value, pdf = self.eval_facets(si, wo, self.reflected(si, active), active)
        return self.specular_factor(si, active) * value, pdf


def check_sum(props: mi.Properties) -> None:
    """Raises ValueError if the diffuse and the specular reflectance, numbers or colours, add up to more than 1 (thesis,
    section 3.1.1: s + d = 1). The sum of textures and spectra is unknown.
    """
    sums = pigment_sums(props, ())
    if max(sums, default=0) > LARGEST_SUM:
        note = "" if "diffuse_reflectance" in props else " (diffuse_reflectance is 0.5 if not given)"
        name = "diffuse_reflectance + specular_reflectance"
        raise reject(props, name, for_message(sums), f"a sum <= 1{note}, or energy would be created")
