"""Whitted's ray tree with distributed rays: at each surface, a ray continues as a reflected and a refracted ray
(thesis, sections 4.1, 4.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..masks import but_not
from ..sampling.sobol import Points
from ..sampling.spaces import ROULETTE
from . import lobes
from .next_ray import next_ray, roulette
from .ray import Ray, Vertex
from .transport_context import Context


@dataclass
class Stack:
    """The refracted rays that are not followed yet, ``count`` of them: at most one for each level of the ray tree.

    The rays are separate variables in registers: a local array would be slower, and is not reliable in Dr.Jit 1.5.
    """

    rays: list[Ray]
    count: mi.UInt32

    def next(
        self, reflected: Ray, reflects: mi.Bool, refracted: Ray, refracts: mi.Bool, active: mi.Bool
    ) -> tuple[Ray, mi.Bool, Stack]:
        """Returns ``(ray, active, stack)``: the next ray to follow, the lanes that have one, and the new stack.

        ``active`` tells which lanes had not finished their ray tree. If both rays exist, the reflected ray is next, and
        the refracted ray is pushed onto the stack. If neither exists, the last ray of the stack is next.
        """
        next_ray, continues = dr.select(reflects, reflected, refracted), reflects | refracts
        both = reflects & refracts
        resumes = but_not(active & (self.count > 0), continues)
        rays = []
        for slot, ray in enumerate(self.rays):
            next_ray = dr.select(resumes & (self.count == slot + 1), ray, next_ray)
            rays.append(dr.select(both & (self.count == slot), refracted, ray))
        count = dr.select(both, self.count + 1, dr.select(resumes, self.count - 1, self.count))
        return next_ray, continues | resumes, Stack(rays, count)


def start(context: Context, ray: Ray) -> Stack:
    """Returns an empty stack, filled with ``ray``; it has no slots if no vertex can have two rays."""
    rays = [ray] * (context.settings.max_level + 1) if context.reflects and context.refracts else []
    return Stack(rays, dr.opaque(mi.UInt32, 0))  # opaque, as in Context.first


def proceed(
    context: Context, vertex: Vertex, points: Points, active: mi.Bool, stack: Stack
) -> tuple[Ray, mi.Bool, Stack]:
    """Samples the reflected and the refracted ray at ``vertex``, and returns the result of :meth:`Stack.next`."""

    def branch(follows: bool, names: Sequence[str]) -> tuple[Ray, mi.Bool]:
        """Returns the ray that leaves the vertex through the lobes ``names``, and the lanes in which it exists and
        survives Russian roulette, which begins at a throughput below ``rr_throughput``.
        """
        if not follows:
            return vertex.ray, mi.Bool(False)
        ray, active, _ = next_ray(context, lobes.only(names), vertex, points, vertex.active)
        if (limit := context.settings.rr_throughput) == 0:
            return ray, active
        survival = dr.max(ray.throughput) / dr.opaque(mi.Float, limit)
        return roulette(ray, active, survival, points.choice(context.space(ray.node, ROULETTE)))

    reflected, refracted = branch(context.reflects, lobes.REFLECTED), branch(context.refracts, lobes.REFRACTED)
    return stack.next(*reflected, *refracted, active)
