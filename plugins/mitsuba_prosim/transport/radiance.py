"""Radiance along a ray: Whitted's tree with distributed rays (sections 4.1, 4.2), and Kajiya's paths (section 4.2.3)."""

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from . import lobes
from .masks import but_not, idle
from .sources import Sources

#: Spaces of the sampling pattern that belong to the camera; those of the nodes follow.
PIXEL, LENS, TIME_AND_WAVELENGTH, CAMERA_SPACES = 0, 1, 2, 3

#: Spaces of a node, before those of the sources.
REFLECTED, REFRACTED, DIFFUSE, CHOICE, ROULETTE, NODE_SPACES = 0, 1, 2, 3, 4, 5

#: The nodes of a ray tree are numbered as in a heap, in 32 bits.
DEEPEST_TREE = 24

#: As a ray's ``pdf``: what the ray meets does not count as a source, because the sources were sampled in full.
SOURCES_DONE = -1


@dataclass
class Ray:
    """A ray of the tree, with what its node needs. All fields are Dr.Jit arrays of one width."""

    o: object
    d: object
    #: ``mi.Spectrum``: factor from the radiance of this ray to that of the camera ray.
    throughput: object
    #: Number of the node as in a heap: 1 is the camera's, 2 n and 2 n + 1 the reflected and refracted one of n.
    node: object
    #: Number of reflections and refractions before this ray: 0 is the camera's.
    level: object
    #: Density of the lobe that drew ``d``; 0 for the camera and for an ideal mirror or interface; or SOURCES_DONE.
    pdf: object
    #: Normal of the surface that the ray leaves, on the viewer's side.
    n: object
    #: Whether light from both of the sides of that surface was sampled.
    both_sides: object


def mis(pdf, other):
    """Weight of a sample of density ``pdf`` that ``other`` could have given too: power heuristic (Veach 1997)."""
    a, b = dr.square(pdf), dr.square(other)
    return dr.detach(dr.select(a > 0, a / dr.select(a > 0, a + b, 1), 0))


