"""The rays that follow a vertex: sampling of a ray that leaves it through a lobe (thesis, section 4.1), Kajiya's paths,
and Whitted's ray trees with distributed rays.

The progress of a path or tree, :class:`Path` or :class:`Tree`, chooses the rays to follow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from ..masks import but_not, idle
from ..sampling.sobol import Points
from ..sampling.spaces import CHOICE, REFRACTED, ROULETTE
from . import lobes
from .absorption import medium_beyond
from .lobes import LobePoint
from .ray import Ray, Vertex
from .transport_context import Context, direction_space
from .workarounds import failed


def next_ray(
    context: Context, lobe: mi.BSDFContext, vertex: Vertex, points: Points, active: mi.Bool
) -> tuple[Ray, mi.Bool, mi.Float]:
    """Samples the ray that leaves ``vertex`` through ``lobe``, and returns ``(ray, active, eta)``.

    The returned ``active`` is false, too, where the sample belongs to another lobe, or the throughput is at most the
    integrator's ``cutoff`` in all channels. ``eta`` is the relative index of refraction in the direction of the ray, 1
    for a reflection. In scalar variants, the arriving ray is returned if ``active`` is false.
    """
    ray, si, space = vertex.ray, vertex.si, direction_space(lobe)
    if idle(active):
        return ray, active, mi.Float(1)
    bs, weight, d, belongs = sample_direction(context, lobe, vertex, points, active)
    ideal = lobes.has_any(bs.sampled_type, *lobes.IDEAL)
    o, throughput = si.spawn_ray(dr.detach(d)).o, ray.throughput * weight
    if context.attached:  # the small offset of the origin has no derivative
        o = dr.replace_grad(o, si.p)
    active = but_not(active & belongs & (bs.pdf > 0), dr.max(throughput) <= context.settings.cutoff)
    result = replace(ray, o=o, d=d, throughput=throughput, pdf=dr.select(ideal, 0, bs.pdf))
    # The number of the node in a ray tree; a path replaces this number.
    result.level, result.node = ray.level + 1, ray.node * 2 + (space == REFRACTED)
    result.n, result.importance = vertex.receiver.n, vertex.receiver.importance
    result.medium, result.offset = medium_beyond(si, ray.medium, dr.detach(d), active), dr.dot(o - si.p, d)
    by_all_lobes = but_not(vertex.inseparable, ideal)  # light sampling and photons found the light of all lobes
    result.light_found = by_all_lobes if context.caustics is None else ray.light_found | by_all_lobes
    if ray.passed is not None:
        result.passed = ray.passed & lobes.has_any(bs.sampled_type, "Null")
    if context.both_sides:
        result.both_sides = lobes.has_any(vertex.bsdf.flags(), *lobes.BOTH_SIDES)
    if context.photon_mis is not None:
        result = context.photon_mis.next(vertex, result, bs, weight)
    context.observe("scatter", ray, after=result, bs=bs, active=active)
    return result, active, bs.eta


def sample_direction(
    context: Context, lobe: mi.BSDFContext, vertex: Vertex, points: Points, active: mi.Bool
) -> tuple[mi.BSDFSample3f, mi.Spectrum, mi.Vector3f, mi.Bool]:
    """Returns ``(bs, weight, d, belongs)``: the sample of ``lobe`` that light sampling has already drawn
    (``vertex.drawn``), or a new one, its direction in world coordinates, and whether it is a sample of ``lobe``.

    If derivatives are wanted, the direction of a smooth lobe follows the light source that the ray meets, and the
    derivatives of the density and the weight include this motion. The direction of an ideal lobe has the derivatives
    that the BSDF computes.
    """
    si, scattering, throughput = vertex.si, context.scattering, vertex.ray.throughput
    if lobe.type_mask in vertex.drawn:
        bs, weight = vertex.drawn[lobe.type_mask]
        return bs, weight, si.to_world(bs.wo), (bs.sampled_type & lobe.type_mask) != 0
    u = lobe_point(context, lobe, vertex, points, active)
    with dr.suspend_grad(when=context.attached):
        bs, weight, belongs = scattering.sample(lobe, vertex, u, active, throughput)
        d = si.to_world(bs.wo)
    if not context.attached:
        return bs, weight, d, belongs
    ideal = lobes.has_any(bs.sampled_type, *lobes.IDEAL)
    smooth = but_not(active, ideal)
    moved, jacobian = context.lights.reparameterised_ray(vertex.receiver, d, smooth)
    wo = si.to_local(moved)
    f, pdf = scattering.eval_pdf(lobe, vertex, wo, smooth)
    belongs = but_not(belongs, failed(si, bs, weight, dr.detach(f)))
    weight = f * dr.relative_grad(jacobian) / dr.detach(dr.select(pdf > 0, pdf, 1))
    if lobes.has_any(context.flags, *lobes.IDEAL):  # sampled again, now with derivatives
        ideal_bs, ideal_weight, _ = scattering.sample(lobe, vertex, u, active & ideal, throughput)
        moved = dr.select(ideal, si.to_world(ideal_bs.wo), moved)
        weight = dr.select(ideal, ideal_weight, weight)
    bs.pdf = dr.replace_grad(bs.pdf, pdf)
    return bs, weight, dr.replace_grad(d, moved), belongs


def roulette(ray: Ray, active: mi.Bool, survival: mi.Float, sample: mi.Float) -> tuple[Ray, mi.Bool]:
    """Returns ``(ray, active)`` after Russian roulette (Arvo and Kirk 1990): a ray survives with the probability
    ``survival``, by which its throughput is divided; ``sample`` is in [0, 1).
    """
    survival = dr.detach(survival)
    survives = sample < survival
    throughput = dr.select(survives, ray.throughput / dr.clip(survival, 1e-8, 1), 0)
    return replace(ray, throughput=throughput), active & survives


def lobe_point(context: Context, lobe: mi.BSDFContext, vertex: Vertex, points: Points, active: mi.Bool) -> LobePoint:
    """Returns the random numbers that choose one of the lobes in ``lobe``, or a wavelength at dispersive glass, and
    sample the direction of the ray from ``vertex``.
    """
    space = context.space(vertex.ray.node, CHOICE)
    # A stratified choice reduces the variance only with dispersion, or where all lobes are sampled together.
    stratified = lobe.type_mask == mi.BSDFContext().type_mask or context.scattering.disperses
    choice = points(space, active).x if stratified else points.choice(space)
    point = points(context.space(vertex.ray.node, direction_space(lobe)), active)
    return context.scattering.lobe_choice(points, space, choice), point


# ---------------------------------------------------------------- paths (thesis, section 4.2.3)


@dataclass
class Path:
    """The progress of Kajiya's path, in which one ray leaves each surface, through a specular or a diffuse lobe."""

    #: Number of diffuse reflections so far. None where this number is unlimited: a variable that no iteration changes
    #: makes Dr.Jit trace the loop twice.
    bounces: mi.UInt32 | None
    #: Product of the relative indices of refraction at the surfaces that the path crossed so far.
    eta: mi.Float

    @classmethod
    def start(cls, context: Context, ray: Ray) -> Path:
        """Returns the progress at the start of a path; ``ray`` is unused (:meth:`Tree.start` needs it)."""
        return cls(mi.UInt32(0) if context.settings.diffuse_bounces >= 0 else None, mi.Float(1))

    def proceed(self, context: Context, vertex: Vertex, points: Points, active: mi.Bool) -> tuple[Ray, mi.Bool, Path]:
        """Samples the ray that continues the path after ``vertex``; returns ``(ray, active, path)``.

        If the number of diffuse reflections is unlimited, the ray is sampled from all lobes together; else it leaves
        through a specular or a diffuse lobe. Russian roulette begins at a throughput below ``rr_throughput``. From
        level ``rr_depth`` on, any path ends with a probability of at least 0.05, because no material may darken it.
        ``active`` is unused (:meth:`Tree.proceed` needs it).
        """
        bounces, node = self.bounces, vertex.ray.node
        if bounces is None:
            ray, continues, eta = next_ray(context, mi.BSDFContext(), vertex, points, vertex.active)
        else:
            ray, continues, eta, bounces = specular_or_diffuse(context, vertex, points, bounces)
        ray.node = node + 1
        eta *= self.eta
        survival = dr.select(ray.level >= context.settings.rr_depth, mi.Float(0.95), 1)
        if (limit := context.settings.rr_throughput) > 0:
            # The factor eta² makes up for the scaling of radiance inside glass, which is not a loss of light.
            survival = dr.minimum(survival, dr.max(ray.throughput) * dr.square(eta) / dr.opaque(mi.Float, limit))
        ray, continues = roulette(ray, continues, survival, points.choice(context.space(node, ROULETTE)))
        return ray, continues, Path(bounces, eta)


