"""One node of the ray tree, or vertex of a path: what it adds to the radiance, and the rays that go on from it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi

from ..light.table import Lamp
from ..masks import but_not, idle
from ..optics import ambient
from ..sampling.nrook import NRook, SamplerPoints
from . import lobes
from .indivisible import belongs_to, is_whole
from .moving import carried_ray, carried_sample
from .scene_facts import SceneFacts
from .settings import Settings
from .surroundings import background_radiance

#: Spaces of the sampling pattern that belong to the camera; those of the nodes follow.
PIXEL, LENS, TIME_AND_WAVELENGTH, CAMERA_SPACES = 0, 1, 2, 3

#: Spaces of a node, before those of the sources.
REFLECTED, REFRACTED, DIFFUSE, CHOICE, ROULETTE, NODE_SPACES = 0, 1, 2, 3, 4, 5


@dataclass
class Ray:
    """A ray of the tree or path, with what its node needs. All fields are Dr.Jit arrays of one width."""

    o: mi.Point3f
    d: mi.Vector3f
    #: ``mi.Spectrum``: factor from the radiance of this ray to that of the camera ray.
    throughput: mi.Spectrum
    #: Number of the node. In a tree as in a heap: 1 is the camera's, 2 n and 2 n + 1 the reflected and refracted one
    #: of n.
    node: mi.UInt32
    #: Number of reflections and refractions before this ray: 0 is the camera's.
    level: mi.UInt32
    #: Density per solid angle with which a lobe drew ``d``; of no meaning unless ``shares``.
    pdf: mi.Float
    #: Whether a source that it meets could have been sampled at its origin too, and shares its light with that.
    shares: mi.Bool
    #: Whether a source that it meets counts at all; not where the sources were sampled in full.
    counts: mi.Bool
    #: Normal of the surface that the ray leaves, on the viewer's side.
    n: mi.Normal3f
    #: Whether light from both of the sides of that surface was sampled.
    both_sides: mi.Bool

    @classmethod
    def first(cls, camera: mi.Ray3f) -> Ray:
        """The camera's ray."""
        return cls(
            camera.o,
            camera.d,
            mi.Spectrum(1),
            mi.UInt32(1),
            mi.UInt32(0),
            mi.Float(0),
            mi.Bool(False),
            mi.Bool(True),
            mi.Normal3f(camera.d),
            mi.Bool(False),
        )


@dataclass
class Node:
    """What a ray has met, for the rays that go on from there."""

    si: mi.SurfaceInteraction3f
    bsdf: mi.BSDFPtr
    #: The lanes that met a surface.
    surface: mi.Bool


def mis(pdf: mi.Float, other: mi.Float) -> mi.Float:
    """Weight of a sample of density ``pdf`` that ``other`` could have given too: power heuristic (Veach 1997)."""
    a, b = dr.square(pdf), dr.square(other)
    return dr.select(a > 0, a / dr.select(a > 0, a + b, 1), 0)


