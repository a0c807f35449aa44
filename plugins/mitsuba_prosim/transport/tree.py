"""Whitted's tree with distributed rays: both the reflected and the refracted ray are followed (sections 4.1, 4.2)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from ..masks import but_not
from ..sampling.sobol import Points
from . import lobes
from .next_ray import next_ray
from .ray import Ray, Vertex
from .transport_context import ROULETTE, Context


@dataclass
class Stack:
    """A stack of refracted rays, depth first: one for each level, in registers (a local array would be slower, and is
    not reliable in Dr.Jit 1.5). ``count``: how many it holds; None where there are no ``rays``, as Dr.Jit traces a loop
    twice in which a variable stays as it is.
    """

    rays: list[Ray]
    count: mi.UInt32 | None

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


def start(context: Context, ray: Ray) -> Stack:
    """The empty stack of a tree; ``ray``: any."""
    rays = [ray] * (context.settings.max_level + 1) if branches(context) else []
    return Stack(rays, mi.UInt32(0) if rays else None)


def branches(context: Context) -> bool:
    """Whether a node may have two rays."""
    return context.reflects and context.refracts


def proceed(
    context: Context, vertex: Vertex, points: Points, active: mi.Bool, stack: Stack
) -> tuple[Ray, mi.Bool, Stack]:
    """``(ray, active, stack)``: the ray to follow after ``vertex``, its lanes, and the stack of those still to follow.
    ``active``: the lanes of the tree.
    """

    def branch(follows: bool, lobe: mi.BSDFContext) -> tuple[Ray, mi.Bool]:
        if not follows:
            return vertex.ray, mi.Bool(False)
        ray, active, _ = next_ray(context, lobe, vertex, points, vertex.active)
        return roulette(context, ray, active, points)

    reflected, refracted = branch(context.reflects, lobes.reflected()), branch(context.refracts, lobes.refracted())
    return stack.next(*reflected, *refracted, active)


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