def specular_or_diffuse(
    context: Context, vertex: Vertex, points: Points, bounces: mi.UInt32
) -> tuple[Ray, mi.Bool, mi.Float, mi.UInt32]:
    """Returns ``(ray, active, eta, bounces)`` for one ray that leaves ``vertex`` through a specular or a diffuse lobe.

    The function samples one ray of each, and chooses in proportion to the greatest component of its throughput, which
    is then divided by the probability of the choice. After ``diffuse_bounces`` diffuse reflections, counted by
    ``bounces``, all rays are specular. ``eta`` is that of :func:`.next_ray`.
    """
    specular, reflects, eta = next_ray(context, lobes.only(lobes.SPECULAR), vertex, points, vertex.active)
    may_scatter = vertex.active & (bounces < context.settings.diffuse_bounces)
    diffuse, scatters, _ = next_ray(context, lobes.only(lobes.DIFFUSE), vertex, points, may_scatter)
    diffuse = replace(diffuse, light_found=mi.Bool(True))  # by light sampling and photons at ``vertex``
    specular_weight = dr.select(reflects, dr.max(specular.throughput), 0)
    diffuse_weight = dr.select(scatters, dr.max(diffuse.throughput), 0)
    total = specular_weight + diffuse_weight
    p_diffuse = dr.select(total > 0, diffuse_weight / dr.select(total > 0, total, 1), 0)
    # With the workarounds, the space CHOICE already chose a lobe. A path uses the space REFRACTED for nothing else.
    # Without the workarounds, no BSDF has a diffuse lobe and two specular lobes: the number in CHOICE is still unused.
    choice = REFRACTED if context.scattering.needs_workarounds else CHOICE
    takes_diffuse = points.choice(context.space(vertex.ray.node, choice)) < p_diffuse
    diffuse_state, specular_state = (diffuse, scatters, mi.Float(1), bounces + 1), (specular, reflects, eta, bounces)
    ray, active, eta, bounces = dr.select(takes_diffuse, diffuse_state, specular_state)
    ray.throughput *= dr.rcp(dr.detach(dr.select(takes_diffuse, p_diffuse, 1 - p_diffuse)))
    return ray, active, eta, bounces


