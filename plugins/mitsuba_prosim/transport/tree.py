"""Whitted's tree with distributed rays: both the reflected and the refracted ray are followed (sections 4.1, 4.2)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from ..masks import but_not
from ..sampling.sobol import Points
from . import lobes
from .context import REFLECTED, REFRACTED, ROULETTE, Context
from .loop import walk
from .next_ray import next_ray
from .ray import Ray
from .vertex import shade


@dataclass
class Waiting:
    """Refracted rays that wait for their turn, depth first: one for each level, in registers (a local array would be
    slower, and is not reliable in Dr.Jit 1.5). ``count``: how many; None where there are no ``rays``, as Dr.Jit follows
    a loop twice in which something stays as it is.
    """

    rays: list[Ray]
    count: mi.UInt32 | None

    @classmethod
    def none(cls, most: int, ray: Ray) -> Waiting:
        """No ray yet, of at most so many; ``ray``: any that there is."""
        return cls([ray] * most, mi.UInt32(0) if most else None)

    def turn(
        self, reflected: Ray, reflects: mi.Bool, refracted: Ray, refracts: mi.Bool, active: mi.Bool
    ) -> tuple[Ray, mi.Bool, Waiting]:
        """The ray that comes next and its lanes: the reflected one, while the refracted one waits; or the only one of
        the two; or the last one that waits.
        """
        following, going = dr.select(reflects, reflected, refracted), reflects | refracts
        if self.count is None:
            return following, going, self
        both = reflects & refracts
        resumes = but_not(active & (self.count > 0), going)
        rays = []
        for slot, ray in enumerate(self.rays):
            following = dr.select(resumes & (self.count == slot + 1), ray, following)
            rays.append(dr.select(both & (self.count == slot), refracted, ray))
        count = dr.select(both, self.count + 1, dr.select(resumes, self.count - 1, self.count))
        return following, going | resumes, Waiting(rays, count)


@dataclass
class State:
    """Where a walk through the tree is. ``sampler``: what the points are drawn from, if that has a state."""

    L: mi.Spectrum
    hit: mi.Bool
    ray: Ray
    active: mi.Bool
    waiting: Waiting
    sampler: mi.Sampler | None


def radiance(
    context: Context, camera: mi.Ray3f, points: Points, active: mi.Bool, sampler: mi.Sampler = None
) -> tuple[mi.Spectrum, mi.Bool]:
    """Radiance of the camera ray ``camera`` (``mi.Ray3f``) by the whole tree: ``(L, hit)``; see :class:`.Transport`."""
    facts, max_level = context.facts, context.settings.max_level
    first = context.first(camera)
    waiting = Waiting.none(max_level + 1 if facts.reflects and facts.refracts else 0, first)

    def step(state: State) -> State:
        scattered = False if state.ray.gathered is None else state.ray.gathered
        L, vertex = shade(context, state.ray, camera, points, state.active, scattered)
        ray = vertex.ray
        hit = state.hit | (ray.level == 0) & vertex.surface
        inside = vertex.surface & (ray.level <= max_level)
        reflected, reflects = ray, mi.Bool(False)
        refracted, refracts = ray, mi.Bool(False)
        if facts.reflects:
            reflected, reflects, _ = next_ray(context, lobes.reflected(), REFLECTED, vertex, points, inside)
            reflected, reflects = roulette(context, reflected, reflects, points)
        if facts.refracts:
            refracted, refracts, _ = next_ray(context, lobes.refracted(), REFRACTED, vertex, points, inside)
            refracted, refracts = roulette(context, refracted, refracts, points)
        following, going, waiting = state.waiting.turn(reflected, reflects, refracted, refracts, state.active)
        return State(state.L + L, hit, following, going, waiting, state.sampler)

    state = State(mi.Spectrum(0), mi.Bool(False), first, mi.Bool(active), waiting, sampler)
    if not (facts.reflects or facts.refracts):
        state = step(state)
        return state.L, state.hit
    return walk(context, step, state, camera, branches=bool(waiting.rays))


def roulette(context: Context, ray: Ray, active: mi.Bool, points: Points) -> tuple[Ray, mi.Bool]:
    """The ray and its lanes after Russian roulette, where it is weaker than ``rr_throughput``: it goes on as often as
    it is a part of that, with so much more weight (Arvo and Kirk 1990).
    """
    if context.settings.rr_throughput == 0:
        return ray, active
    survival = dr.detach(dr.max(ray.throughput) / dr.opaque(mi.Float, context.settings.rr_throughput))
    going = points.choice(context.space(ray.node, ROULETTE)) < survival
    throughput = dr.select(going, ray.throughput / dr.minimum(survival, 1), 0)
    return replace(ray, throughput=throughput), active & going