@dataclass(frozen=True)
class Nodes:
    """The nodes of ``scene`` under ``settings``.

    ``attached``: whether derivatives are wanted; directions are then fixed, or carried along with a source
    (:mod:`.moving`), and their weights evaluated anew.
    """

    scene: mi.Scene
    settings: Settings
    facts: SceneFacts
    attached: bool = False

    def space(self, node: mi.UInt32, k: int | mi.UInt32) -> mi.UInt32:
        """Number of the ``k``-th space of a node."""
        return CAMERA_SPACES + node * (NODE_SPACES + self.facts.lights.count) + k

    def shade(
        self, ray: Ray, camera: mi.Ray3f, points: NRook | SamplerPoints, active: mi.Bool
    ) -> tuple[mi.Spectrum, Node]:
        """``(L, node)``: what a node adds to the radiance of the camera ray, by emission, background, ambient and
        direct light; and the :class:`Node`. ``camera``: the camera ray, for time and wavelengths.
        """
        settings, lights = self.settings, self.facts.lights
        ray3, si = self.meet(ray, camera, active)
        if settings.hide_emitters and not lights.only_points:
            si = self.past_emitters(ray3, si, active & (ray.level == 0))
        surface = active & si.is_valid()
        inside = active if settings.max_level < 0 else active & (ray.level <= settings.max_level)
        L = mi.Spectrum(0)
        if not lights.only_points:
            L += self.emission(ray, si, active)
        if settings.background is not None:
            escaped = but_not(inside, surface)
            L += dr.select(escaped, background_radiance(settings.background, ray3, si, escaped), 0)
        surface_inside = surface & inside
        if idle(surface_inside):
            return ray.throughput * L, Node(si, None, False)
        bsdf = si.bsdf()
        if settings.ambient is not None:
            L += self.ambient_term(si, bsdf, surface_inside)
        L += self.direct(ray, si, bsdf, points, surface_inside)
        return ray.throughput * L, Node(si, bsdf, surface)

    def meet(self, ray: Ray, camera: mi.Ray3f, active: mi.Bool) -> tuple[mi.Ray3f, mi.SurfaceInteraction3f]:
        """The ``mi.Ray3f`` of a :class:`Ray`, and its interaction with the scene."""
        ray3 = mi.Ray3f(ray.o, ray.d, camera.time, camera.wavelengths)
        ray3.maxt = dr.select(ray.level == 0, camera.maxt, ray3.maxt)  # up to the camera's far_clip
        return ray3, self.scene.ray_intersect(ray3, mi.RayFlags.All, ray.level == 0, active=active)

    def past_emitters(self, ray: mi.Ray3f, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.SurfaceInteraction3f:
        """The interaction behind all emitters that the camera ray ``ray`` meets first.

        (Mitsuba 3.9's ``skip_area_emitters`` counts the distance from the last emitter, so that what is behind is
        found in a wrong place, and knows no ``maxt``.)
        """
        hidden = active & si.is_valid()
        if idle(hidden):
            return si
        hidden &= si.shape.is_emitter()

        def beyond(o: mi.Point3f) -> mi.Ray3f:
            """The rest of the ray, from ``o`` on."""
            rest = mi.Ray3f(ray)
            rest.o, rest.maxt = o, ray.maxt - dr.dot(o - ray.o, ray.d)
            return rest

        def step(o: mi.Point3f, blocked: mi.Bool) -> tuple[mi.Point3f, mi.Bool]:
            pi = self.scene.ray_intersect_preliminary(beyond(o), active=blocked)
            blocked = blocked & pi.is_valid()
            if idle(blocked):
                return o, blocked
            blocked &= pi.shape.is_emitter()
            front = pi.compute_surface_interaction(beyond(o), mi.RayFlags.Minimal, blocked)
            return dr.select(blocked, front.spawn_ray(ray.d).o, o), blocked

        with dr.suspend_grad(when=self.attached):
            o, _ = dr.while_loop((mi.Point3f(ray.o), hidden), lambda o, blocked: blocked, step, labels=("o", "blocked"))
        if self.attached:
            o = dr.replace_grad(o, ray.o + ray.d * dr.norm(o - dr.detach(ray.o)))
        return dr.select(hidden, self.scene.ray_intersect(beyond(o), hidden), si)

    def end(self, ray: Ray, camera: mi.Ray3f, active: mi.Bool) -> mi.Spectrum:
        """What a ray adds that can only end in a source."""
        _, si = self.meet(ray, camera, active)
        return ray.throughput * self.emission(ray, si, active)

    def emission(self, ray: Ray, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Spectrum:
        """Radiance of a source that ``ray`` meets, shared with the sampling of the sources at the ray's origin."""
        lights = self.facts.lights
        emitter = si.emitter(self.scene)
        active = active & ray.counts
        if self.settings.hide_emitters:
            active &= ray.level > 0
        if idle(active) or emitter is None:
            return mi.Spectrum(0)
        L = emitter.eval(si, active)
        shares = active & ray.shares
        if lights.sky is not None:
            shares &= si.is_valid()
        origin = dr.zeros(mi.Interaction3f)
        origin.p, origin.n, origin.time, origin.t = ray.o, ray.n, si.time, mi.Float(0)
        ds = mi.DirectionSample3f(self.scene, si, origin)
        if self.attached:  # not by way of the point, whose derivative is unbounded at a sphere's outline
            ds.d = dr.replace_grad(ds.d, ray.d)
        pdf = lights.pdf(origin, ray.n, ray.both_sides if self.facts.both_sides else False, ds, shares)
        return dr.select(active, L * dr.select(shares, mis(ray.pdf, pdf), 1), 0)

    def ambient_term(
        self, si: mi.SurfaceInteraction3f, bsdf: mi.BSDF | mi.BSDFPtr, active: mi.Bool
    ) -> mi.UnpolarizedSpectrum:
        """The ambient term ka I_a."""
        assert self.settings.ambient is not None
        if dr.is_jit_v(mi.Float):
            ka = dr.dispatch(bsdf, ambient.reflectance, si, active)
        else:
            ka = ambient.reflectance(bsdf, si, active)
        return ka * self.settings.ambient.eval(si, active)

    def direct(
        self,
        ray: Ray,
        si: mi.SurfaceInteraction3f,
        bsdf: mi.BSDF | mi.BSDFPtr,
        points: NRook | SamplerPoints,
        active: mi.Bool,
    ) -> mi.Spectrum:
        """Light from every source through the whole BRDF: one point in each, one shadow ray to it (section 4.1)."""
        lights, alone = self.facts.lights, self.facts.alone
        flags = bsdf.flags()
        active = active & mi.has_flag(flags, mi.BSDFFlags.Smooth)
        n = viewer_side(si)
        both_sides = active & lobes.has_any(flags, *lobes.BOTH_SIDES) if self.facts.both_sides else False
        first_space = self.space(ray.node, NODE_SPACES)
        whole = active & is_whole(bsdf, active) if self.facts.indivisible else mi.Bool(False)

        def light(lamp: Lamp, L: mi.Spectrum) -> mi.Spectrum:
            sample = lamp.sample(si, n, both_sides, points(first_space + lamp.k, active), active)
            if self.attached:
                sample = carried_sample(self.scene, lights, lamp, si, n, both_sides, sample, active)
            lit = active & (sample.pdf > 0)
            wo = si.to_local(sample.d)
            f = bsdf.eval(alone, si, wo, lit) if alone is not None else mi.Spectrum(0)
            for lobe in self.facts.partners:
                f_lobe, pdf_lobe = bsdf.eval_pdf(lobe, si, wo, lit)
                f += f_lobe * dr.select(sample.delta, 1, mis(sample.pdf, pdf_lobe))
            if self.facts.indivisible:
                f = dr.select(whole, bsdf.eval(lobes.everything(), si, wo, lit & whole), f)
            return L + self.unless_in_shadow(si, sample.p, f * sample.weight, lit)

        L = lights.for_each(light, mi.Spectrum(0), active, attached=self.attached)
        if lights.sky is not None and alone is not None:
            # The rays that are drawn from the other lobes meet the sky by themselves.
            active = active & (lobes.has_any(flags, *lobes.DIFFUSE) | whole)
            if self.facts.both_sides:
                both_sides &= active & (lobes.has_any(flags, "DiffuseTransmission") | whole)
            sample = lights.sample_sky(si, n, both_sides, points(first_space + lights.lamps, active), active)
            lit, wo = active & (sample.pdf > 0), si.to_local(sample.d)
            f = bsdf.eval(alone, si, wo, lit)
            if self.facts.indivisible:
                f = dr.select(whole, bsdf.eval(lobes.everything(), si, wo, lit & whole), f)
            L += self.unless_in_shadow(si, sample.p, f * sample.weight, lit)
        return L

    def unless_in_shadow(
        self, si: mi.SurfaceInteraction3f, p: mi.Point3f, L: mi.Spectrum, active: mi.Bool
    ) -> mi.Spectrum:
        """``L`` where nothing is between ``si`` and the point ``p``, else 0."""
        if self.settings.shadows:
            active &= dr.max(dr.abs(L)) > 0
            active = but_not(active, self.scene.ray_test(si.spawn_ray_to(p), active))
        return dr.select(active, L, 0)

    def follow(
        self, lobe: mi.BSDFContext, k: int, ray: Ray, node: Node, points: NRook | SamplerPoints, active: mi.Bool
    ) -> tuple[Ray, mi.Bool, mi.Float]:
        """Draws the ray that goes on from ``node`` through the lobes of the ``mi.BSDFContext`` ``lobe``.

        Returns the ray, the lanes that follow it and the ratio of the indices that it crosses. ``k``: its space in the
        node.
        """
        if idle(active):
            return ray, active, mi.Float(1)
        settings, lights, si, bsdf = self.settings, self.facts.lights, node.si, node.bsdf
        space = self.space(ray.node, CHOICE)
        # Only whole BSDFs choose among lobes often enough for strata to pay.
        choice = points(space, active).x if lobes.is_everything(lobe) else points.choice(space)
        sample = points(self.space(ray.node, k), active)
        counts = mi.Bool(True)
        with dr.suspend_grad(when=self.attached):
            bs, weight = bsdf.sample(lobe, si, choice, sample, active)
            # Some BSDFs (mask, thindielectric) sample other lobes than they are asked for: these have a turn of their
            # own.
            belongs = (bs.sampled_type & lobe.type_mask) != 0
            if self.facts.indivisible:
                whole = active & is_whole(bsdf, active)
                bs, weight, belongs = self.sample_whole(lobe, si, bsdf, choice, sample, whole, (bs, weight, belongs))
                counts = but_not(counts, but_not(whole, lobes.has_any(bs.sampled_type, "Delta", "Null")))
            d = si.to_world(bs.wo)
        ideal = lobes.has_any(bs.sampled_type, "Delta", "Null")
        o, pdf = si.spawn_ray(d).o, bs.pdf
        if self.attached:
            drawn = but_not(active, ideal)
            moved, jacobian = carried_ray(self.scene, lights, si, viewer_side(si), d, drawn)
            f, pdf = bsdf.eval_pdf(lobe, si, si.to_local(moved), drawn)
            forced, ideal_weight = bsdf.sample(lobe, si, choice, sample, active & ideal)
            if self.facts.indivisible:
                f_whole, pdf_whole = bsdf.eval_pdf(lobes.everything(), si, si.to_local(moved), but_not(whole, ideal))
                forced_whole, ideal_whole = bsdf.sample(lobes.everything(), si, choice, sample, whole & ideal)
                f, pdf, ideal_weight = dr.select(whole, (f_whole, pdf_whole, ideal_whole), (f, pdf, ideal_weight))
                forced = dr.select(whole, forced_whole, forced)
            d = dr.replace_grad(d, dr.select(ideal, si.to_world(forced.wo), moved))
            weight = dr.select(
                ideal, ideal_weight, f * dr.relative_grad(jacobian) / dr.detach(dr.select(pdf > 0, pdf, 1))
            )
            o, pdf = dr.replace_grad(o, si.p), dr.replace_grad(bs.pdf, pdf)
        throughput = ray.throughput * weight
        active = active & belongs & (bs.pdf > 0) & (dr.max(throughput) > settings.cutoff)
        if settings.max_level >= 0 and lights.can_foresee:
            # The rays below the deepest level can only end in a source.
            active &= (ray.level < settings.max_level) | lights.may_meet(dr.detach(o), dr.detach(d))
        following = replace(
            ray,
            o=o,
            d=d,
            throughput=throughput,
            level=ray.level + 1,
            node=ray.node * 2 + (k == REFRACTED),
            pdf=pdf,
            shares=but_not(mi.Bool(True), ideal),
            counts=counts,
            n=viewer_side(si),
        )
        if self.facts.both_sides:
            following.both_sides = lobes.has_any(bsdf.flags(), *lobes.BOTH_SIDES)
        return following, active, bs.eta

    @staticmethod
    def sample_whole(
        lobe: mi.BSDFContext,
        si: mi.SurfaceInteraction3f,
        bsdf: mi.BSDF | mi.BSDFPtr,
        choice: mi.Float,
        sample: mi.Point2f,
        whole: mi.Bool,
        others: tuple[Any, ...],
    ) -> tuple[Any, ...]:
        """``(bs, weight, belongs)``: ``others`` but for the lanes ``whole``, where all lobes of ``bsdf`` are sampled,
        and
        ``belongs`` says whether the sample counts for ``lobe``.
        """
        if idle(whole):
            return others
        bs, weight = bsdf.sample(lobes.everything(), si, choice, sample, whole)
        return tuple(dr.select(whole, a, b) for a, b in zip((bs, weight, belongs_to(lobe, si.wi, bs)), others))


def viewer_side(si: mi.SurfaceInteraction3f) -> mi.Normal3f:
    """Shading normal, turned to the side that the surface is seen from."""
    return si.sh_frame.n * dr.sign(mi.Frame3f.cos_theta(si.wi))