# ---------------------------------------------------------------- ray trees (thesis, sections 4.1, 4.2)


@dataclass
class Tree:
    """The progress of a ray tree, in which a ray continues as a reflected and a refracted ray: the stack of refracted
    rays that are not followed yet, ``count`` of them, at most one for each level.

    The rays are separate variables in registers: a local array would be slower, and is not reliable in Dr.Jit 1.5.
    """

    rays: list[Ray]
    count: mi.UInt32

    @classmethod
    def start(cls, context: Context, ray: Ray) -> Tree:
        """Returns an empty stack, filled with ``ray``; it has no slots if no vertex can have two rays."""
        rays = [ray] * (context.settings.max_level + 1) if context.reflects and context.refracts else []
        return cls(rays, dr.opaque(mi.UInt32, 0))  # opaque, as in Context.first

    def proceed(self, context: Context, vertex: Vertex, points: Points, active: mi.Bool) -> tuple[Ray, mi.Bool, Tree]:
        """Samples the reflected and the refracted ray at ``vertex``; returns ``(ray, active, tree)``: the next ray to
        follow, the lanes that have one, and the new progress.

        ``active`` tells which lanes had not finished their ray tree. If both rays exist, the reflected ray is next, and
        the refracted ray is pushed onto the stack. If neither exists, the last ray of the stack is next.
        """

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

        reflected, reflects = branch(context.reflects, lobes.REFLECTED)
        refracted, refracts = branch(context.refracts, lobes.REFRACTED)
        ray, continues, both = dr.select(reflects, reflected, refracted), reflects | refracts, reflects & refracts
        resumes = but_not(active & (self.count > 0), continues)
        rays = []
        for slot, waiting in enumerate(self.rays):
            ray = dr.select(resumes & (self.count == slot + 1), waiting, ray)
            rays.append(dr.select(both & (self.count == slot), refracted, waiting))
        count = dr.select(both, self.count + 1, dr.select(resumes, self.count - 1, self.count))
        return ray, continues | resumes, Tree(rays, count)
