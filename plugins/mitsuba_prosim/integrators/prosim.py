"""The stochastic ray tracer of the thesis (chapter 4, sections 5.3 and 5.4), with optional photons and path tracing.

The integrator can take more samples in noisy pixels than in other pixels. Each sampled domain (the pixel, the lens,
each light source and each lobe) has its own N-rook pattern, or its own Sobol' points.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

from ..alone import alone_if_traced
from ..engine.integrator import ProgressiveIntegrator
from ..light.source import read_emission, shown
from ..parameters import choice, expose, flag, number, reject, whole
from ..registry import plugin
from ..sampling.nrook import SamplerPoints
from ..transport.radiance import KINDS
from ..transport.transport import Transport
from ..transport.transport_context import DEEPEST_TREE, SETTINGS, Settings
from ..transport.workarounds import warn_of_undivided_lobes, warn_of_wrong_derivatives

if TYPE_CHECKING:
    from ..engine.derivatives import Derivatives
    from ..photons.caustics import Caustics


@plugin("integrator", "prosim")
class Prosim(ProgressiveIntegrator):
    r"""
    .. _integrator-prosim:

    Stochastic ray tracer with adaptive N-rook sampling (:monosp:`prosim`)
    ----------------------------------------------------------------------

    .. pluginparameters::

     * - samples
       - |int|
       - :math:`N`: number of samples of a pass; :math:`N` passes fill a pattern of :math:`N^2`. With
         :monosp:`noise` or :monosp:`time`, the first pass has the largest power of two up to :math:`N`. (Default: 5)

     * - adaptive
       - |string|
       - Policy. :monosp:`neighbours`: a pixel gets all :math:`N^2` samples if the 24 pixels around it are noisy.
         :monosp:`graded`: in proportion to the standard deviation in the 24 pixels around.
         :monosp:`thesis`: :math:`N` samples at a time, until the pixel's own standard error is small;
         :monosp:`variance`: until the variance of its samples is small. :monosp:`none`: always :math:`N^2`. (Default:
         :monosp:`neighbours`; :monosp:`graded` with :monosp:`noise` or :monosp:`time`)

     * - threshold
       - |float|
       - Standard error of a pixel that needs no more samples: of the displayed value (white = 1) for
         :monosp:`neighbours` and :monosp:`graded`, of the radiance for :monosp:`thesis`. For
         :monosp:`variance`, the variance of a sample (Default: 0.006)

     * - min_passes, max_samples
       - |int|
       - Minimum number of passes (Default: 1) and maximum number of samples of a pixel (Default: :math:`N^2`, four
         times as many for :monosp:`graded`, unlimited with :monosp:`noise` or :monosp:`time`)

     * - noise, noise_99, time
       - |float|
       - Error targets of the displayed image (white = 1): the RMS error, and the error of 99 % of the pixels; and a
         limit in seconds. The render ends when all errors are within their targets, or at the time limit. Not
         with :monosp:`thesis` and :monosp:`variance`. (Default: 0, none)

     * - max_level
       - |int|
       - Maximum depth of reflected and refracted rays. 0: only the first visible surface; -1: unlimited, for paths
         (Default: 4)

     * - shadows
       - |bool|
       - Cast shadow rays (Default: |true|)

     * - ambient
       - |spectrum| or |texture|
       - Ambient intensity :math:`I_a`; a surface adds :math:`k_a I_a` (Default: 0)

     * - background
       - |spectrum| or |texture|
       - Radiance of a ray that leaves the scene; beside a sky that :monosp:`hide_emitters` hides, only of camera rays.
         It lights diffuse surfaces only with :monosp:`diffuse_bounces`. A bitmap is a latitude-longitude map, as for
         :monosp:`envmap`. (Default: 0)

     * - diffuse_bounces
       - |int|
       - Number of diffuse reflections that are followed. 0: none, as in the thesis; -1: all, which is path tracing.
         If the number is not 0, each vertex samples one lamp, chosen by an estimate of its light. (Default: 0)

     * - caustics
       - |bool|
       - Use photons for the light that specular surfaces focus on diffuse surfaces; not in scalar variants
         (Default: |false|)

     * - caustic_photons
       - |int|
       - Number of photons that are emitted for each :math:`N^2` samples of a pixel (for each 64, if that is less). A
         photon takes 40 to 52 bytes. (Default: 1048576)

     * - cutoff
       - |float|
       - Throughput at or below which a branch ends (Default: 0)

     * - rr_depth
       - |int|
       - Level from which Russian roulette may end any path; only with :monosp:`diffuse_bounces` (Default: 5)

     * - rr_throughput
       - |float|
       - Throughput below which Russian roulette may end paths and branches of the tree; 0: never (Default: 0.2 for
         paths, 0.01 for a tree with :monosp:`caustics`, else 0)

     * - hide_emitters
       - |bool|
       - Camera rays, also through holes of surfaces, do not see light sources (Default: |false|)

     * - jitter
       - |string|
       - Place of a sample in its cell: :monosp:`multi` or :monosp:`uniform`, see :ref:`sampler-nrook`
         (Default: :monosp:`multi`)

     * - channels
       - |string|
       - Which of r, g and b are written; the others are black (Default: :monosp:`rgb`)

     * - aovs
       - |string|
       - Further channels, separated by commas: :monosp:`samples` (number per pixel), :monosp:`error` (standard error
         of the luminance), or :monosp:`name:type` as for the :monosp:`aov` integrator (Default: none)

     * - layers
       - |string|
       - :monosp:`lights`: parts of the image in further channels :monosp:`NAME.R`, :monosp:`.G`, :monosp:`.B`, whose
         sum is the image, one for each source by its id, one for the :monosp:`background` and one for the
         :monosp:`ambient` term; at most 32, not with :monosp:`caustics` (Default: :monosp:`none`)

     * - band
       - |int|
       - Number of pixels that are rendered at a time. This number bounds the memory and does not change the image.
         (Default: 262144)

    Distributed ray tracing as in the thesis. At each surface, the integrator adds the ambient term and the light of
    *every* source, scattered by the whole BRDF. Then the integrator follows the reflected and the refracted ray, each
    sampled from its lobe. The integrator follows no rays of diffuse lobes. So caustics and diffuse interreflection are
    missing, unless :monosp:`caustics` and :monosp:`diffuse_bounces` add them. Multiple importance sampling combines
    lobes and sources.

    Two kinds of light are noisy: highlights of smooth surfaces that are seen in rough surfaces, without
    :monosp:`caustics`; and, on diffuse surfaces, the light of sources other than spheres and a constant sky.

    **Caustics.** Photons travel from each source through at most :monosp:`max_level` + 1 specular surfaces to diffuse
    surfaces. Each photon counts within the width of a pixel, or within more where photons are sparse. Photons also
    count on rough surfaces behind smooth surfaces, where they share the light with the rays of the lobe. Each sample of
    a pixel has its own photons, so that more samples reduce the noise of the photons. Paths leave this light to the
    photons. In spectral variants all pixels share the wavelengths of the photons. Photons come from all sources of this
    package and from Mitsuba's :monosp:`area`, :monosp:`point`, :monosp:`spot`, :monosp:`projector`,
    :monosp:`directional`, :monosp:`constant`, :monosp:`envmap` and :monosp:`sunsky`. Caustics are not possible in
    scalar variants and within another integrator.

    **Samples.** Each space (the pixel, the lens, each source and each lobe at each node) has its own N-rook pattern.
    :monosp:`graded`, :monosp:`noise`, :monosp:`time`, a nonzero :monosp:`spp` and more than :math:`N^2` samples use
    Owen-scrambled Sobol' points (see :ref:`sampler-owen`). A sample is a pure function of seed, pixel, space and index.
    So the bits of the image do not depend on crop windows, :monosp:`band` and the number of threads. There are two
    exceptions: with :monosp:`noise` the bits depend on the crop window, and with :monosp:`time` the bits depend on crop
    windows, :monosp:`band` and the number of threads. The reconstruction filter weights each sample by one over the
    number of samples in its pixel. The sensor's sampler is not used. With a nonzero :monosp:`spp` of ``render()``, each
    pixel gets exactly this number of samples, whatever targets and policy are set here.

    **Lobes** are selected by the type mask of Mitsuba's :monosp:`BSDFContext`. BSDFs without separate lobes
    (:monosp:`principled`, :monosp:`principledthin`, :monosp:`hair`, :monosp:`pplastic`, and your own in Python) are
    sampled as a whole. The light that such a BSDF reflects is found only by light sampling, and is noisy if the BSDF is
    smooth. With :monosp:`caustics` such a BSDF counts as diffuse.

    **Absorption.** The inside of a shape absorbs light by Beer's law if the :monosp:`interior` of the shape is a
    :monosp:`homogeneous` medium with :monosp:`albedo` 0. A shape within this medium must have the medium as its
    :monosp:`exterior`, and a camera within this medium must have the medium as its :monosp:`medium`. :monosp:`volpath`
    renders a scene with such a medium equally. All other media count as empty, with a warning.

    **Alpha** is 1 where a camera ray meets a surface, the sky or the background. It is 0 where the ray leaves the scene
    otherwise, and a fraction behind a :monosp:`mask`.

    **Ambient light** needs the attribute :monosp:`ambient` of a BSDF, which the materials of this package have. The
    attribute also works within :monosp:`twosided`, :monosp:`mask`, :monosp:`blendbsdf`, :monosp:`bumpmap` and
    :monosp:`normalmap`.

    **Derivatives**, forward and backward, are those of the samples that form the image. Parameters of materials and
    sources have derivatives, and so do the places of sources, lit objects and mirrors. The derivatives of edges that
    cover or uncover something are missing: silhouettes, shadows, and objects in glossy and diffuse reflections.
    :monosp:`time` and :monosp:`caustics` raise an error. Mitsuba's :monosp:`prb` supports the materials and sources of
    this package and is faster.

    In scalar variants, and within another integrator (:monosp:`aov`, :monosp:`moment`), every pixel gets the samples of
    the sensor's sampler; the AOVs :monosp:`samples` and :monosp:`error` raise an error.

    .. tabs::
        .. code-tab:: xml

            <integrator type="prosim">
                <integer name="samples" value="5"/>
                <integer name="max_level" value="3"/>
                <rgb name="ambient" value="0.1, 0.1, 0.1"/>
            </integrator>

        .. code-tab:: python

            'type': 'prosim',
            'samples': 5,
            'max_level': 3,
            'ambient': {
                'type': 'rgb',
                'value': [0.1, 0.1, 0.1]
            }
    """

    name = "prosim"

    def __init__(self, props: mi.Properties) -> None:
        """Raises ValueError for wrong values and combinations, and for ``caustics`` and ``layers`` in scalar
        variants.
        """
        super().__init__(props)
        self.max_level = whole(props, "max_level", 4, -1)
        self.diffuse_bounces = whole(props, "diffuse_bounces", 0, -1)
        if self.diffuse_bounces == 0 and not 0 <= self.max_level <= DEEPEST_TREE:
            allowed = f"0 to {DEEPEST_TREE} for a ray tree (-1, any level, goes with diffuse_bounces)"
            raise reject(props, "max_level", self.max_level, allowed)
        self.shadows = flag(props, "shadows", True)
        self.ambient = read_emission(props, "ambient")
        self.background = read_emission(props, "background")
        self.cutoff = number(props, "cutoff", 0.0, 0)
        self.rr_depth = whole(props, "rr_depth", 5, 0)
        self.caustics = flag(props, "caustics")
        usual = 0.2 if self.diffuse_bounces else 0.01 if self.caustics else 0.0
        self.rr_throughput = number(props, "rr_throughput", usual, 0)
        self.caustic_photons = whole(props, "caustic_photons", 1 << 20, 1)
        self.layers = choice(props, "layers", KINDS)
        if not dr.is_jit_v(mi.Float):
            here = f"in the variant {mi.variant()}; llvm_ad_rgb, llvm_ad_spectral and the like know"
            if self.caustics:
                allowed = f"false {here} photons, and prosim render --no-caustics leaves them out"
                raise reject(props, "caustics", True, allowed)
            if self.layers != "none":
                raise reject(props, "layers", self.layers, f'"none" {here} layers')
        if self.layers != "none" and self.caustics:
            raise reject(props, "layers", self.layers, '"none" with caustics, as photons do not know their source')
        self.layer_names: list[str] = []  # those of the last rendered scene

    def traverse(self, callback: mi.TraversalCallback) -> None:
        expose(callback, ambient=shown(self.ambient), background=shown(self.background))

    def aov_names(self) -> list[str]:
        """Returns the names of all AOVs; those of ``layers``, which depend on the scene, only after a render."""
        return [f"{name}.{letter}" for name in self.layer_names for letter in "RGB"] + super().aov_names()

    def parameter_names(self) -> list[str]:
        return [*super().parameter_names(), *SETTINGS, "caustics", "caustic_photons"]

    @alone_if_traced()
    def sample(
        self,
        scene: mi.Scene,
        sampler: mi.Sampler,
        ray: mi.RayDifferential3f,
        medium: mi.Medium | None = None,
        active: mi.Bool = True,
    ) -> tuple[mi.Spectrum, mi.Bool, list[mi.Float]]:
        """Returns the radiance along ``ray``, whether the ray is opaque, and the values of the AOVs.

        Raises RuntimeError with ``layers``, ``caustics``, and the AOVs ``samples`` and ``error``, and in spectral and
        monochromatic variants if ``channels`` omits a colour.

        ``medium`` is the medium around the camera, which a render in a scalar variant already knows.
        """
        self._refuse_layers_and_caustics("are for its own render() alone, not within another integrator")
        # ``_scalar`` is the transport object of a render in a scalar variant, otherwise None.
        transport = self._scalar or Transport(self._settings(), scene, camera_medium=medium)
        L, alpha, _ = transport(ray, SamplerPoints(sampler), active)
        aovs = self._aovs_of_ray(scene, sampler, ray, active)
        # Mitsuba has only masks here. The opacity is a fraction where a surface lets a part of the light pass.
        return self._stored(L), alpha > (sampler.next_1d(active) if transport.sees_through else 0.5), aovs

    def _settings(self) -> Settings:
        return Settings(**{name: getattr(self, name) for name in SETTINGS})

    def transport(self, scene: mi.Scene, sensor: mi.Sensor, attached: bool = False) -> Transport:
        """Returns the :class:`.Transport` of the rays of ``sensor``, ``attached`` if the radiance must be
        differentiable; stores the names of the layers for :meth:`aov_names`.
        """
        caustics = self._caustics(scene, sensor) if self.caustics else None
        transport = Transport(self._settings(), scene, attached, sensor.get_medium(), caustics)
        self.layer_names = [*transport.layers]
        return transport

    def _derivatives(self, scene: mi.Scene, sensor: int | mi.Sensor, seed: int | mi.UInt32, spp: int) -> Derivatives:
        self._refuse_layers_and_caustics("have no derivatives")
        warn_of_wrong_derivatives(scene)
        if self.diffuse_bounces >= 0:
            warn_of_undivided_lobes(scene)
        return super()._derivatives(scene, sensor, seed, spp)

    def _refuse_layers_and_caustics(self, why: str) -> None:
        if self.layers != "none" or self.caustics:
            raise RuntimeError(f"prosim: layers and caustics {why}; leave them out there.")

    def _caustics(self, scene: mi.Scene, sensor: mi.Sensor) -> Caustics | None:
        from ..photons.caustics import Caustics  # imported only for an image, to load the plugins faster

        # Photons may meet as many specular surfaces as a camera ray may meet before a light source.
        deepest = self.max_level + 1 if self.max_level >= 0 else 1 << 31
        # In a ray tree, BSDFs without separable lobes scatter photons by all their specular lobes. No light is counted
        # twice, because no ray of the tree goes from a diffuse surface to such a BSDF. See :class:`.PhotonTracer`.
        return Caustics.of(scene, sensor, self.caustic_photons, deepest, tree=self.diffuse_bounces == 0)
