"""The stochastic ray tracer of the thesis, with adaptive N-rook sampling (chapter 4, sections 5.3 and 5.4)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi

from ..light.emission import read_emission
from ..parameters import choice, describe, expose, number, reject, whole
from ..registry import plugin
from ..rendering import bands, collector
from ..rendering.accumulate import Image
from ..rendering.camera import ray_sampler, uncropped
from ..rendering.derivatives import Derivatives
from ..rendering.estimate import Estimator
from ..rendering.film import Channels, aov_values
from ..rendering.plan import Plan, Sampling
from ..rendering.policies import POLICIES
from ..sampling.nrook import JITTERS, SamplerPoints
from ..transport.settings import DEEPEST_TREE, Settings
from ..transport.transport import Transport


@plugin("integrator", "prosim")
class Prosim(mi.SamplingIntegrator):
    r"""
    .. _integrator-prosim:

    Stochastic ray tracer with adaptive N-rook sampling (:monosp:`prosim`)
    ----------------------------------------------------------------------

    .. pluginparameters::

     * - samples
       - |int|
       - :math:`N`: samples of a first pass; a pixel gets at most :math:`N^2` (Default: 5)

     * - adaptive
       - |string|
       - :monosp:`neighbours`: a pixel gets all :math:`N^2` samples where the 24 pixels around it are noisy.
         :monosp:`thesis`: :math:`N` samples at a time, until the pixel's own are quiet. :monosp:`none`: always
         :math:`N^2`. (Default: :monosp:`neighbours`)

     * - threshold
       - |float|
       - Standard error that is small enough: of the displayed value, white being 1, for :monosp:`neighbours`; of
         the radiance for :monosp:`thesis` (Default: 0.006)

     * - min_passes, max_samples
       - |int|
       - Passes that every pixel gets (Default: 1) and the most samples that one may get, at most :math:`N^2`; where it
         is no multiple of :math:`N`, the last pass is cut short (Default: :math:`N^2`)

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
       - Diffuse reflections that are followed. 0: none, as in the thesis; -1: every one, which is path tracing
         (Default: 0)

     * - cutoff
       - |float|
       - A branch whose throughput is not above this ends (Default: 0)

     * - rr_depth
       - |int|
       - Level from which Russian roulette ends paths; only with :monosp:`diffuse_bounces` (Default: 5)

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

     * - band
       - |int|
       - Pixels that are rendered at a time, which bounds the memory; it does not change the image
         (Default: 262144)

    Distributed ray tracing as the thesis has it: at the first visible surface, light from *every* source through the
    whole BRDF plus the ambient term, then both the reflected and the refracted ray, drawn from their lobes. Nothing is
    followed from a diffuse component, so caustics and diffuse interreflection are left out, unless
    :monosp:`diffuse_bounces` says otherwise. What the lobes and the sources can both sample is shared by multiple
    importance sampling, so that the expected image is the same at any roughness.

    Two kinds of light are left noisy: what a rough surface sees of a smooth one's highlight, which only its lobe can
    find (isolated bright pixels), and, on diffuse surfaces, sources other than spheres and a constant sky, which are
    sampled by their own methods.

    Every space (the pixel, the lens, each source and each lobe at each node) is sampled by its own N-rook patterns.
    A sample is a pure function of seed, pixel, space, pass and index: crop windows, :monosp:`band` and the number of
    threads do not change a bit of the image. The film's reconstruction filter weights each sample by one over
    the number of samples in its pixel. The sensor's sampler is not used. A nonzero :monosp:`spp` given to ``render()``
    replaces :monosp:`max_samples`, and :monosp:`samples` by its square root, rounded up.

    The lobes of a surface are told apart by the type mask of Mitsuba's :monosp:`BSDFContext`. BSDFs that have no
    separate lobes (:monosp:`principled`, :monosp:`principledthin`, :monosp:`hair`, :monosp:`pplastic`, also within
    others) are taken whole: the light of sources comes to them by sampling the sources alone, which is noisy where
    they are smooth.

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
        if mi.is_polarized:
            raise ValueError(
                "prosim: light is unpolarised here (thesis, section 2.2.3); use a variant without 'polarized'."
            )

        self.samples = whole(props, "samples", 5, 1)
        self.adaptive = choice(props, "adaptive", tuple(POLICIES))
        self.threshold = number(props, "threshold", 0.006, 0)
        self.min_passes = whole(props, "min_passes", 1, 1)
        self.max_samples = whole(props, "max_samples", 0, 0)
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
        self.jitter = choice(props, "jitter", JITTERS)
        self.channels = props.get("channels", "rgb").lower()
        if set(self.channels) - set("rgb"):
            raise reject(props, "channels", self.channels, "some of the letters r, g, b")
        self.band = whole(props, "band", 1 << 18, 1)
        self.own_aovs, self.mitsuba_aovs = [], None
        others = []
        for aov in filter(None, (a.strip() for a in props.get("aovs", "").split(","))):
            if aov in bands.OWN_AOVS:
                self.own_aovs.append(aov)
            elif ":" in aov:
                others.append(aov)
            else:
                raise reject(props, "aovs", aov, ", ".join(bands.OWN_AOVS) + " or name:type as for the aov integrator")
        if others:
            self.mitsuba_aovs = mi.load_dict({"type": "aov", "aovs": ",".join(others)})
        #: Called with the part done, 0 to 1, while an image is rendered.
        self.progress = None
        self.cancelled = False
        self._image: tuple[mi.Film, Image] | None = None  # what is being rendered, in JIT variants
        self._transport: Transport | None = None  # in scalar variants, while an image is rendered

    def traverse(self, callback: mi.TraversalCallback) -> None:
        expose(callback, ambient=self.ambient, background=self.background)

    def to_string(self) -> str:
        names = (
            "samples",
            "adaptive",
            "threshold",
            "min_passes",
            "max_samples",
            "max_level",
            "shadows",
            "ambient",
            "background",
            "diffuse_bounces",
            "cutoff",
            "rr_depth",
            "hide_emitters",
            "jitter",
            "channels",
        )
        return describe(self, **{name: getattr(self, name) for name in names}, aovs=self.aov_names())

    def aov_names(self) -> list[str]:
        others = self.mitsuba_aovs.aov_names() if self.mitsuba_aovs is not None else []
        return list(others) + self.own_aovs

    def cancel(self) -> None:
        """Ends a rendering in progress after the current band; the film keeps what was finished."""
        self.cancelled = True
        super().cancel()  # the loop of scalar variants

    def flush(self) -> None:
        """Puts the image so far into the film; for ``progress`` to call. Does nothing where no image is being made, or
        one that is only for derivatives.
        """
        if self._image is not None:
            self._put(*self._image)

    # ---------------------------------------------------------------- radiance along a ray

    @collector.suspended()
    def sample(
        self,
        scene: mi.Scene,
        sampler: mi.Sampler,
        ray: mi.RayDifferential3f,
        medium: mi.Medium | None = None,
        active: mi.Bool = True,
    ) -> tuple[mi.Spectrum, mi.Bool, list[mi.Float]]:
        transport = self._transport or Transport(self._settings(), scene)
        L, hit = transport(ray, SamplerPoints(sampler), active, sampler)
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
            self.hide_emitters,
        )

    # ---------------------------------------------------------------- rendering

    def render(
        self,
        scene: mi.Scene,
        sensor: int | mi.Sensor = 0,
        seed: int | mi.UInt32 = 0,
        spp: int = 0,
        develop: bool = True,
        evaluate: bool = True,
    ) -> mi.TensorXf:
        if isinstance(sensor, int):
            sensor = scene.sensors()[sensor]
        if not dr.is_jit_v(mi.Float):
            return self._render_scalar(scene, sensor, seed, spp, develop, evaluate)
        if dr.flag(dr.JitFlag.FreezingScope):
            raise RuntimeError(
                "prosim: an image can't be rendered within a function that dr.freeze records, because how "
                "many samples are taken is decided on the way; render it outside of that function."
            )
        film = sensor.film()
        film.prepare(self.aov_names())
        plan, estimator = self._plan(scene, sensor, seed, spp)
        image = Image(plan.window, estimator.channels.names, len(self.own_aovs))
        self._image = film, image
        try:
            self._fill(image, plan, estimator, self.own_aovs)
        finally:
            self._image = None
        self._put(film, image)
        image = film.develop() if develop else mi.TensorXf()
        if evaluate:
            dr.eval(image)
            if not develop:
                film.schedule_storage()
                dr.eval()
            dr.sync_thread()
        return image

    def _render_scalar(self, scene: mi.Scene, *arguments: Any) -> mi.TensorXf:
        """Mitsuba's own loop over pixels and samples."""
        if self._transport is not None:  # Mitsuba calls render() of this class once more
            return super().render(scene, *arguments)
        self._transport = Transport(self._settings(), scene)
        try:
            return super().render(scene, *arguments)
        finally:
            self._transport = None

    def _plan(self, scene: mi.Scene, sensor: mi.Sensor, seed: int | mi.UInt32, spp: int) -> tuple[Plan, Estimator]:
        """``(plan, estimator)``: which samples are taken, and what takes them."""
        plan = Plan.of(
            Sampling(
                self.samples, self.adaptive, self.threshold, self.min_passes, self.max_samples, self.jitter, self.band
            ),
            sensor.film(),
            seed,
            spp,
        )
        channels = Channels(sensor.film(), self.channels, self.mitsuba_aovs)
        return plan, Estimator(plan, scene, sensor, Transport(self._settings(), scene), channels)

    def _fill(
        self,
        image: Image,
        plan: Plan,
        estimator: Estimator,
        own_aovs: Sequence[str],
        counts: list[mi.UInt32] | None = None,
    ) -> None:
        """Renders ``image``; ``counts`` as for :func:`.bands.render`."""
        self.cancelled = False
        policy = POLICIES[self.adaptive](plan, self.threshold)
        with uncropped(estimator.sensor):
            estimator.rays = ray_sampler(estimator.sensor)
            bands.render(plan, policy, estimator, image, own_aovs, self.progress, lambda: self.cancelled, counts)

    @staticmethod
    def _put(film: mi.Film, image: Image) -> None:
        """Makes ``image`` what ``film`` holds."""
        film.clear()
        film.put_block(mi.ImageBlock(image.tensor(), mi.ScalarPoint2i(image.window[:2]), border=False))

    # ---------------------------------------------------------------- derivatives

    @collector.suspended()
    def render_forward(
        self, scene: mi.Scene, params: Any, sensor: int | mi.Sensor = 0, seed: int | mi.UInt32 = 0, spp: int = 0
    ) -> mi.TensorXf:
        derivatives = self._derivatives(scene, sensor, seed, spp)
        image = derivatives.develop(derivatives.attached_storage(), self.aov_names())
        dr.forward_to(image)
        gradient = dr.grad(image)
        # What the integrator says of itself comes last, and has no derivatives.
        height, width, channels = gradient.shape
        all_channels = channels + len(self.own_aovs)
        complete = dr.zeros(mi.Float, height * width * all_channels)
        i = dr.arange(mi.UInt32, height * width * channels)
        dr.scatter(complete, gradient.array, i // channels * all_channels + i % channels)
        return mi.TensorXf(complete, (height, width, all_channels))

    @collector.suspended()
    def render_backward(
        self,
        scene: mi.Scene,
        params: Any,
        grad_in: mi.TensorXf,
        sensor: int | mi.Sensor = 0,
        seed: int | mi.UInt32 = 0,
        spp: int = 0,
    ) -> None:
        derivatives = self._derivatives(scene, sensor, seed, spp)
        storage = mi.TensorXf(derivatives.storage)
        dr.enable_grad(storage)
        image = derivatives.develop(storage, self.aov_names())
        dr.backward(dr.sum(image * grad_in[:, :, : image.shape[2]], axis=None))
        derivatives.backward(dr.grad(storage))

    def _derivatives(self, scene: mi.Scene, sensor: int | mi.Sensor, seed: int | mi.UInt32, spp: int) -> Derivatives:
        if isinstance(sensor, int):
            sensor = scene.sensors()[sensor]
        counts: list[mi.UInt32] = []
        with dr.suspend_grad():
            plan, estimator = self._plan(scene, sensor, seed, spp)
            image = Image(plan.window, estimator.channels.names, 0)
            self._fill(image, plan, estimator, [], counts)
        estimator.transport = Transport(self._settings(), scene, attached=True)
        return Derivatives(plan, estimator, image, dr.concat(counts))
