"""Whitted's tree with distributed rays: both the reflected and the refracted ray are followed (sections 4.1, 4.2)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from ..masks import but_not
from ..sampling.sobol import Points
from . import lobes
from .loop import walk
from .next_ray import next_ray
from .radiance import Radiance
from .ray import Ray, Vertex
from .transport_context import ROULETTE, Context
from .vertex import shade


@dataclass
class Stack:
    """A stack of refracted rays, depth first: one for each level, in registers (a local array would be slower, and is
    not reliable in Dr.Jit 1.5). ``count``: how many it holds; None where there are no ``rays``, as Dr.Jit traces a loop
    twice in which a variable stays as it is.
    """

    rays: list[Ray]
    count: mi.UInt32 | None

    @classmethod
    def empty(cls, size: int, ray: Ray) -> Stack:
        """An empty stack for at most ``size`` rays; ``ray``: any."""
        return cls([ray] * size, mi.UInt32(0) if size else None)

    def next(
        self, reflected: Ray, reflects: mi.Bool, refracted: Ray, refracts: mi.Bool, active: mi.Bool
    ) -> tuple[Ray, mi.Bool, Stack]:
        """``(ray, active, stack)``: the ray to follow next and its lanes. That is the reflected one, and the refracted
        one is pushed; or the only one of the two; or the last one of the stack.
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
        return following, going | resumes, Stack(rays, count)


@dataclass
class State:
    """State of the loop over the nodes. ``sampler``: the source of the points, if that has a state."""

    L: Radiance
    hit: mi.Bool
    ray: Ray
    active: mi.Bool
    stack: Stack
    sampler: mi.Sampler | None


def radiance(
    context: Context, camera: mi.Ray3f, points: Points, active: mi.Bool, sampler: mi.Sampler = None
) -> tuple[Radiance, mi.Bool]:
    """``(L, hit)`` of the camera ray ``camera`` (``mi.Ray3f``) by the whole tree; see :class:`.Transport`."""
    first = context.first(camera)
    stack = Stack.empty(context.settings.max_level + 1 if context.reflects and context.refracts else 0, first)

    def branch(follows: bool, lobe: mi.BSDFContext, vertex: Vertex) -> tuple[Ray, mi.Bool]:
        if not follows:
            return vertex.ray, mi.Bool(False)
        ray, active, _ = next_ray(context, lobe, vertex, points, vertex.active)
        return roulette(context, ray, active, points)

    def step(state: State) -> State:
        L, vertex = shade(context, state.ray, camera, points, state.active)
        hit = state.hit | (state.ray.level == 0) & vertex.active
        reflected = branch(context.reflects, lobes.reflected(), vertex)
        refracted = branch(context.refracts, lobes.refracted(), vertex)
        following, going, stack = state.stack.next(*reflected, *refracted, state.active)
        return State(state.L + L, hit, following, going, stack, state.sampler)

    state = State(context.layers.none(), mi.Bool(False), first, mi.Bool(active), stack, sampler)
    if not (context.reflects or context.refracts):
        state = step(state)
        return state.L, state.hit
    return walk(context, step, state, camera, branches=bool(stack.rays))


def roulette(context: Context, ray: Ray, active: mi.Bool, points: Points) -> tuple[Ray, mi.Bool]:
    """The ray and its lanes after Russian roulette (Arvo and Kirk 1990): a ray weaker than ``rr_throughput`` survives
    with the probability of its throughput over that, and with its weight divided by the probability.
    """
    if context.settings.rr_throughput == 0:
        return ray, active
    survival = dr.detach(dr.max(ray.throughput) / dr.opaque(mi.Float, context.settings.rr_throughput))
    going = points.choice(context.space(ray.node, ROULETTE)) < survival
    throughput = dr.select(going, ray.throughput / dr.minimum(survival, 1), 0)
    return replace(ray, throughput=throughput), active & going
