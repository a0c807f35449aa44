"""The light sources of a scene, as the integrator samples them: every source at every point (sections 4.2.2.1, 5.2)."""

import drjit as dr
import mitsuba as mi

from ..sampling.spherical_cap import pdf_projected_cap, sample_projected_cap
from .masks import but_not


class Sources:
    """All emitters of ``scene``, one after the other; a constant sky is apart.

    A sphere is sampled over the projected solid angle of its part above the horizon, so that a diffuse surface that
    sees the whole source has no variance (Ureña and Georgiev 2018; Peters and Dachsbacher 2019). Any other emitter is
    sampled by its own ``sample_direction``.

    A constant sky, which is a sphere around everything, is sampled by projected solid angle too, but for lobes that no
    ray is drawn from: a ray that is drawn finds it at least as well, alone.

    Up to ``UNROLLED`` sources are written out in the kernel; more are visited by a loop, whose kernel does not depend
    on their number.
    """

    UNROLLED = 4

    def __init__(self, scene):
        # The sky comes last, so that the loop can leave it out.
        self.emitters = sorted(scene.emitters(), key=is_sky)
        self.count = len(self.emitters)
        self.sky = self.emitters[-1] if self.emitters and is_sky(self.emitters[-1]) else None
        self.lamps = self.count - (self.sky is not None)
        self.far = 2 * scene.bbox().bounding_sphere().radius
        self.jit = dr.is_jit_v(mi.Float)
        spheres = [sphere(emitter) for emitter in self.emitters]
        self.spheres = spheres
        self.any_sphere = any(s is not None for s in spheres)
        self.any_other = any(s is None for s, e in zip(spheres, self.emitters) if e is not self.sky)
        #: Whether a ray that meets a source meets one of the spheres.
        self.only_spheres_met = all(s is not None or mi.has_flag(e.flags(), mi.EmitterFlags.Delta)
                                    for s, e in zip(spheres, self.emitters))
        self.only_points = all(mi.has_flag(e.flags(), mi.EmitterFlags.Delta) for e in self.emitters)
        if self.jit and self.emitters:
            self._tabulate(scene)

    def _tabulate(self, scene):
        """Tables by the index of the source, and from Dr.Jit's identity of an emitter to that index."""
        in_scene = scene.emitters()
        order = mi.UInt32([in_scene.index(emitter) for emitter in self.emitters])
        self.pointers = dr.gather(mi.EmitterPtr, scene.emitters_dr(), order)
        balls = [s or (mi.Point3f(0), mi.Float(0)) for s in self.spheres]
        self.centers = mi.Point3f(*(dr.concat([mi.Float(c[axis]) for c, _ in balls]) for axis in range(3)))
        self.radii = dr.concat([mi.Float(r) for _, r in balls])
        identity = dr.reinterpret_array(mi.UInt32, self.pointers)
        self.index_of = dr.zeros(mi.UInt32, dr.max(identity)[0] + 1)
        dr.scatter(self.index_of, dr.arange(mi.UInt32, self.count), identity)
        dr.make_opaque(self.centers, self.radii, self.index_of)

    def for_each(self, body, L, active):
        """Folds ``L = body(k, emitter, center, radius, L)`` over the sources but the sky; ``radius`` is None or 0 where
        the source is no sphere."""
        in_loop = self.lamps if self.jit and self.lamps > self.UNROLLED else 0

        def step(k, L):
            center = dr.gather(mi.Point3f, self.centers, k) if self.any_sphere else None
            radius = dr.gather(mi.Float, self.radii, k) if self.any_sphere else None
            return k + 1, body(k, dr.gather(mi.EmitterPtr, self.pointers, k), center, radius, L)

        if in_loop:
            count = dr.opaque(mi.UInt32, in_loop)
            _, L = dr.while_loop((mi.UInt32(0), L), lambda k, L: active & (k < count), step, labels=("k", "L"))
        for k in range(in_loop, self.lamps):
            L = body(k, self.emitters[k], *(self.spheres[k] or (None, None)), L)
        return L

    def sample(self, emitter, center, radius, si, n, both_sides, sample, active, attached=False):
        """A point of a source: ``(d, p, pdf, delta, weight)``: the direction to it, the point, the density per solid
        angle, whether that is a Dirac delta, and radiance over density.

        ``n``: normal on the viewer's side; ``both_sides``: mask of the surfaces that light from below the horizon
        reaches too (rough glass), for which a sphere is sampled by Mitsuba's own method, or False where there is none;
        ``sample``: a point in [0, 1)²; ``attached``: whether the weight shall have derivatives by the sphere's size and
        place.
        """
        if radius is None:
            return self._sample_other(emitter, si, sample, active)
        in_loop = self.jit and self.lamps > self.UNROLLED
        is_ball = active & (radius > 0)
        if both_sides is not False:
            is_ball = but_not(is_ball, both_sides)
        ds = direction_to_ball(si, center, radius, n, sample)
        if attached:  # a drawn direction has no derivative, the area that it was drawn from has
            ds.pdf = self._pdf_of_ball(si, center, radius, n, ds.d)
        ball = self._weigh(emitter, si, ds, is_ball)
        if both_sides is not False or in_loop and self.any_other:
            other = self._sample_other(emitter, si, sample, but_not(active, is_ball))
            return tuple(dr.select(is_ball, a, b) for a, b in zip(ball, other))
        return ball

    def sample_sky(self, si, n, both_sides, sample, active):
        """The same for the sky."""
        local = mi.warp.square_to_cosine_hemisphere(sample)
        ds = direction_sample(si, mi.Frame3f(n).to_world(local))
        ds.dist = mi.Float(self.far)
        ds.p, ds.n, ds.pdf = si.p + ds.d * self.far, -ds.d, mi.warp.square_to_cosine_hemisphere_pdf(local)
        above = self._weigh(self.sky, si, ds, active)
        if both_sides is False:
            return above
        other = self._sample_other(self.sky, si, sample, active & both_sides)
        return tuple(dr.select(both_sides, a, b) for a, b in zip(other, above))

    def _weigh(self, emitter, si, ds, active):
        """What :meth:`sample` returns for the direction ``ds``, drawn with the density ``ds.pdf``."""
        is_visible = active & (ds.pdf > 0)
        ds.emitter = mi.EmitterPtr(emitter) if self.jit else emitter
        weight = emitter.eval_direction(si, ds, is_visible) / dr.select(is_visible, ds.pdf, 1)
        return ds.d, ds.p, dr.select(is_visible, ds.pdf, 0), mi.Bool(False), dr.select(is_visible, weight, 0)

    @staticmethod
    def _sample_other(emitter, si, sample, active):
        ds, weight = emitter.sample_direction(si, sample, active)
        return ds.d, ds.p, ds.pdf, mi.Bool(ds.delta), weight

    def pdf(self, si, n, both_sides, ds, active):
        """Density, per solid angle, with which :meth:`sample` takes the direction ``ds`` at ``si`` towards the emitter
        that it meets there; not for the sky."""
        if not self.any_sphere:
            return ds.emitter.pdf_direction(si, ds, active)
        center, radius = self._ball_of(ds.emitter, active)
        is_ball = active & (radius > 0)
        if both_sides is not False:
            is_ball = but_not(is_ball, both_sides)
        pdf = dr.select(is_ball, self._pdf_of_ball(si, center, radius, n, ds.d), 0)
        if self.any_other or both_sides is not False:
            pdf = dr.select(is_ball, pdf, ds.emitter.pdf_direction(si, ds, but_not(active, is_ball)))
        return pdf

    @staticmethod
    def _pdf_of_ball(si, center, radius, n, d):
        to_center = center - si.p
        inv_d2 = dr.rcp(dr.squared_norm(to_center))
        cos_n = dr.dot(n, to_center) * dr.sqrt(inv_d2)
        return pdf_projected_cap(cos_n, dr.square(radius) * inv_d2, dr.dot(n, d))

    def may_meet(self, o, d):
        """Whether the ray (o, d) meets one of the spheres, as far as nothing is in the way; only for scenes whose
        other sources are points."""
        def one(k, emitter, center, radius, meets):
            if radius is None:
                return meets
            to_center = center - o
            b = dr.dot(to_center, d)
            # With a margin for the rounding of the renderer's own test.
            near = dr.squared_norm(to_center - b * d) <= dr.square(radius * 1.001)
            return meets | near & (b > 0)

        return self.for_each(one, mi.Bool(False), mi.Bool(True))

    def _ball_of(self, emitter, active):
        """Center and radius of the source ``emitter`` (a pointer); radius 0 where it is no sphere."""
        if not self.jit:
            ball = self.spheres[self.emitters.index(emitter)] if active else None
            return ball or (mi.Point3f(0), mi.Float(0))
        index = dr.gather(mi.UInt32, self.index_of, dr.reinterpret_array(mi.UInt32, emitter), active)
        return dr.gather(mi.Point3f, self.centers, index, active), dr.gather(mi.Float, self.radii, index, active)


