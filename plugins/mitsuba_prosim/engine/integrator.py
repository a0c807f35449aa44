"""The base class of the progressive integrators ``prosim`` and ``prosim_adaptive`` (which wraps another integrator)."""

from __future__ import annotations

import weakref
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi

from ..alone import alone
from ..compat import take_back_interrupts
from ..parameters import (
    check_samples,
    check_unpolarized,
    check_whole,
    choice,
    describe,
    number,
    pick_sensor,
    reject,
    text,
    whole,
)
from ..sampling.nrook import JITTERS
from .channels import Channels, aov_values, check_aovs, parse_aovs
from .plan import SAMPLING, Plan, Sampling

if TYPE_CHECKING:
    from .checkpoint import Checkpoint
    from .derivatives import Derivatives
    from .estimator import Estimator
    from .goal import Measure
    from .render import Render
    from .tiles import Part
    from .work import Executor


class ProgressiveIntegrator(mi.SamplingIntegrator):
    """Base class of integrators that render progressively.

    A subclass defines how the radiance along a ray is estimated: by :meth:`transport`, and by the method ``sample()``.
    Mitsuba calls ``sample()`` in scalar variants, and if this integrator is nested in another integrator. This class
    does not use Python's module ``abc``, because Mitsuba's classes have another metaclass.
    """

    #: Name of the plugin.
    name: str

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        from .policies import POLICIES  # slow to import, and only a render needs NumPy

        check_unpolarized(self.name)
        self.samples = whole(props, "samples", 5, 1)
        self.threshold = number(props, "threshold", 0.006, 0)
        self.min_passes = whole(props, "min_passes", 1, 1)
        self.max_samples = whole(props, "max_samples", 0, 0)
        self.noise = number(props, "noise", 0.0, 0)
        self.noise_99 = number(props, "noise_99", 0.0, 0)
        self.time = number(props, "time", 0.0, 0)
        # ``graded`` is the best policy for many samples. So ``graded`` is the default if a pixel may get many samples.
        has_target = bool(self.noise or self.noise_99 or self.time)
        default = "graded" if has_target else "neighbours"
        self.adaptive = choice(props, "adaptive", (default, *(name for name in POLICIES if name != default)))
        if has_target and not POLICIES[self.adaptive].unbounded:
            raise reject(
                props, "adaptive", self.adaptive, "graded, neighbours or none, because noise needs many samples"
            )
        self.jitter = choice(props, "jitter", JITTERS)
        self.channels = text(props, "channels", "rgb").lower()
        if set(self.channels) - set("rgb"):
            raise reject(props, "channels", self.channels, "some of the letters r, g, b")
        self.band = whole(props, "band", 1 << 18, 1)  # maximum number of pixels of a work item
        self.own_aovs, self.mitsuba_aovs = parse_aovs(props)
        #: The renders that :meth:`cancel` ends.
        self._renders: weakref.WeakSet[Render] = weakref.WeakSet()
        self._scalar: Any = None  # the transport during a render in a scalar variant

    def transport(self, scene: mi.Scene, sensor: mi.Sensor, attached: bool = False) -> Any:
        """Returns the :class:`.Transport` of rays in ``scene``, with derivatives if ``attached``."""
        # A subclass defines this method.
        raise NotImplementedError

    def parameter_names(self) -> list[str]:
        """Returns the parameters that ``str()`` shows: not ``band``, which does not change the image."""
        return [*(name for name in SAMPLING if name != "band"), "channels"]

    def to_string(self) -> str:
        return describe(self, **{name: getattr(self, name) for name in self.parameter_names()}, aovs=self.aov_names())

    def aov_names(self) -> list[str]:
        others = self.mitsuba_aovs.aov_names() if self.mitsuba_aovs is not None else []
        return list(others) + self.own_aovs

    def _aovs_of_ray(self, scene: mi.Scene, sampler: mi.Sampler, ray: mi.Ray3f, active: mi.Bool) -> list[mi.Float]:
        """Returns the AOVs along ``ray``. Raises RuntimeError for those that are statistics of a pixel."""
        if self.own_aovs:
            raise RuntimeError(
                f"{self.name}: the aovs {', '.join(self.own_aovs)} are for its own render() alone, in variants other "
                "than scalar ones and not within another integrator; leave them out there."
            )
        return aov_values(self.mitsuba_aovs, scene, sampler, ray, active)

    @property
    def omits_colours(self) -> bool:
        """Whether the parameter ``channels`` omits a colour."""
        return set(self.channels) != set("rgb")

    def _stored(self, L: mi.Spectrum) -> mi.Spectrum:
        """Returns the radiance ``L`` without the colours that ``channels`` omits. Raises RuntimeError where only the
        film knows the colours: in spectral and monochromatic variants.
        """
        if not self.omits_colours:
            return L
        if not mi.is_rgb:
            raise RuntimeError(
                f'{self.name}: in spectral and monochromatic variants, channels = "{self.channels}" is for its own '
                "render() alone, in variants other than scalar ones and not within another integrator; leave it out."
            )
        return L * mi.Color3f([float(name in self.channels) for name in "rgb"])

    def cancel(self) -> None:
        """Ends all renders of this integrator within about a second; the films keep the images of their samples."""
        for render in list(self._renders):
            render.stop()
        super().cancel()  # ends the loop of scalar variants

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
        """Renders the whole image.

        Returns the developed image, shape (height, width, channels), or an empty tensor if ``develop`` is False. With a
        nonzero ``spp``, each pixel gets exactly this number of samples, whatever target and policy the scene has. In
        scalar variants, the sensor's sampler sets the number of samples, and a nonzero ``spp`` replaces that number. If
        ``evaluate`` is true, this method waits until the image is computed. After :meth:`cancel`, the result is the
        image of the samples so far.
        """
        if not dr.is_jit_v(mi.Float):
            return self._render_scalar(scene, sensor, seed, spp, develop, evaluate)
        render = self.progressive(scene, sensor, seed, spp)
        for _ in render:
            pass
        with alone():  # ``image`` writes the film again, which another thread may have changed
            image = render.image() if develop else mi.TensorXf()
            if evaluate:
                dr.eval(image)
                dr.sync_thread()
        return image

    def progressive(
        self,
        scene: mi.Scene,
        sensor: int | mi.Sensor = 0,
        seed: int | mi.UInt32 = 0,
        spp: int = 0,
        *,
        executor: Executor | None = None,
        begin: Checkpoint | None = None,
        part: Part | None = None,
        measure: Measure | None = None,
    ) -> Render:
        """Begins a progressive render, and returns an iterator that yields a :class:`.Step` after each work item.

        The iterator is a :class:`.Render`, whose methods return the image so far. ``executor`` computes the work items;
        if ``executor`` is None, this process computes one work item after another. ``begin`` is a checkpoint from which
        the render continues. ``part`` is the part of the image that is rendered; with ``begin``, the part that the
        checkpoint stores is rendered instead. With ``measure``, which measures the error of the denoised image, the
        samples may be divided between two images, see :class:`.Render`.

        Raises RuntimeError in scalar variants and within ``dr.freeze``. Raises ValueError if ``begin`` is a checkpoint
        of another image, or cannot be continued with the policy of this integrator (:meth:`.Checkpoint.restore`).
        Raises ValueError, too, if a part of an image has a limit of noise or time, because these limits apply to the
        whole image.
        """
        # Imported only for an image: NumPy and the engine are slow to import.
        from .checkpoint import Checkpoint
        from .render import Render
        from .tiles import Part

        for name, value, kind in (("begin", begin, Checkpoint), ("part", part, Part)):
            if not isinstance(value, kind | None):
                raise TypeError(f"{self.name}: {name} is {value!r}; give a {kind.__name__} of {kind.__module__}.")
        if not dr.is_jit_v(mi.Float):
            raise RuntimeError(
                f"{self.name}: scalar variants cannot render progressively; use an llvm or cuda variant."
            )
        if dr.flag(dr.JitFlag.FreezingScope):
            raise RuntimeError(
                f"{self.name}: can't render within a function that dr.freeze records, because the number of "
                "samples depends on the image; render outside of that function."
            )
        sensor, spp = pick_sensor(scene, sensor), check_whole("spp", spp)
        sampling, in_halves = self.sampling, measure is not None
        if spp:
            spp = spp // 2 if in_halves else spp
            sampling = sampling.uniform(spp)
        elif in_halves:
            sampling = sampling.halved()
            if begin is not None:
                # With a limit, :meth:`.Sampling.halved` does not halve ``samples``. But the checkpoint may be from a
                # render without a limit, whose passes had half of the samples; then this N continues.
                sampling = replace(sampling, samples=begin.attributes["sampling"]["samples"])
        if (part or (begin and begin.part)) and sampling.has_target:
            raise ValueError(
                f"{self.name}: a part of an image can't have the limits noise and time, those of the whole image; "
                "render the parts without them, merge them, and continue the image with them."
            )
        with alone(), dr.suspend_grad():
            estimator = self.estimator(scene, sensor)
            plan = Plan.of(sampling, sensor.film(), seed, spp, 0 if begin is None else begin.n(sampling))
            render = Render(plan, estimator, executor, begin, part, measure)
        self._renders.add(render)
        return render

    @property
    def sampling(self) -> Sampling:
        """The sampling parameters of this integrator, as one object."""
        return Sampling(**{name: getattr(self, name) for name in SAMPLING})

    @alone()
    def estimator(self, scene: mi.Scene, sensor: mi.Sensor) -> Estimator:
        """Creates the :class:`.Estimator`, which takes the samples of an image, and prepares the film of ``sensor``."""
        from .estimator import Estimator

        transport = self.transport(scene, sensor)
        aovs = self.own_aovs, self.mitsuba_aovs, transport.aov_names
        return Estimator(scene, sensor, transport, Channels(sensor.film(), self.channels, *aovs))

    def _render_scalar(
        self, scene: mi.Scene, sensor: int | mi.Sensor, seed: int | mi.UInt32, spp: int, *arguments: Any
    ) -> mi.TensorXf:
        """Renders the image in a scalar variant, by Mitsuba's own loop over pixels and samples.

        ``arguments`` are the further arguments of :meth:`render`. Warns if the integrator has a limit of noise or time;
        such a limit is ignored in scalar variants.
        """
        if self._scalar is not None:  # Mitsuba's ``render`` below calls this object's ``render`` again: the second call
            return super().render(scene, sensor, seed, spp, *arguments)
        if self.sampling.has_target:
            mi.Log(mi.LogLevel.Warn, f"{self.name}: scalar variants ignore noise and time; use an llvm variant.")
        chosen = pick_sensor(scene, sensor)
        check_samples(chosen, spp)
        check_aovs(chosen.film(), self.aov_names())
        self._scalar = self.transport(scene, chosen)
        try:
            return super().render(scene, sensor, seed, spp, *arguments)
        finally:
            self._scalar = None
            take_back_interrupts()

    # ---------------------------------------------------------------- derivatives

    @alone()
    def render_forward(
        self, scene: mi.Scene, params: Any, sensor: int | mi.Sensor = 0, seed: int | mi.UInt32 = 0, spp: int = 0
    ) -> mi.TensorXf:
        """Returns the derivative of the image along the gradients that the user has set on scene parameters.

        The result has the shape of the image. ``params`` is ignored; the other arguments are those of :meth:`render`.
        Raises RuntimeError if the integrator has a time limit.
        """
        return self._derivatives(scene, sensor, seed, spp).forward()

    @alone()
    def render_backward(
        self,
        scene: mi.Scene,
        params: Any,
        grad_in: mi.TensorXf,
        sensor: int | mi.Sensor = 0,
        seed: int | mi.UInt32 = 0,
        spp: int = 0,
    ) -> None:
        """Propagates ``grad_in``, the gradient with respect to the image, to the scene parameters (backward mode).

        ``params`` is ignored; the other arguments are those of :meth:`render`. Raises RuntimeError if the integrator
        has a time limit.
        """
        self._derivatives(scene, sensor, seed, spp).backward(grad_in)

    def _derivatives(self, scene: mi.Scene, sensor: int | mi.Sensor, seed: int | mi.UInt32, spp: int) -> Derivatives:
        """Renders, and returns the :class:`.Derivatives`. Raises RuntimeError for a time without ``spp``."""
        from .derivatives import Derivatives

        if self.time and not spp:
            raise RuntimeError(
                f"{self.name}: image and derivatives need the same samples, but a time limit allows another number of "
                "samples in each render; set samples, max_samples or noise instead of time."
            )
        state = self.progressive(scene, sensor, seed, spp).run().state
        state.estimator.transport = self.transport(scene, state.estimator.sensor, attached=True)
        return Derivatives(state)
