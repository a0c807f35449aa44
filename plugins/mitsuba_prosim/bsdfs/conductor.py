"""Metals: prosim_conductor."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import drjit as dr
import mitsuba as mi

from ..optics import fresnel
from ..optics.dispersion import index, optical_constant
from ..optics.material import Evaluated, Material, factor, reflectance, roughness
from ..optics.nested import parts
from ..parameters import choice, flag, reject, text
from ..registry import create, plugin

#: Allowed values of the parameter ``fresnel`` -> the function that computes the reflectance.
FRESNEL = {"exact": fresnel.conductor, "thesis": fresnel.conductor_thesis}


@plugin("bsdf", "prosim_conductor")
class Conductor(Material):
    r"""
    .. _bsdf-prosim_conductor:

    Metal (:monosp:`prosim_conductor`)
    ----------------------------------

    .. pluginparameters::

     * - material
       - |string|
       - Name of a measured metal of Mitsuba's :ref:`conductor <bsdf-conductor>`: ``Cu``, ``Au``,
         ``Al``, ``Cu_palik`` (the tables that the thesis cites), ... Not together with ``eta`` or ``k``. (Default:
         none)

     * - eta, k
       - |spectrum| or |texture|
       - Index of refraction and extinction coefficient, >= 0. (Default: 0 and 1, a mirror that loses nothing)
       - |exposed|, |differentiable|

     * - ext_ior
       - |float| or |string|
       - Index of the medium outside, a number or a name such as ``water``. (Default: 1)

     * - fresnel
       - |string|
       - ``exact``, or ``thesis``: its approximation for :math:`\eta^2 + k^2 \gg 1`. (Default: ``exact``)

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

     * - specular_reflectance
       - |spectrum| or |texture|
       - Factor on the reflected light, in [0, 1]; physically 1. (Default: none)
       - |exposed|, |differentiable|

     * - multiple_scattering
       - |bool|
       - Whether the two facets of a cavity reflect light to each other. (Default: false, as in the thesis)

     * - ambient
       - |spectrum| or |texture|
       - Fraction of the ambient light that the surface reflects, for integrators with ambient light. (Default: black)
       - |exposed|, |differentiable|

    The model of Torrance and Sparrow (thesis, section 3.1.1; equation 3.1). The surface consists of facets with the
    distribution :math:`D` of normals. Each facet is a mirror that reflects by Fresnel's equations. The facets form
    V-shaped cavities, in which they shadow and mask one another (:math:`G`). Facets are sampled in proportion to their
    visible area (Heitz and d'Eon 2014), so that no sample has a weight above :math:`F`. The model loses the light that
    two facets reflect in turn, up to half of it: ``docs/optics.md`` has a table. With ``multiple_scattering`` no light
    is lost, so rough metals are brighter and more colourful. The material is one-sided: its back is black, unless it is
    put into :ref:`twosided <bsdf-twosided>`.

    .. tabs::
        .. code-tab:: xml

            <bsdf type="prosim_conductor">
                <string name="material" value="Cu_palik"/>
                <float name="alpha" value="0.2"/>
            </bsdf>

        .. code-tab:: python

            'type': 'prosim_conductor',
            'material': 'Cu_palik',
            'alpha': 0.2
    """

    PARAMETERS = ("eta", "k", "specular_reflectance", "ext_ior", "fresnel")

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.eta, self.k = metal(props)
        self.ext_ior = index(props, "ext_ior", 1.0)
        self.specular_reflectance = reflectance(props, "specular_reflectance")
        self.distribution, self.roughness = roughness(props)
        self.fresnel = choice(props, "fresnel", tuple(FRESNEL))
        self.multiple_scattering = flag(props, "multiple_scattering")
        self.set_components({self.specular_type(): mi.BSDFFlags.FrontSide})

    def reflected(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> Callable[[mi.Float], mi.UnpolarizedSpectrum]:
        """Returns Fresnel's reflectance times ``specular_reflectance``, as a function of the cosine to a facet."""
        eta, k = (texture.eval(si, active) * (1 / self.ext_ior) for texture in (self.eta, self.k))
        specular = factor(self.specular_reflectance, si, active)
        return lambda cos: FRESNEL[self.fresnel](cos, eta, k) * specular

    def directional_albedo(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.UnpolarizedSpectrum:
        return self.reflected(si, active)(mi.Float(1))

    def sample_direction(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, sample1: mi.Float, sample2: mi.Point2f, active: mi.Bool
    ) -> tuple[mi.Vector3f, mi.UInt32, mi.Float, mi.UnpolarizedSpectrum]:
        """Samples the reflected direction (:meth:`.Material.sample_direction`): in the mirror direction, with ``pdf``
        1, if the surface is smooth, else from a visible facet. ``pdf`` is 0 if the facet reflects below the surface.
        """
        if self.roughness is None:
            return mi.reflect(si.wi), mi.UInt32(0), mi.Float(1), self.reflected(si, active)(si.wi.z)
        wo = dr.detach(self.sample_facets(si, sample1, sample2, active))
        value, pdf = self.eval_pdf(ctx, si, wo, active)
        return wo, mi.UInt32(0), pdf, mi.unpolarized_spectrum(value) / dr.detach(dr.select(pdf > 0, pdf, 1))

    def evaluate(self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool) -> Evaluated:
        return self.eval_facets(si, wo, self.reflected(si, active), active)


def metals() -> list[str]:
    """Returns the names of the metals that Mitsuba has in files; none if the folder is not found."""
    folder = Path(str(mi.file_resolver().resolve("data/ior/Cu.k.spd"))).parent
    return sorted(p.name.removesuffix(".k.spd") for p in folder.glob("*.k.spd"))


def metal(props: mi.Properties) -> tuple[mi.Texture, mi.Texture]:
    """Returns ``(eta, k)``, two textures: the complex index of refraction of the metal, from Mitsuba's files for the
    parameter ``material``, else from ``eta`` and ``k``, by default 0 and 1, a perfect mirror.

    Raises ValueError for wrong parameters, and RuntimeError if the files of a metal cannot be read.
    """
    material = text(props, "material", "none")
    for name in ("eta", "k"):
        if material != "none" and name in props:
            raise reject(props, name, props[name], f'no "{name}" together with "material", which is {material!r}')
    if material == "none":
        return optical_constant(props, "eta", 0.0), optical_constant(props, "k", 1.0)
    try:
        conductor = create("conductor", material=material)
    except RuntimeError:
        names = metals()
        if not names or material in names:  # a table cannot be read
            raise
        raise reject(props, "material", material, f"none, {', '.join(names)}") from None
    found = parts(conductor)
    return found["eta"], found["k"]