def direction_to_ball(si, center, radius, n, sample):
    """``mi.DirectionSample3f`` from ``si`` to a sphere, by projected solid angle above the horizon of ``n``."""
    to_center = center - si.p
    d2 = dr.squared_norm(to_center)
    axis = to_center * dr.rsqrt(d2)
    cos_n = dr.dot(n, axis)
    x = dr.normalize(axis - n * cos_n + 1e-20 * mi.coordinate_system(n)[0])
    local, pdf = sample_projected_cap(cos_n, dr.square(radius) / d2, sample)
    d = x * local.x + dr.cross(n, x) * local.y + n * local.z
    # Nearer root of |t d - to_center| = radius, without cancellation for a distant source.
    b = dr.dot(d, to_center)
    chord = dr.safe_sqrt(dr.square(radius) - dr.squared_norm(to_center - b * d))
    ds = direction_sample(si, d)
    ds.dist = b - chord
    ds.p = si.p + d * ds.dist
    ds.n = dr.normalize(ds.p - center)
    ds.pdf = pdf
    return ds


def direction_sample(si, d):
    """A ``mi.DirectionSample3f`` in the direction ``d``, else empty."""
    ds = dr.zeros(mi.DirectionSample3f) if dr.is_jit_v(mi.Float) else mi.DirectionSample3f()
    ds.d, ds.time = d, si.time
    return ds


def is_sky(emitter):
    """Whether an emitter is Mitsuba's ``constant``."""
    return emitter.class_name() == "ConstantBackgroundEmitter"


def sphere(emitter):
    """``(center, radius)`` of the sphere that emits, or None for an emitter of another kind."""
    shape = emitter.get_shape()
    if shape is None or shape.class_name() != "Sphere" or shape.has_flipped_normals():
        return None
    if mi.has_flag(emitter.flags(), mi.EmitterFlags.SpatiallyVarying):  # would need the texture coordinates
        return None
    to_world = mi.traverse(shape)["to_world"]
    center = to_world @ mi.Point3f(0)
    return center, dr.norm(to_world @ mi.Vector3f(1, 0, 0))
