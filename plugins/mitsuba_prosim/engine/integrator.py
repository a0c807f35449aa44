"""An integrator that renders in waves: what ``prosim`` and the wrapper of other integrators share."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi

from ..parameters import choice, describe, number, reject, whole
from ..sampling.nrook import JITTERS
from . import collector
from .film import Channels, asked_aovs, with_more_channels
from .plan import SAMPLING, Plan, Sampling
from .policies import POLICIES
from .scalar import take_back_interrupts

if TYPE_CHECKING:
    from .derivatives import Derivatives
    from .estimate import Estimator
    from .growth import Growth
    from .part import Part
    from .record import Record
    from .snapshot import Reached, Snapshot
    from .taking import Taker


class WaveIntegrator(mi.SamplingIntegrator):
    """Base class of integrators that render in waves.

    A subclass gives the radiance along a ray: :meth:`transport`, and ``sample()``, which Mitsuba's own loop calls in
    scalar variants and within other integrators.

    Classes of Mitsuba's cannot be abstract by ``abc``: their metaclass is another.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        if mi.is_polarized:
            raise ValueError(
                f"{self.name()}: light is unpolarised here (thesis, section 2.2.3); use a variant without 'polarized'."
            )
        self.samples = whole(props, "samples", 5, 1)
        self.threshold = number(props, "threshold", 0.006, 0)
        self.min_passes = whole(props, "min_passes", 1, 1)
        self.max_samples = whole(props, "max_samples", 0, 0)
        self.noise = number(props, "noise", 0.0, 0)
        self.noise_99 = number(props, "noise_99", 0.0, 0)
        self.time = number(props, "time", 0.0, 0)
        # What makes most of many samples is the default where there may be many.
        default = "graded" if self._aims() else "neighbours"
        self.adaptive = choice(props, "adaptive", (default, *(name for name in POLICIES if name != default)))
        if self._aims() and self.adaptive == "thesis":
            raise reject(
                props, "adaptive", self.adaptive, "another, as noise and time ask for more than N² samples: graded, say"
            )
        self.jitter = choice(props, "jitter", JITTERS)
        self.channels = props.get("channels", "rgb").lower()
        if set(self.channels) - set("rgb"):
            raise reject(props, "channels", self.channels, "some of the letters r, g, b")
        self.band = whole(props, "band", 1 << 18, 1)
        self.own_aovs, self.mitsuba_aovs = asked_aovs(props)
        #: What the samples are drawn from, if not from N-rook patterns.
        self.sampler: mi.Sampler | None = None
        #: Called with the part done, 0 to 1, while an image is rendered.
        self.progress = None
        self.cancelled = False
        #: Called as often as ``progress``, and at the end, with what makes the record of the image then, and whether it
        #: is the end.
        self.keep: Callable[[Callable[[], Record], bool], None] | None = None
        #: Who takes the samples, see :class:`.taking.Taker`; None: this process.
        self.taker: Taker | None = None
        #: How far the last image came.
        self.reached: Reached | None = None
        self._growing: Growth | None = None  # what is being rendered, in JIT variants
        self._scalar: Any = None  # in scalar variants, the transport, while an image is rendered

    def transport(self, scene: mi.Scene, sensor: mi.Sensor, attached: bool = False) -> Any:
        """What finds the radiance along rays of ``sensor`` in ``scene``, see :class:`.Transport`; ``attached``: whether
        derivatives are wanted.
        """
        raise NotImplementedError

    def name(self) -> str:
        """Name of the plugin."""
        raise NotImplementedError

    def parameter_names(self) -> list[str]:
        """Names of the parameters that ``str()`` shows."""
        return [*(name for name in SAMPLING if name != "band"), "channels"]

    def to_string(self) -> str:
        return describe(self, **{name: getattr(self, name) for name in self.parameter_names()}, aovs=self.aov_names())

    def aov_names(self) -> list[str]:
        others = self.mitsuba_aovs.aov_names() if self.mitsuba_aovs is not None else []
        return list(others) + self.own_aovs

    def cancel(self) -> None:
        """Ends a rendering in progress within a second or so; the film keeps what was finished."""
        self.cancelled = True
        super().cancel()  # the loop of scalar variants

    def flush(self) -> None:
        """Puts the image so far into the film; for ``progress`` to call. Does nothing where no image is being made, or
        one that is only for derivatives.
        """
        if self._growing is not None:
            self._growing.put()

    def so_far(self) -> Snapshot | None:
        """What can be seen of the image that is being made, and ``reached`` by it; for ``progress`` to call. None where
        none is being made, or where within a wave there is nothing new, see :meth:`.Growth.so_far`.
        """
        snapshot = self._growing.so_far() if self._growing is not None else None
        if snapshot is not None:
            self.reached = snapshot.reached
        return snapshot

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
        for _ in self.waves(scene, sensor, seed, spp):
            pass
        film = sensor.film()
        image = film.develop() if develop else mi.TensorXf()
        if evaluate:
            dr.eval(image)
            if not develop:
                film.schedule_storage()
                dr.eval()
            dr.sync_thread()
        return image

    def waves(
        self,
        scene: mi.Scene,
        sensor: int | mi.Sensor = 0,
        seed: int | mi.UInt32 = 0,
        spp: int = 0,
        begin: Record | None = None,
        part: Part | None = None,
    ) -> Iterator[Snapshot]:
        """Renders as :meth:`render` does, and yields a :class:`.Snapshot` after each wave, of which the first gives a
        value to every pixel. When the iterator has come to its end, or is closed, the film holds the image so far.
        ``begin``: goes on from there; ``part``: takes the samples of its pixels alone (``begin`` knows its own).

        Raises RuntimeError in scalar variants and within ``dr.freeze``; ValueError where ``begin`` belongs to another
        image, where samples are drawn from a sampler of Mitsuba's, which does not say where it was, and for a part
        where noise or time are asked for, which go by the whole image.
        """
        if not dr.is_jit_v(mi.Float):
            raise RuntimeError(f"{self.name()}: there are no waves in scalar variants; use an llvm or cuda variant.")
        if dr.flag(dr.JitFlag.FreezingScope):
            raise RuntimeError(
                f"{self.name()}: an image can't be rendered within a function that dr.freeze records, because how "
                "many samples are taken is decided on the way; render it outside of that function."
            )
        if isinstance(sensor, int):
            sensor = scene.sensors()[sensor]
        film = sensor.film()
        film.prepare(self.aov_names())
        part = part if begin is None else begin.part
        if part is not None and self._aims():
            raise ValueError(
                f"{self.name()}: noise and time go by the whole image, of which a part knows nothing; render the parts "
                "without them, and let the image that is put together go on until it is good enough."
            )
        if part is not None or begin is not None or self.taker is not None:
            self._refuse_sampler()
        growth = self._growth(scene, sensor, seed, spp, self.own_aovs, part)
        if begin is not None:
            growth.restore(begin)
        self._growing = growth
        try:
            for _ in growth.waves(self.progress, self.keep, lambda: self.cancelled):
                # Not the snapshot: with it the scene would hold itself, and the kernels of the next one would differ.
                self.reached = growth.reached()
                yield growth.snapshot(self.reached)
            if self.keep is not None:
                self.keep(lambda: growth.record(not self.cancelled), True)
        finally:
            self._growing = None
            if not sys.is_finalizing():  # an iterator that the program left behind
                # Once more: where the first wave was good enough, that was seen after it.
                self.reached = growth.reached()
                growth.put()
                film.schedule_storage()
                dr.eval()  # what is pending in one thread is in the way of a function that another one freezes

    def _render_scalar(self, scene: mi.Scene, sensor: mi.Sensor, *arguments: Any) -> mi.TensorXf:
        """Mitsuba's own loop over pixels and samples."""
        if self._scalar is not None:  # Mitsuba calls render() of this class once more
            return super().render(scene, sensor, *arguments)
        if self._aims():
            mi.Log(mi.LogLevel.Warn, f"{self.name()}: noise and time end nothing in scalar variants; the samples do.")
        self._scalar = self.transport(scene, sensor)
        try:
            return super().render(scene, sensor, *arguments)
        finally:
            self._scalar = None
            take_back_interrupts()

    def _aims(self) -> bool:
        return self.noise > 0 or self.noise_99 > 0 or self.time > 0

    def _refuse_sampler(self) -> None:
        if self.sampler is not None:
            raise ValueError(
                f"{self.name()}: an image can't be kept and gone on with, nor shared out, where its samples are drawn "
                "from a sampler of Mitsuba's, which does not say where it was; leave the sampler out."
            )

    def estimator(self, plan: Plan, scene: mi.Scene, sensor: mi.Sensor) -> Estimator:
        """What takes the samples of a ``plan``, through the scene to the film's values."""
        from .estimate import Estimator

        transport = self.transport(scene, sensor)
        channels = Channels(sensor.film(), self.channels, getattr(transport, "aov_names", ()), self.mitsuba_aovs)
        return Estimator(plan, scene, sensor, transport, channels, self.sampler)

    def _growth(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor,
        seed: int | mi.UInt32,
        spp: int,
        own_aovs: Sequence[str],
        part: Part | None = None,
    ) -> Growth:
        """An image without samples, or a part of one."""
        # With the first image: what makes images, and NumPy, would take longer to load than all plugins together.
        from .growth import Growth

        self.cancelled = False  # before the work: what is cancelled during it stays so
        plan = Plan.of(Sampling(**{name: getattr(self, name) for name in SAMPLING}), sensor.film(), seed, spp)
        return Growth(plan, self.estimator(plan, scene, sensor), own_aovs, part, self.taker)

    # ---------------------------------------------------------------- derivatives

    @collector.suspended()
    def render_forward(
        self, scene: mi.Scene, params: Any, sensor: int | mi.Sensor = 0, seed: int | mi.UInt32 = 0, spp: int = 0
    ) -> mi.TensorXf:
        derivatives = self._derivatives(scene, sensor, seed, spp)
        storage, gradient = mi.TensorXf(derivatives.storage), derivatives.forward()
        dr.enable_grad(storage)
        dr.set_grad(storage, gradient)
        image = derivatives.develop(storage, self.aov_names())
        dr.forward_to(image)
        gradient = dr.grad(image)
        return with_more_channels(gradient, len(self.own_aovs))  # what it says of itself has no derivatives

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
        with dr.suspend_grad():
            growth = self._growth(scene, sensor, seed, spp, [])
            for _ in growth.waves(self.progress, cancelled=lambda: self.cancelled):
                pass
        return growth.derivatives(self.transport(scene, sensor, attached=True))
