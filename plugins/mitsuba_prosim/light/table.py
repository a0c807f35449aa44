"""The light sources of a scene, grouped by the strategies that sample them.

A surface point samples every light source (thesis, sections 4.1, 5.2), or only one, which :mod:`.light_sampler`
chooses.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import drjit as dr
import mitsuba as mi

from ..compat import emitter_pointers, emitters_in_order, eval_direction, is_users
from ..masks import but_not, fold, idle
from .emitter_methods import Emitter
from .strategy import ConstantSky, Index, LightSample, OtherLights, Receiver, SphereLights

#: Strategies for lamps, in order of preference. A lamp is any light source except a constant sky. The first strategy
#: that can sample an emitter takes it.
STRATEGIES = (SphereLights, OtherLights)

#: A strategy, the number of its first lamp, and the number after that of its last lamp.
Group = tuple[OtherLights, Any, Any]
#: Function that evaluates a strategy for one lamp, given the strategy, the lamp's number within the strategy, and a
#: mask.
Evaluate: TypeAlias = "Callable[[OtherLights, Index, mi.Bool], Any]"


@dataclass
class Lamp:
    """The light source ``emitter``, number ``k`` of :class:`Lights`, and the ``groups`` to which it may belong: several
    if ``k`` is a Dr.Jit array.
    """

    k: Index
    emitter: Emitter
    groups: list[Group]
    #: Samples any light source from a surface that receives light from both sides.
    two_sided: OtherLights

    def sample(self, receiver: Receiver, sample: mi.Point2f, active: mi.Bool) -> LightSample:
        """Returns ``(ds, weight)``, a sample by a point in [0, 1)² (:meth:`.OtherLights.sample`)."""
        return self._by_side(receiver, active, lambda way, k, mine: way.sample(k, self.emitter, receiver, sample, mine))

    def pdf(self, receiver: Receiver, ds: mi.DirectionSample3f, active: mi.Bool) -> mi.Float:
        """Returns the density per solid angle of :meth:`sample` for ``ds``."""
        return self._by_side(receiver, active, lambda strategy, k, mine: strategy.pdf(k, receiver, ds, mine))

    def reparameterised(
        self, receiver: Receiver, d: mi.Vector3f, met: mi.SurfaceInteraction3f, active: mi.Bool
    ) -> tuple[mi.DirectionSample3f, mi.Float]:
        """Returns ``(ds, jacobian)`` of a direction that moves with the lamp (:meth:`.OtherLights.reparameterised`)."""
        return self._by_strategy(active, lambda strategy, k, mine: strategy.reparameterised(k, receiver, d, met, mine))

    def _by_side(self, receiver: Receiver, active: mi.Bool, evaluate: Evaluate) -> Any:
        """Calls ``evaluate`` with :attr:`two_sided` where both sides of ``receiver`` receive light, elsewhere with the
        lamp's own strategies; only with these if all of them sample below the horizon.
        """
        both_sides = receiver.both_sides
        below_horizon = all(strategy.samples_below_horizon for strategy, *_ in self.groups)
        if below_horizon or both_sides is False or idle(both_sides):
            return self._by_strategy(active, evaluate)
        two_sided = evaluate(self.two_sided, self.k, active & both_sides)
        above = but_not(active, both_sides)
        return two_sided if idle(above) else dr.select(both_sides, two_sided, self._by_strategy(above, evaluate))

    def _by_strategy(self, active: mi.Bool, evaluate: Evaluate) -> Any:
        """Calls ``evaluate`` with the strategy of the lamp, the lamp's number within the strategy, and a mask, for each
        group to which it may belong.
        """
        if len(self.groups) == 1:
            strategy, first, _ = self.groups[0]
            return evaluate(strategy, self.k - first, active)
        result: Any = None
        for strategy, *bounds in self.groups:
            first, end = (dr.opaque(mi.UInt32, bound) for bound in bounds)
            in_group = active & (first <= self.k) & (self.k < end)
            value = evaluate(strategy, dr.clip(self.k - first, 0, end - 1 - first), in_group)
            result = value if result is None else dr.select(in_group, value, result)
        return result


class Lights:
    """All emitters of ``scene``, grouped by sampling strategy, in an order that is the same in every process.

    A constant sky does not count as a lamp, and follows the lamps. A surface samples it only for lobes whose direct
    light comes from light sampling alone: the rays of other lobes find the sky at least as well. ``choose`` tells
    whether a surface point samples only one lamp, chosen by the ``sampler``. For at most ``UNROLLED`` lamps, the kernel
    contains separate code for each lamp; else loops, so that it does not depend on their number.
    """

    UNROLLED = 4

    def __init__(self, scene: mi.Scene, choose: bool = False) -> None:
        self.scene = scene
        # A user's emitter samples itself: its flags may not tell where or in which directions its light varies.
        strategies = {
            e: OtherLights if is_users(e) else next(s for s in (ConstantSky, *STRATEGIES) if s.can_sample(e))
            for e in emitters_in_order(scene)
        }
        # Lamps are numbered group by group; the constant sky, of which a scene has at most one, follows.
        skies = [e for e, s in strategies.items() if s is ConstantSky]
        self.groups: list[Group] = []
        self.emitters: list[mi.Emitter] = []
        for strategy in STRATEGIES:
            if members := [e for e, s in strategies.items() if s is strategy]:
                self.groups.append((strategy(members), len(self.emitters), len(self.emitters) + len(members)))
                self.emitters += members
        #: Number of lamps, and number of all light sources.
        self.lamps, self.count = len(self.emitters), len(self.emitters) + len(skies)
        self.emitters += skies
        self.two_sided = OtherLights(self.emitters)
        self.sky: Lamp | None = None
        if skies:
            sky = ConstantSky(2 * scene.bbox().bounding_sphere().radius)
            self.sky = Lamp(self.lamps, skies[-1], [(sky, self.lamps, self.count)], self.two_sided)
        #: Whether no ray can hit a light source, because all sources are points or emit in a single direction.
        self.all_delta = all(mi.has_flag(e.flags(), mi.EmitterFlags.Delta) for e in self.emitters)
        self.jit = dr.is_jit_v(mi.Float)
        if self.jit and self.emitters:
            #: The emitters; and their numbers, indexed by Dr.Jit's identity of an emitter.
            self.pointers = emitter_pointers(scene, self.emitters)
            # Dr.Jit would postpone a scatter within the loop of another integrator, so a list gives the numbers.
            identity = list(dr.reinterpret_array(mi.UInt32, self.pointers))
            numbers = {which: number for number, which in enumerate(identity)}
            self.numbers = mi.UInt32([numbers.get(which, self.lamps) for which in range(max(identity) + 1)])
        #: Chooses one of several lamps; None if every lamp is sampled, or if there is at most one lamp.
        from .light_sampler import LightSampler  # imported only for an image, as NumPy is slow to import

        self.sampler = LightSampler(scene, self.emitters[: self.lamps]) if choose and self.lamps > 1 else None

    def number_of(self, emitter: Emitter, active: mi.Bool) -> Index:
        """Returns the number of the lamp ``emitter``; the count of all lamps for the sky and None."""
        if not self.jit:
            return self.emitters.index(emitter) if active and emitter is not None else self.lamps
        return dr.gather(mi.UInt32, self.numbers, dr.reinterpret_array(mi.UInt32, emitter), active)

    def lamp(self, k: Index, groups: list[Group] | None = None) -> Lamp:
        """Returns the lamp number ``k``; if ``k`` is an array, it belongs to the ``groups`` (default: to any)."""
        if isinstance(k, int):
            groups = [group for group in self.groups if group[1] <= k < group[2]]
            return Lamp(k, self.emitters[k], groups, self.two_sided)
        return Lamp(k, dr.gather(mi.EmitterPtr, self.pointers, k), groups or self.groups, self.two_sided)

    def for_each(self, body: Callable[[Lamp, Any], Any], total: Any, active: mi.Bool, evaluated: bool = False) -> Any:
        """Computes ``total = body(lamp, total)`` for each lamp in turn, and returns the last total. A symbolic loop
        (not ``evaluated``) loses derivatives.
        """
        unrolled, mode = self.lamps <= self.UNROLLED, "evaluated" if evaluated else None
        for strategy, first, end in self.groups:
            group = strategy, first if unrolled else dr.opaque(mi.UInt32, first), end

            def step(k: Index, total: Any, group: Group = group) -> Any:
                return body(self.lamp(group[1] + k, [group]), total)

            total = fold(end - first, step, total, active, unrolled, mode=mode)
        return total

    def pdf(self, receiver: Receiver, ds: mi.DirectionSample3f, active: mi.Bool) -> mi.Float:
        """Returns the density per solid angle with which light sampling at ``receiver`` samples ``ds``, times the
        lamp's probability; 0 for the sky.
        """
        k = self.number_of(ds.emitter, active)
        active = active & (k < self.lamps)
        if idle(active) or not self.lamps:
            return mi.Float(0)

        def lamp_density(k: Index, receiver: Receiver, ds: mi.DirectionSample3f, active: mi.Bool) -> mi.Float:
            pdf = self.lamp(k).pdf(receiver, ds, active)
            return pdf if self.sampler is None else pdf * self.sampler.probability(k, receiver, active)

        # Few rays hit a lamp. The branch skips the density in all other lanes.
        return dr.if_stmt((k, receiver, ds, active), active, lamp_density, lambda *_: mi.Float(0), label="pdf")

    # ---------------------------------------------------------------- reparameterisation (Loubet and others 2019)
    # If sampled directions were constants, the derivatives would miss the light that enters and leaves at the edge of a
    # moving light source. So the derivatives of a sampled direction follow a point of the source, and the Jacobian of
    # the map from directions to points of the source scales the solid angle of the sample. Any map with a known
    # Jacobian is correct; all samples of a source, by light sampling or BSDF sampling, use the same, so that MIS
    # weights can be differentiated.

    def reparameterised_ray(self, receiver: Receiver, d: mi.Vector3f, active: mi.Bool) -> tuple[mi.Vector3f, mi.Float]:
        """Returns ``(d, jacobian)`` with derivatives that follow a lamp that the ray from ``receiver`` hits."""
        if self.all_delta or not self.lamps:
            return d, mi.Float(1)
        met = meet(self.scene, receiver.si.spawn_ray(d), active)
        active = active & met.is_valid() & met.shape.is_emitter()
        k = self.number_of(met.shape.emitter(), active)
        active &= k < self.lamps
        ds, jacobian = self.lamp(k).reparameterised(receiver, d, met, active)
        return dr.select(active, ds.d, d), dr.select(active, jacobian, 1)

    def reparameterised_sample(
        self, lamp: Lamp, receiver: Receiver, ds: mi.DirectionSample3f, weight: mi.Spectrum, active: mi.Bool
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """Returns the sample ``(ds, weight)`` of ``lamp`` with derivatives of direction, density and weight;
        unchanged if the lamp is no surface, or a ray does not find the sampled point.
        """
        emitter, si = mi.EmitterPtr(lamp.emitter), receiver.si
        active = active & (ds.pdf > 0) & mi.has_flag(emitter.flags(), mi.EmitterFlags.Surface)
        to_point = si.spawn_ray_to(ds.p)  # ends just before the point
        met = meet(self.scene, mi.Ray3f(to_point(to_point.maxt), to_point.d), active)
        active = active & met.is_valid() & (met.shape.emitter() == emitter)
        moved, jacobian = lamp.reparameterised(receiver, dr.detach(ds.d), met, active)
        moved.emitter = emitter
        radiance = eval_direction(emitter, si, moved, active)
        moved_weight = radiance * (dr.relative_grad(jacobian) / dr.detach(dr.select(active, ds.pdf, 1)))
        result = mi.DirectionSample3f(ds)
        result.d = with_derivatives(ds.d, moved.d, active)
        result.pdf = with_derivatives(ds.pdf, self.pdf(receiver, moved, active), active)
        return result, with_derivatives(weight, moved_weight, active)


def meet(scene: mi.Scene, ray: mi.Ray3f, active: mi.Bool) -> mi.SurfaceInteraction3f:
    """Returns the surface point that ``ray`` hits; its derivatives follow the surface."""
    return scene.ray_intersect(dr.detach(ray), int(mi.RayFlags.All) | int(mi.RayFlags.FollowShape), False, active)


def with_derivatives(value: Any, same: Any, active: mi.Bool) -> Any:
    """Returns ``value``, in ``active`` lanes with the derivatives of ``same``."""
    return dr.select(active, dr.replace_grad(value, same), value)
