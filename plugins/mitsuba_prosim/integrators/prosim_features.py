"""An integrator that renders the feature images which a denoiser uses: the albedo and the normal of each pixel."""

from __future__ import annotations

from typing import Any

import mitsuba as mi

from ..alone import alone, alone_if_traced
from ..compat import take_back_interrupts
from ..engine.channels import check_aovs, to_rgb
from ..parameters import check_samples, check_unpolarized, describe, pick_sensor
from ..registry import plugin
from ..transport import features


@plugin("integrator", "prosim_features")
class ProsimFeatures(mi.SamplingIntegrator):
    r"""
    .. _integrator-prosim_features:

    Features of a view, for denoising (:monosp:`prosim_features`)
    -------------------------------------------------------------

    .. pluginparameters::

     * - hide_emitters
       - |bool|
       - Camera rays do not see light sources (Default: |false|)

    Renders the visible albedo. The further channels :monosp:`albedo.R`, :monosp:`.G`, :monosp:`.B` and
    :monosp:`normal.X`, :monosp:`.Y`, :monosp:`.Z` are inputs of :monosp:`mitsuba_prosim.denoise`.

    The albedo is the albedo of the diffuse lobes, plus the albedo that the specular lobes show through up to six
    reflections and refractions, with the colour of metals and Fresnel's equations. The albedo of light sources and of
    the sky is their radiance, at most 1. The normal is the shading normal of the first surface, on the viewer's side.

    .. tabs::
        .. code-tab:: xml

            <integrator type="prosim_features"/>

        .. code-tab:: python

            'type': 'prosim_features'
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        check_unpolarized("prosim_features")
        self.hide_emitters = props.get("hide_emitters", False)

    def aov_names(self) -> list[str]:
        return list(features.NAMES)

    def render(
        self,
        scene: mi.Scene,
        sensor: int | mi.Sensor = 0,
        seed: int | mi.UInt32 = 0,
        spp: int = 0,
        *arguments: Any,
        **more: Any,
    ) -> mi.TensorXf:
        """Renders the albedo and the normals; no other thread renders with this package at the same time. Raises
        ValueError for a film of spectral bands.
        """
        view = pick_sensor(scene, sensor)
        check_samples(view, spp)
        check_aovs(view.film(), self.aov_names())
        with alone():  # all renders share the film
            try:
                return super().render(scene, sensor, seed, spp, *arguments, **more)
            finally:
                take_back_interrupts()

    @alone_if_traced()
    def sample(
        self,
        scene: mi.Scene,
        sampler: mi.Sampler,
        ray: mi.RayDifferential3f,
        medium: mi.Medium | None = None,
        active: mi.Bool = True,
    ) -> tuple[mi.Spectrum, mi.Bool, list[mi.Float]]:
        """Returns the albedo along ``ray``, whether a surface is met, and the channels of albedo and normal."""
        albedo, normal, hit = features.features(scene, sampler, mi.Ray3f(ray), active, self.hide_emitters, medium)
        # With this factor, an albedo of 1 at every wavelength becomes nearly white.
        scaled = albedo / mi.pdf_rgb_spectrum(ray.wavelengths) if mi.is_spectral else albedo
        return albedo, hit, [*to_rgb(scaled, ray.wavelengths), *normal]

    def to_string(self) -> str:
        return describe(self, hide_emitters=self.hide_emitters)