class Transport:
    """Estimates radiance in ``scene`` with the settings of ``integrator`` (its attributes ``max_level``, ``shadows``,
    ``ambient``, ``background``, ``diffuse_bounces``, ``rr_depth``, ``cutoff``, ``hides_emitters``).

    ``attached``: whether derivatives are wanted; directions are then detached and their weights evaluated anew.
    """

    def __init__(self, integrator, scene, attached=False):
        self.integrator, self.scene, self.attached = integrator, scene, attached
        # A symbolic loop cannot be differentiated backwards, unless it is told how far it may go; Dr.Jit 1.5 then
        # generates wrong code for masks. Mitsuba's own integrators unroll theirs for the same reason.
        self.loop_mode = "evaluated" if attached else None
        self.sources = Sources(scene)
        bsdfs = [shape.bsdf() for shape in scene.shapes() if shape.bsdf() is not None]
        flags = scene_flags(scene)
        self.all_ambient = all(dr.all(bsdf.has_attribute("ambient")) for bsdf in bsdfs)
        if integrator.diffuse_bounces >= 0 and any(b.class_name().startswith("Principled") for b in bsdfs):
            mi.Log(mi.LogLevel.Warn, "prosim: the principled BSDF does not tell its lobes apart, so its light is counted "
                                     "more than once; use another material, or diffuse_bounces=-1.")
        self.reflects = lobes.has_any(flags, "GlossyReflection", "DeltaReflection")
        self.refracts = lobes.has_any(flags, "GlossyTransmission", "DeltaTransmission", "Null")
        self.both_sides = lobes.has_any(flags, "GlossyTransmission", "DiffuseTransmission")
        self.everything = mi.BSDFContext()
        # Lobes that rays are drawn from and that can meet a source share it with the sampling of the sources; the
        # others are lit by the latter alone.
        self.partners, self.alone = [], self.everything
        if integrator.diffuse_bounces < 0:
            self.partners, self.alone = [self.everything], None
        elif not self.sources.only_points and lobes.has_any(flags, "GlossyReflection", "GlossyTransmission"):
            self.alone = lobes.diffuse()
            if integrator.diffuse_bounces > 0:
                self.partners = [lobes.specular()]
            else:
                self.partners = [lobes.reflected()] * self.reflects + [lobes.refracted()] * self.refracts

    def __call__(self, ray, points, active, extra=None):
        """Radiance of the camera ray ``ray`` (``mi.Ray3f``): ``(L, hit)``, a ``mi.Spectrum`` and whether the ray met a
        surface.

        ``points(space, active)`` gives a ``mi.Point2f`` in [0, 1)² for a space of the sampling pattern; ``extra`` is
        the state behind it, if it has one (a sampler), that loops have to carry.
        """
        first = Ray(ray.o, ray.d, mi.Spectrum(1), mi.UInt32(1), mi.UInt32(0), mi.Float(0), mi.Normal3f(ray.d),
                    mi.Bool(False))
        follow = self._tree if self.integrator.diffuse_bounces == 0 else self._path
        return follow(first, ray, points, mi.Bool(active), extra)

    # ---------------------------------------------------------------- the two ways through the scene

    def _tree(self, first, camera, points, active, extra):
        """Whitted's tree: both the reflected and the refracted ray are followed, depth first. Refracted rays wait in
        registers, one for each level; a local array would be slower, and is not reliable in Dr.Jit 1.5."""
        max_level = self.integrator.max_level
        waiting = [first] * ((max_level + 1) if self.reflects and self.refracts else 0)

        def step(L, hit, ray, active, count, waiting, extra):
            dL, si, bsdf, surface = self.shade(ray, camera, points, active)
            L += dL
            hit |= (ray.level == 0) & surface
            surface &= ray.level <= max_level
            reflected, go_reflected = ray, mi.Bool(False)
            refracted, go_refracted = ray, mi.Bool(False)
            if self.reflects:
                reflected, go_reflected, _ = self.follow(lobes.reflected(), REFLECTED, ray, si, bsdf, points, surface)
            if self.refracts:
                refracted, go_refracted, _ = self.follow(lobes.refracted(), REFRACTED, ray, si, bsdf, points, surface)
            both = go_reflected & go_refracted
            following = dr.select(go_reflected, reflected, refracted)
            going = go_reflected | go_refracted
            if waiting:
                resume = but_not(active & (count > 0), going)
                waiting_next = []
                for slot, ray_waiting in enumerate(waiting):
                    following = dr.select(resume & (count == slot + 1), ray_waiting, following)
                    waiting_next.append(dr.select(both & (count == slot), refracted, ray_waiting))
                waiting = waiting_next
                count = dr.select(both, count + 1, dr.select(resume, count - 1, count))
                going |= resume
            return L, hit, following, going, count, waiting, extra

        state = (mi.Spectrum(0), mi.Bool(False), first, active, mi.UInt32(0), waiting, extra)
        if not (self.reflects or self.refracts):
            return step(*state)[:2]
        return self._walk(step, state, ("count", "waiting", "extra"), camera, branches=bool(waiting))

    def _path(self, first, camera, points, active, extra):
        """Kajiya's path: at each surface one ray goes on, also from a diffuse component."""
        it = self.integrator
        unlimited = it.diffuse_bounces < 0

        def step(L, hit, ray, active, diffuse, eta, extra):
            dL, si, bsdf, surface = self.shade(ray, camera, points, active)
            L += dL
            hit |= (ray.level == 0) & surface
            if it.max_level >= 0:
                surface &= ray.level <= it.max_level
            if unlimited:
                following, going, passed = self.follow(self.everything, DIFFUSE, ray, si, bsdf, points, surface)
            else:
                following, going, passed = self.follow(lobes.specular(), REFLECTED, ray, si, bsdf, points, surface)
                scattered, scatters, _ = self.follow(lobes.diffuse(), DIFFUSE, ray, si, bsdf, points,
                                                  surface & (diffuse < it.diffuse_bounces))
                # The sources were sampled in full for the diffuse component: what this ray meets is no source.
                scattered.pdf = mi.Float(SOURCES_DONE)
                a = dr.select(going, dr.max(following.throughput), 0)
                b = dr.select(scatters, dr.max(scattered.throughput), 0)
                p = dr.select(a + b > 0, b / dr.select(a + b > 0, a + b, 1), 0)
                choose = points.choice(self.space(ray.node, CHOICE)) < p
                following = dr.select(choose, scattered, following)
                following.throughput *= dr.rcp(dr.detach(dr.select(choose, p, 1 - p)))
                going = dr.select(choose, scatters, going)
                diffuse = dr.select(choose, diffuse + 1, diffuse)
                passed = dr.select(choose, 1, passed)
            following.node = ray.node + 1
            # Radiance within glass is scaled by the square of its index, which is lost again at the way out.
            eta *= passed
            roulette = dr.detach(dr.minimum(dr.max(following.throughput) * dr.square(eta), 0.95))
            dies = following.level >= it.rr_depth
            going &= dr.select(dies, points.choice(self.space(ray.node, ROULETTE)) < roulette, True)
            following.throughput = dr.select(dies, following.throughput / dr.maximum(roulette, 1e-8),
                                             following.throughput)
            return L, hit, following, going, diffuse, eta, extra

        state = (mi.Spectrum(0), mi.Bool(False), first, active, mi.UInt32(0), mi.Float(1), extra)
        return self._walk(step, state, ("diffuse", "eta", "extra"), camera)

    def _walk(self, step, state, labels, camera, branches=False):
        """``(L, hit)`` after ``step`` by ``step`` from node to node.

        Rays below the deepest level can only end in a source. Where no tree ``branches``, they are traced after the
        loop, which spares all other lanes a round.
        """
        max_level = self.integrator.max_level
        ends = max_level >= 0 and not branches
        if ends and max_level == 0:
            state = step(*state)
        else:
            state = dr.while_loop(
                state, lambda L, hit, ray, active, *_: active & (ray.level <= max_level) if ends else active, step,
                labels=("L", "hit", "ray", "active", *labels), mode=self.loop_mode)
        L, hit, ray, active = state[:4]
        if ends and not self.sources.only_points:
            _, si = self.meet(ray, camera, active)
            L += ray.throughput * self.emission(ray, si, active)
        return L, hit

    # ---------------------------------------------------------------- one node

    def space(self, node, k):
        """Number of the ``k``-th space of a node."""
        return CAMERA_SPACES + node * (NODE_SPACES + self.sources.count) + k

    def shade(self, ray, camera, points, active):
        """What one node adds to the radiance: emission, background, ambient and direct light.

        Returns ``(L, si, bsdf, surface)``, ``surface`` being the lanes that met one.
        """
        it = self.integrator
        ray3, si = self.meet(ray, camera, active)
        if it.hides_emitters and not self.sources.only_points:
            si = self.past_emitters(ray3, si, active & (ray.level == 0))
        surface = active & si.is_valid()
        inside = active if it.max_level < 0 else active & (ray.level <= it.max_level)
        L = mi.Spectrum(0)
        if not self.sources.only_points:
            L += self.emission(ray, si, active)
        if it.background is not None:
            escaped = but_not(inside, surface)
            L += dr.select(escaped, it.background_radiance(ray3, si, escaped), 0)
        surface_inside = surface & inside
        if idle(surface_inside):
            return ray.throughput * L, si, None, False
        bsdf = si.bsdf()
        if it.ambient is not None:
            has = surface_inside
            if not self.all_ambient:
                has = has & bsdf.has_attribute("ambient", has)
            L += dr.select(has, bsdf.eval_attribute("ambient", si, has) * it.ambient.eval(si, has), 0)
        L += self.direct(ray, si, bsdf, points, surface_inside)
        return ray.throughput * L, si, bsdf, surface

    def meet(self, ray, camera, active):
        """The ``mi.Ray3f`` of a :class:`Ray`, and its interaction with the scene."""
        ray3 = mi.Ray3f(ray.o, ray.d, camera.time, camera.wavelengths)
        return ray3, self.scene.ray_intersect(ray3, mi.RayFlags.All, ray.level == 0, active=active)

    def past_emitters(self, ray, si, active):
        """The interaction behind all emitters that the camera ray ``ray`` meets first."""
        hidden = active & si.is_valid()
        if idle(hidden):
            return si
        hidden &= si.shape.is_emitter()

        def step(o, blocked):
            pi = self.scene.ray_intersect_preliminary(mi.Ray3f(o, ray.d, ray.time, ray.wavelengths), active=blocked)
            blocked = blocked & pi.is_valid()
            if idle(blocked):
                return o, blocked
            blocked &= pi.shape.is_emitter()
            front = pi.compute_surface_interaction(mi.Ray3f(o, ray.d), mi.RayFlags.Minimal, blocked)
            return dr.select(blocked, front.spawn_ray(ray.d).o, o), blocked

        o, _ = dr.while_loop((mi.Point3f(ray.o), hidden), lambda o, blocked: blocked, step, labels=("o", "blocked"))
        behind = self.scene.ray_intersect(mi.Ray3f(o, ray.d, ray.time, ray.wavelengths), hidden)
        return dr.select(hidden, behind, si)

    def emission(self, ray, si, active):
        """Radiance of a source that ``ray`` meets, shared with the sampling of the sources at the ray's origin."""
        emitter = si.emitter(self.scene)
        active = active & (ray.pdf != SOURCES_DONE)
        if self.integrator.hides_emitters:
            active &= ray.level > 0
        if idle(active) or emitter is None:
            return mi.Spectrum(0)
        L = emitter.eval(si, active)
        shared = active & (ray.pdf > 0)
        if self.sources.sky is not None:
            shared &= si.is_valid()
        origin = dr.zeros(mi.Interaction3f)
        origin.p, origin.n, origin.time, origin.t = ray.o, ray.n, si.time, mi.Float(0)
        ds = mi.DirectionSample3f(self.scene, si, origin)
        pdf = self.sources.pdf(origin, ray.n, ray.both_sides if self.both_sides else False, ds, shared)
        return dr.select(active, L * dr.select(shared, mis(ray.pdf, pdf), 1), 0)

    def direct(self, ray, si, bsdf, points, active):
        """Light from every source through the whole BRDF: one point in each, one shadow ray to it (section 4.1)."""
        flags = bsdf.flags()
        active = active & mi.has_flag(flags, mi.BSDFFlags.Smooth)
        n = self.viewer_side(si)
        both_sides = active & lobes.has_any(flags, "GlossyTransmission", "DiffuseTransmission") \
            if self.both_sides else False
        first_space = self.space(ray.node, NODE_SPACES)

        def light(k, emitter, center, radius, L):
            d, p, pdf, delta, weight = self.sources.sample(emitter, center, radius, si, n, both_sides,
                                                           points(first_space + k, active), active, self.attached)
            lit = active & (pdf > 0)
            wo = si.to_local(d)
            f = bsdf.eval(self.alone, si, wo, lit) if self.alone is not None else mi.Spectrum(0)
            for lobe in self.partners:
                f_lobe, pdf_lobe = bsdf.eval_pdf(lobe, si, wo, lit)
                f += f_lobe * dr.select(delta, 1, mis(pdf, pdf_lobe))
            return L + self.unless_in_shadow(si, p, f * weight, lit)

        L = self.sources.for_each(light, mi.Spectrum(0), active)
        if self.sources.sky is not None and self.alone is not None:
            # The rays that are drawn from the other lobes meet the sky by themselves.
            active = active & lobes.has_any(flags, "DiffuseReflection", "DiffuseTransmission")
            both_sides = active & lobes.has_any(flags, "DiffuseTransmission") if self.both_sides else False
            d, p, pdf, _, weight = self.sources.sample_sky(si, n, both_sides,
                                                           points(first_space + self.sources.lamps, active), active)
            lit = active & (pdf > 0)
            L += self.unless_in_shadow(si, p, bsdf.eval(self.alone, si, si.to_local(d), lit) * weight, lit)
        return L

    def unless_in_shadow(self, si, p, L, active):
        """``L`` where nothing is between ``si`` and the point ``p``, else 0."""
        if self.integrator.shadows:
            active &= dr.max(dr.abs(L)) > 0
            active = but_not(active, self.scene.ray_test(si.spawn_ray_to(p), active))
        return dr.select(active, L, 0)

    def follow(self, lobe, k, ray, si, bsdf, points, active):
        """Draws the ray that goes on from ``si`` through the lobes of the ``mi.BSDFContext`` ``lobe``.

        Returns the ray, the lanes that follow it and the ratio of the indices that it crosses. ``k``: its space in the
        node.
        """
        if idle(active):
            return ray, active, mi.Float(1)
        it = self.integrator
        # Only whole BSDFs choose among lobes often enough for strata to pay.
        space = self.space(ray.node, CHOICE)
        choice = points(space, active).x if lobe is self.everything else points.choice(space)
        sample = points(self.space(ray.node, k), active)
        with dr.suspend_grad(when=self.attached):
            bs, weight = bsdf.sample(lobe, si, choice, sample, active)
            d = si.to_world(bs.wo)
        ideal = lobes.has_any(bs.sampled_type, "Delta", "Null")
        if self.attached:
            f, pdf = bsdf.eval_pdf(lobe, si, si.to_local(d), but_not(active, ideal))
            _, ideal_weight = bsdf.sample(lobe, si, choice, sample, active & ideal)
            weight = dr.select(ideal, ideal_weight, f / dr.detach(dr.select(pdf > 0, pdf, 1)))
        throughput = ray.throughput * weight
        active = active & (bs.pdf > 0) & (dr.max(throughput) > it.cutoff)
        if it.max_level >= 0 and self.sources.only_spheres_met:
            # The rays below the deepest level can only end in a source.
            active &= (ray.level < it.max_level) | self.sources.may_meet(si.p, d)
        following = replace(ray, o=dr.detach(si.spawn_ray(d).o), d=d, throughput=throughput, level=ray.level + 1,
                            node=ray.node * 2 + (k == REFRACTED), pdf=dr.select(ideal, 0, bs.pdf),
                            n=self.viewer_side(si))
        if self.both_sides:
            following.both_sides = lobes.has_any(bsdf.flags(), "GlossyTransmission", "DiffuseTransmission")
        return following, active, bs.eta

    @staticmethod
    def viewer_side(si):
        """Shading normal, turned to the side that the surface is seen from."""
        return si.sh_frame.n * dr.sign(mi.Frame3f.cos_theta(si.wi))


def scene_flags(scene):
    """Union of the ``mi.BSDFFlags`` of all surfaces of ``scene``; all flags where instances hide them."""
    flags = 0
    for shape in scene.shapes():
        bsdf = shape.bsdf()
        flags |= 0xFFFFFFFF if shape.class_name() == "Instance" else 0 if bsdf is None else int(bsdf.m_flags)
    return flags
