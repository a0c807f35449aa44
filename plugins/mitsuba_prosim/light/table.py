"""The light sources of a scene, as surfaces sample them: each at every point (sections 4.1, 5.2), or one that is
chosen (:mod:`.light_sampler`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from ..compat import emitter_pointers, emitters_in_order
from ..masks import but_not, idle
from .balls import Balls
from .others import Others
from .sample import LightSample
from .sky import Sky

#: Strategies for lamps, which are all sources but a constant sky: an emitter belongs to the first one that takes it.
STRATEGIES = (Balls, Others)


#: A strategy, and the numbers of its first lamp and of the one after its last.
Group = tuple[Balls | Others, int, int]


class Mixed(Others):
    """The strategies of several ``groups`` as one, for a lamp whose number only the kernel knows."""

    def __init__(self, groups: Sequence[Group]) -> None:
        self.groups = groups
        self.whole_sphere = all(strategy.whole_sphere for strategy, *_ in groups)

    def sample(
        self,
        number: int | mi.UInt32,
        emitter: mi.Emitter | mi.EmitterPtr,
        si: mi.SurfaceInteraction3f,
        n: mi.Normal3f,
        sample: mi.Point2f,
        active: mi.Bool,
    ) -> LightSample:
        """A point of the lamp ``number``, which is ``emitter``; see :meth:`.balls.Balls.sample`."""
        return self._select(number, active, lambda one, k, mine: one.sample(k, emitter, si, n, sample, mine))

    def pdf(
        self,
        number: int | mi.UInt32,
        si: mi.SurfaceInteraction3f,
        n: mi.Normal3f,
        ds: mi.DirectionSample3f,
        active: mi.Bool,
    ) -> mi.Float:
        """Density per solid angle with which :meth:`sample` takes the direction ``ds``."""
        return self._select(number, active, lambda one, k, mine: one.pdf(k, si, n, ds, mine))

    def carried(
        self,
        number: int | mi.UInt32,
        si: mi.SurfaceInteraction3f,
        n: mi.Normal3f,
        d: mi.Vector3f,
        met: mi.SurfaceInteraction3f,
        active: mi.Bool,
    ) -> tuple[mi.DirectionSample3f, mi.Float]:
        """The direction ``d`` from ``si`` to a point of the lamp ``number``; see :meth:`.balls.Balls.carried`."""
        return self._select(number, active, lambda one, k, mine: one.carried(k, si, n, d, met, mine))

    def follows_shape(self, number: int | mi.UInt32) -> mi.Bool | bool:
        """Whether :meth:`carried` needs to know the point of the lamp ``number``."""
        return self._select(number, mi.Bool(True), lambda one, k, mine: mi.Bool(one.follows_shape(k)))

    def _select(
        self, number: int | mi.UInt32, active: mi.Bool, evaluate: Callable[[Balls | Others, Any, mi.Bool], Any]
    ) -> Any:
        """What ``evaluate`` returns for the strategy of the lamp ``number``, that lamp's number within it, and a mask.

        In scalar variants the number must be that of a lamp, and ``active`` true.
        """
        result: Any = None
        for strategy, first, end in self.groups:
            mine = active & (first <= number) & (number < end)
            if not idle(mine):
                value = evaluate(strategy, dr.clip(number - first, 0, end - 1 - first), mine)
                result = value if result is None else dr.select(mine, value, result)
        return result


@dataclass
class Lamp:
    """A source on its turn: number ``k`` of the table, ``number`` of its ``strategy``, both integers or Dr.Jit
    arrays.
    """

    k: int | mi.UInt32
    emitter: mi.Emitter | mi.EmitterPtr
    strategy: Balls | Others
    number: int | mi.UInt32

    def sample(
        self,
        si: mi.SurfaceInteraction3f,
        n: mi.Normal3f,
        both_sides: mi.Bool | bool,
        sample: mi.Point2f,
        active: mi.Bool,
    ) -> LightSample:
        """A point of the source, seen from ``si``.

        ``n``: normal on the viewer's side; ``both_sides``: mask of the surfaces that light from below the horizon
        reaches too (rough glass), or False where there is none; ``sample``: a point in [0, 1)².
        """
        if self.strategy.whole_sphere or both_sides is False:
            return self.strategy.sample(self.number, self.emitter, si, n, sample, active)
        above = self.strategy.sample(self.number, self.emitter, si, n, sample, but_not(active, both_sides))
        whole = WHOLE.sample(self.number, self.emitter, si, n, sample, active & both_sides)
        return dr.select(both_sides, whole, above)


#: What samples any source from a surface that light reaches from both sides.
WHOLE = Others(())


class Lights:
    """All emitters of ``scene``, grouped by strategy, in an order that is the same in every process; a constant sky,
    which is a sphere around everything, is apart and last.

    The sky is sampled for lobes that no ray is drawn from: a ray that is drawn finds it at least as well, alone.

    ``choose``: whether a surface samples one of the lamps, which the ``sampler`` chooses, and not each of them.

    Up to ``UNROLLED`` lamps are written out in the kernel; more are visited by loops, whose kernel does not depend on
    their number.
    """

    UNROLLED = 4

    def __init__(self, scene: mi.Scene, choose: bool = False) -> None:
        emitters = emitters_in_order(scene)
        skies = [e for e in emitters if Sky.takes(e)]
        groups = [
            (s, [e for e in emitters if e not in skies and s is next(t for t in STRATEGIES if t.takes(e))])
            for s in STRATEGIES
        ]
        #: ``(strategy, first, end)``: the lamps ``first`` .. ``end`` - 1 are sampled by it, in the order of its
        #: numbers.
        self.groups: list[Group] = []
        self.emitters: list[mi.Emitter] = []
        for strategy, members in groups:
            if members:
                first = len(self.emitters)
                self.emitters += members
                self.groups.append((strategy(members), first, len(self.emitters)))
        self.lamps = len(self.emitters)
        #: What samples any lamp, by its number in the table.
        self.mixed: Balls | Others = self.groups[0][0] if len(self.groups) == 1 else Mixed(self.groups)
        self.sky = Sky(2 * scene.bbox().bounding_sphere().radius) if skies else None
        self.emitters += skies
        self.count = len(self.emitters)
        self.jit = dr.is_jit_v(mi.Float)
        deltas = [mi.has_flag(e.flags(), mi.EmitterFlags.Delta) for e in self.emitters]
        self.only_points = all(deltas)
        #: Whether it can be told beforehand, by :meth:`may_meet`, that a ray meets no source.
        self.can_foresee = self.sky is None and all(
            strategy.can_foresee or all(deltas[first:end]) for strategy, first, end in self.groups
        )
        if self.jit and self.emitters:
            self._tabulate(scene)
        #: What chooses among several lamps; None where each of them is sampled.
        from .light_sampler import LightSampler  # with the first image, as NumPy is slow to import

        self.sampler = LightSampler(scene, self.emitters[: self.lamps]) if choose and self.lamps > 1 else None

    def _tabulate(self, scene: mi.Scene) -> None:
        """Pointers by the number of the source, and for many sources the way back from Dr.Jit's identity of an emitter.

        That table's size has to be waited for.
        """
        self.pointers = emitter_pointers(scene, self.emitters)
        if self.lamps > self.UNROLLED:
            identity = dr.reinterpret_array(mi.UInt32, self.pointers)
            self.numbers = dr.full(mi.UInt32, self.lamps, dr.max(identity)[0] + 1)
            dr.scatter(self.numbers, dr.arange(mi.UInt32, self.count), identity)
            dr.make_opaque(self.numbers)

    def number_of(self, emitter: mi.Emitter | mi.EmitterPtr, active: mi.Bool) -> int | mi.UInt32:
        """The number of the lamp ``emitter``, a ``mi.EmitterPtr``, or an emitter in scalar variants; the number of
        lamps for the sky and for None, which are no lamps.
        """
        if not self.jit:
            return self.emitters.index(emitter) if active and emitter is not None else self.lamps
        if self.lamps > self.UNROLLED:
            return dr.gather(mi.UInt32, self.numbers, dr.reinterpret_array(mi.UInt32, emitter), active)
        number = mi.UInt32(self.lamps)
        for k in range(self.lamps):
            number = dr.select(emitter == dr.gather(mi.EmitterPtr, self.pointers, k), k, number)
        return number

    def lamp(self, k: int | mi.UInt32) -> Lamp:
        """The lamp of the number ``k``, an integer or a Dr.Jit array."""
        emitter = dr.gather(mi.EmitterPtr, self.pointers, k) if self.jit else self.emitters[k]
        return Lamp(k, emitter, self.mixed, k)

    def for_each(
        self,
        body: Callable[[Lamp, Any], Any],
        total: Any,
        active: mi.Bool,
        groups: list[Group] | None = None,
        attached: bool = False,
    ) -> Any:
        """Folds ``total = body(lamp, total)`` over the lamps (or those of some of the ``groups``), each a
        :class:`Lamp`.

        ``attached``: whether the derivatives of ``total`` are wanted, which do not pass through a symbolic loop.
        """
        for strategy, first, end in self.groups if groups is None else groups:
            if self.jit and self.lamps > self.UNROLLED:
                total = self._loop(body, strategy, first, end, total, active, attached)
            else:
                for k in range(first, end):
                    total = body(Lamp(k, self.emitters[k], strategy, k - first), total)
        return total

    def _loop(
        self,
        body: Callable[[Lamp, Any], Any],
        strategy: Balls | Others,
        first: int,
        end: int,
        total: Any,
        active: mi.Bool,
        attached: bool,
    ) -> Any:
        first, end = dr.opaque(mi.UInt32, first), dr.opaque(mi.UInt32, end)

        def step(k: mi.UInt32, total: Any) -> tuple[mi.UInt32, Any]:
            emitter = dr.gather(mi.EmitterPtr, self.pointers, k)
            return k + 1, body(Lamp(k, emitter, strategy, k - first), total)

        return dr.while_loop(
            (mi.UInt32(first), total),
            lambda k, total: active & (k < end),
            step,
            labels=("k", "total"),
            mode="evaluated" if attached else None,
        )[1]

    def sample_sky(
        self,
        si: mi.SurfaceInteraction3f,
        n: mi.Normal3f,
        both_sides: mi.Bool | bool,
        sample: mi.Point2f,
        active: mi.Bool,
    ) -> LightSample:
        """A point of the sky; parameters as in :meth:`Lamp.sample`."""
        assert self.sky is not None
        sky = self.emitters[-1]
        above = self.sky.sample(sky, si, n, sample, active)
        if both_sides is False:
            return above
        return dr.select(both_sides, WHOLE.sample(self.lamps, sky, si, n, sample, active & both_sides), above)

    def pdf(
        self,
        si: mi.SurfaceInteraction3f,
        n: mi.Normal3f,
        both_sides: mi.Bool | bool,
        ds: mi.DirectionSample3f,
        active: mi.Bool,
        estimates: mi.Float | None = None,
    ) -> mi.Float:
        """Density per solid angle with which a lamp is sampled in the direction ``ds`` (``mi.DirectionSample3f``) at
        ``si``, the lamp being the one that is met there; 0 for the sky. Parameters as in :meth:`Lamp.sample`.

        It includes the probability that the ``sampler``, if there is one, chooses this lamp. ``estimates``: its
        :meth:`.LightSampler.total` at ``si``, if that is known.
        """
        k = self.number_of(ds.emitter, active)
        active = active & (k < self.lamps)
        if idle(active) or not self.lamps:
            return mi.Float(0)
        if both_sides is False or self.mixed.whole_sphere:
            pdf = self.mixed.pdf(k, si, n, ds, active)
        else:
            pdf, above, whole = mi.Float(0), but_not(active, both_sides), active & both_sides
            if not idle(above):
                pdf = self.mixed.pdf(k, si, n, ds, above)
            if not idle(whole):
                pdf = dr.select(whole, WHOLE.pdf(k, si, n, ds, whole), pdf)
        if self.sampler is not None:
            pdf *= self.sampler.probability(k, si.p, n, both_sides, estimates, active)
        return dr.select(active, pdf, 0)

    def carried(
        self, si: mi.SurfaceInteraction3f, n: mi.Normal3f, d: mi.Vector3f, met: mi.SurfaceInteraction3f, active: mi.Bool
    ) -> tuple[mi.Vector3f, mi.Float]:
        """The direction ``d`` from ``si`` to the point ``met`` of a lamp, carried along with that lamp, and the
        Jacobian of the map, both with derivatives; see :mod:`.motion`.
        """
        k = self.number_of(met.shape.emitter(), active)
        active = active & (k < self.lamps)
        if not self.lamps:
            return d, mi.Float(1)
        ds, stretch = self.mixed.carried(k, si, n, d, met, active)
        return dr.select(active, ds.d, d), dr.select(active, stretch, 1)

    def may_meet(self, o: mi.Point3f, d: mi.Vector3f) -> mi.Bool:
        """Whether the ray (o, d) meets a source, as far as nothing is in the way; where the table ``can_foresee``."""
        return self.for_each(
            lambda lamp, meets: meets | lamp.strategy.may_meet(lamp.number, o, d),
            mi.Bool(False),
            mi.Bool(True),
            [group for group in self.groups if group[0].can_foresee],
        )
