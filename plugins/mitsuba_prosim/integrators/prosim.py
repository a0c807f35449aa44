"""The stochastic ray tracer of the thesis, with adaptive N-rook sampling (chapter 4, sections 5.3 and 5.4)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

from ..alone import alone
from ..engine.film import aov_values
from ..engine.integrator import ProgressiveIntegrator
from ..light.emission import read_emission
from ..parameters import choice, expose, number, reject, whole
from ..registry import plugin
from ..sampling.nrook import SamplerPoints
from ..transport.context import DEEPEST_TREE, Settings
from ..transport.layers import KINDS, refusal
from ..transport.transport import Transport

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
       - :math:`N`: samples of a pass; :math:`N` passes fill a pattern of :math:`N^2` (Default: 5)

     * - adaptive
       - |string|
       - :monosp:`neighbours`: a pixel gets all :math:`N^2` samples where the 24 pixels around it are noisy.
         :monosp:`graded`: it gets as many samples as the variance within the 48 pixels around asks for, a power of two,
         or the first passes alone. :monosp:`thesis`: :math:`N` samples at a time, until the pixel's own are quiet.
         :monosp:`none`: always :math:`N^2`. (Default: :monosp:`neighbours`; :monosp:`graded` with :monosp:`noise` or
         :monosp:`time`)

     * - threshold
       - |float|
       - Standard error that is small enough: of the displayed value, white being 1, for :monosp:`neighbours` and
         :monosp:`graded`; of the radiance for :monosp:`thesis` (Default: 0.006)

     * - min_passes, max_samples
       - |int|
       - Passes that every pixel gets (Default: 1) and the most samples that one may get; where it is no multiple of
         :math:`N`, the last pass is cut short. (Default: :math:`N^2`, four times as many for :monosp:`graded`, and any
         with :monosp:`noise` or :monosp:`time`)

     * - noise, noise_99, noise_999, time
       - |float|
       - The image is taken on until the root mean square of the error of its displayed values, white being 1, is
         at most :monosp:`noise`, that of 99 pixels in 100 at most :monosp:`noise_99`, and that of 999 in 1000 at most
         :monosp:`noise_999`, which counts isolated bright pixels; or so many seconds have passed, whichever is
         first. Not with :monosp:`thesis`. (Default: 0, not asked for)

     * - max_level
       - |int|
       - Deepest level of reflected and refracted rays; 0: only the first visible surface; -1: any, for paths
         (Default: 4)

     * - shadows
       - |bool|
       - Cast shadow rays (Default: |true|)

     * - ambient
       - |spectrum| or |texture|
       - Ambient intensity :math:`I_a`; a surface adds :math:`k_a I_a` (Default: 0)

     * - background
       - |spectrum| or |texture|
       - Radiance of a ray that leaves the scene. A bitmap is looked up by direction, as
         :monosp:`envmap` does, but lights nothing. (Default: 0)

     * - diffuse_bounces
       - |int|
       - Diffuse reflections that are followed. 0: none, as in the thesis; -1: every one, which is path tracing. With
         any but 0, each vertex samples one lamp, chosen by an estimate of its light there
         (Default: 0)

     * - caustics
       - |bool|
       - Light that comes to diffuse surfaces by way of specular ones, from photons; in colour, monochrome and spectral
         variants, not in scalar ones (Default: |false|)

     * - caustic_photons
       - |int|
       - Photons that leave the sources for each :math:`N^2` samples of a pixel, or each 64 where that is less: of the
         order of the image's pixels, some times as many for a quiet image. They take 40 bytes each, 48 where
         they meet a rough surface, and in spectral variants four more. (Default: 1048576)

     * - cutoff
       - |float|
       - A branch whose throughput is not above this ends (Default: 0)

     * - rr_depth
       - |int|
       - Level from which Russian roulette ends paths; only with :monosp:`diffuse_bounces` (Default: 5)

     * - rr_throughput
       - |float|
       - A branch of the tree whose throughput is below this is followed by lot, as seldom as it is weaker, and counts
         as much more: many reflections within glass matter little, and are most of its rays. 0: all are followed
         (Default: 0.01 with :monosp:`caustics`, else 0)

     * - hide_emitters
       - |bool|
       - Camera rays do not see light sources (Default: |false|)

     * - jitter
       - |string|
       - Place of a sample in its cell: :monosp:`multi` or :monosp:`uniform`, see :ref:`sampler-nrook`
         (Default: :monosp:`multi`)

     * - channels
       - |string|
       - Which of r, g and b are written; the others are black (Default: :monosp:`rgb`)

     * - aovs
       - |string|
       - Further channels, separated by commas: :monosp:`samples` (per pixel), :monosp:`error` (standard error of the
         luminance), or :monosp:`name:type` as for the :monosp:`aov` integrator (Default: none)

     * - layers
       - |string|
       - Parts of the image in further channels :monosp:`NAME.R`, :monosp:`.G`, :monosp:`.B`, whose sum is the image:
         :monosp:`lights` (each source by its id, the background, the ambient term), :monosp:`levels` (what the
         surfaces of each level of the tree add, :monosp:`level0` first), :monosp:`terms` (of the equation at the first
         surface: :monosp:`emitted`, :monosp:`background`, :monosp:`ambient`, :monosp:`diffuse`, :monosp:`glossy`,
         :monosp:`caustics`, :monosp:`reflected`, :monosp:`refracted`, :monosp:`indirect`). At most 32; :monosp:`lights`
         not with :monosp:`caustics`, :monosp:`terms` not with :monosp:`diffuse_bounces` -1 (Default: :monosp:`none`)

     * - band
       - |int|
       - Pixels that are rendered at a time, which bounds the memory; it does not change the image
         (Default: 262144)

    Distributed ray tracing as the thesis has it: at the first visible surface, light from *every* source through the
    whole BRDF plus the ambient term, then both the reflected and the refracted ray, drawn from their lobes. Nothing is
    followed from a diffuse component, so caustics and diffuse interreflection are left out, unless
    :monosp:`caustics` and :monosp:`diffuse_bounces` say otherwise. What the lobes and the sources can both sample is
    shared by multiple importance sampling, so that the expected image is the same at any roughness.

    Two kinds of light are left noisy: what a rough surface sees of a smooth one's highlight, which only its lobe can
    find (isolated bright pixels) where there are no :monosp:`caustics`; and, on diffuse surfaces, sources other than
    spheres and a constant sky, which are sampled by their own methods.

    With :monosp:`caustics`, photons go from every source towards all that is specular, through it by at most
    :monosp:`max_level` + 1 reflections and refractions, and come to lie on diffuse surfaces, where they count within a
    pixel's width. So do those on rough surfaces that came by way of smooth ones alone, ideally or nearly: they share
    that light with the rays of the lobe by multiple importance sampling, which ends the bright pixels; but for those of
    point sources in nearly smooth surfaces, and in such that disperse. Each sample of a pixel has
    photons of its own, so that their noise falls with the samples. Paths leave the light on diffuse surfaces to them:
    nothing is counted twice. In spectral variants all pixels then have the same wavelengths,
    those of the photons, other ones with each sample. Sources are all of this package's, and of Mitsuba's
    :monosp:`area`, :monosp:`point`, :monosp:`spot`, :monosp:`projector`, :monosp:`directional`,
    :monosp:`directionalarea`, :monosp:`constant`, :monosp:`envmap` and :monosp:`sunsky`. (What a
    :monosp:`directionalarea` sends straight to a diffuse surface remains unseen, as it does with :monosp:`path`.)
    Materials that are taken whole (below) count as diffuse: they gather photons by all of their lobes. Without
    :monosp:`diffuse_bounces` their specular lobes send photons on too, to other materials than their like. Not in
    scalar variants, not nested in another integrator, and without derivatives.

    Every space (the pixel, the lens, each source and each lobe at each node) is sampled by its own N-rook pattern; with
    :monosp:`graded`, :monosp:`noise`, :monosp:`time`, a nonzero :monosp:`spp` and more than :math:`N^2` samples by its
    own Owen-scrambled Sobol' points (see :ref:`sampler-owen`), of which there may be any number. A
    sample is a pure function of seed, pixel, space and index: crop windows, :monosp:`band` and the number of
    threads do not change a bit of the image (with :monosp:`noise`, crop windows do; with :monosp:`time`, all may). The
    film's reconstruction filter weights each sample by one over the number of samples in its pixel. The sensor's
    sampler is not used. A nonzero :monosp:`spp` given to ``render()`` stands for :math:`N^2`, in the place of
    :monosp:`max_samples` and :monosp:`samples`; :monosp:`graded` may take up to four times as many in a pixel.

    Derivatives, forward and backward, are those of the image that the same seed gives, by its own samples; so
    :monosp:`time` and :monosp:`caustics` are refused there. To optimise parameters, Mitsuba's :monosp:`prb` is cheaper:
    it knows our materials and sources, and takes about half the time for as many samples.

    The lobes of a surface are told apart by the type mask of Mitsuba's :monosp:`BSDFContext`. BSDFs that have no
    separate lobes (:monosp:`principled`, :monosp:`principledthin`, :monosp:`hair`, :monosp:`pplastic`, also within
    others) are taken whole: the light of sources comes to them by sampling the sources alone, which is noisy where
    they are smooth. A :monosp:`mask` and a :monosp:`blendbsdf` are asked for their lobes with care: the mirror in a
    blend with what is dark is as bright as its share, which Mitsuba's own integrators make darker. (Not so where a
    :monosp:`bumpmap` or :monosp:`normalmap` holds a blend with what is taken whole: a warning says what to do.)

    What lies inside a shape absorbs light by Beer's law along a ray's way through it (Hall), if the shape's
    :monosp:`interior` is a :monosp:`homogeneous` medium whose :monosp:`albedo` is 0; shapes within it say so by their
    :monosp:`exterior`, a camera by its :monosp:`medium`. :monosp:`volpath` renders the same. Nothing is scattered:
    other media are taken for empty, with a warning.

    Ambient light is what a BSDF's attribute :monosp:`ambient` says, which this package's materials have; it is found
    within :monosp:`twosided`, :monosp:`mask`, :monosp:`blendbsdf`, :monosp:`bumpmap` and :monosp:`normalmap` too.
    The back of a one-sided surface reflects none.

    Derivatives, forward and backward, are those of the samples that the image is made of, by any parameter of materials
    and sources, and by the places of sources, of what they light, and of mirrors. Left out is what a moving edge covers
    or uncovers: silhouettes as the camera sees them, shadows, and the edges of objects in glossy and diffuse
    reflections, except those of sources.

    In scalar variants, and nested in another integrator (:monosp:`aov`, :monosp:`moment`), every pixel gets the
    sample count of the sensor's sampler, and that sampler's samples.

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

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.max_level = whole(props, "max_level", 4, -1)
        self.diffuse_bounces = whole(props, "diffuse_bounces", 0, -1)
        if self.diffuse_bounces == 0 and not 0 <= self.max_level <= DEEPEST_TREE:
            raise reject(
                props,
                "max_level",
                self.max_level,
                f"0 to {DEEPEST_TREE} for a ray tree (-1, any level, goes with diffuse_bounces)",
            )
        self.shadows = props.get("shadows", True)
        self.ambient = read_emission(props, "ambient")
        self.background = read_emission(props, "background")
        self.cutoff = number(props, "cutoff", 0.0, 0)
        self.rr_depth = whole(props, "rr_depth", 5, 0)
        self.caustics = props.get("caustics", False)
        self.rr_throughput = number(props, "rr_throughput", 0.01 if self.caustics else 0.0, 0)
        self.caustic_photons = whole(props, "caustic_photons", 1 << 20, 1)
        if self.caustics and not dr.is_jit_v(mi.Float):
            raise reject(
                props,
                "caustics",
                True,
                f"false in the variant {mi.variant()}; llvm_ad_rgb, llvm_ad_spectral and the like know photons, "
                "and prosim render --no-caustics leaves them out",
            )
        self.layers = choice(props, "layers", KINDS)
        if self.layers != "none" and not dr.is_jit_v(mi.Float):
            raise reject(
                props, "layers", self.layers, f'"none" in the variant {mi.variant()}; llvm_ad_rgb knows layers'
            )
        if reason := refusal(self.layers, self._settings(), self.caustics):
            raise reject(props, "layers", self.layers, reason)
        self._layer_channels: list[str] = []  # of the last scene
        self._scalar: Transport | None = None  # in scalar variants, while an image is rendered

    def traverse(self, callback: mi.TraversalCallback) -> None:
        expose(callback, ambient=self.ambient, background=self.background)

    def name(self) -> str:
        return "prosim"

    def aov_names(self) -> list[str]:
        """Those of layers are known once a scene is rendered."""
        return self._layer_channels + super().aov_names()

    def parameter_names(self) -> list[str]:
        names = [
            "hide_emitters",
            "max_level",
            "shadows",
            "ambient",
            "background",
            "diffuse_bounces",
            "cutoff",
            "rr_depth",
            "rr_throughput",
            "caustics",
            "caustic_photons",
            "layers",
        ]
        return super().parameter_names() + names

    @alone()
    def sample(
        self,
        scene: mi.Scene,
        sampler: mi.Sampler,
        ray: mi.RayDifferential3f,
        medium: mi.Medium | None = None,
        active: mi.Bool = True,
    ) -> tuple[mi.Spectrum, mi.Bool, list[mi.Float]]:
        if self.layers != "none":
            raise RuntimeError(
                "prosim: its own render() alone knows layers; leave them out of a prosim within another integrator."
            )
        if self.caustics:
            raise RuntimeError(
                "prosim: caustics are known to its own render() alone, which sends out the photons; leave them out of "
                "a prosim within another integrator."
            )
        transport = self._scalar or Transport(self._settings(), scene, around=medium)
        L, hit, _ = transport(ray, SamplerPoints(sampler), active, sampler)
        aovs = aov_values(self.mitsuba_aovs, scene, sampler, ray, active) + [mi.Float(0)] * len(self.own_aovs)
        return L, hit, aovs

    def _settings(self) -> Settings:
        return Settings(
            self.max_level,
            self.shadows,
            self.ambient,
            self.background,
            self.diffuse_bounces,
            self.cutoff,
            self.rr_depth,
            self.rr_throughput,
            self.hide_emitters,
            self.layers,
        )

    def transport(self, scene: mi.Scene, sensor: mi.Sensor, attached: bool = False) -> Transport:
        caustics = self._caustics(scene, sensor) if self.caustics else None
        transport = Transport(self._settings(), scene, attached, sensor.get_medium(), caustics)
        self._layer_channels = transport.aov_names
        return transport

    def _derivatives(self, scene: mi.Scene, sensor: int | mi.Sensor, seed: int | mi.UInt32, spp: int) -> Derivatives:
        if self.layers != "none":
            raise RuntimeError("prosim: layers have no derivatives; leave layers out where derivatives are wanted.")
        if self.caustics:
            raise RuntimeError(
                "prosim: where photons lie has no derivatives here; leave caustics out where derivatives are wanted."
            )
        return super()._derivatives(scene, sensor, seed, spp)

    def _caustics(self, scene: mi.Scene, sensor: mi.Sensor) -> Caustics | None:
        """The photons; None where nothing is specular, or nothing shines."""
        from ..photons.caustics import Caustics  # with the first image, as all that makes images

        # As long as the eye's chains of specular surfaces: of those, a source ends the longest.
        deepest = self.max_level + 1 if self.max_level >= 0 else 1 << 31
        # No ray of a tree comes from a diffuse surface to a BSDF without separable lobes, so that photons may.
        return Caustics.of(scene, sensor, self.caustic_photons, deepest, tree=self.diffuse_bounces == 0)
