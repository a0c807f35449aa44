"""Photons at their sources, aimed at what is specular (Jensen 1996).

A photon belongs to a pair of a source and a target: it starts at a point of the source and goes to a point of the
target. As one target may be behind another, a ray could have come of several pairs; a photon's flux is the radiance
over the density of all of them together (the balance heuristic of Veach 1997), so that no light is counted twice, and
no photon is brighter than the best of its pairs would make it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..light.balls import Balls, ball
from ..optics.nested import parts
from . import targets as aim
from .targets import Targets

#: How many of the photons of a ball start on the disk that its target sees; the others do anywhere on it.
FACING = 0.9


@dataclass(frozen=True)
class Draw:
    """Which photons start: the numbers of their sources and targets, how many photons each pair has (``shares``, one
    entry a pair), the points in [0, 1)² that they are drawn by, and their wavelengths.
    """

    number: mi.UInt32
    target: mi.UInt32
    shares: mi.Float
    position: mi.Point2f
    aimed: mi.Point2f
    wavelengths: mi.Color0f

    def receiver(self, p: mi.Point3f) -> mi.SurfaceInteraction3f:
        """The point ``p`` as what receives light of its wavelengths."""
        result = dr.zeros(mi.SurfaceInteraction3f)
        result.p, result.wavelengths = p, self.wavelengths
        return result


@dataclass
class Start:
    """Photons as they leave their sources."""

    ray: mi.Ray3f
    #: ``mi.Spectrum``: power that each of them carries, 0 where there is none.
    flux: mi.Spectrum


#: Kinds of sources, by how their photons start: all go out from one point; from a surface to all sides, or along its
#: normals alone; or come from far away.
KINDS = ("point", "surface", "beam", "far")


def kind(emitter: mi.Emitter) -> str | None:
    """One of :data:`KINDS`; None for what says nothing of where it is."""
    flags = emitter.flags()
    if mi.has_flag(flags, mi.EmitterFlags.Infinite) or emitter.class_name() == "DirectionalEmitter":
        return "far"
    if mi.has_flag(flags, mi.EmitterFlags.DeltaPosition):
        return "point"
    if mi.has_flag(flags, mi.EmitterFlags.Surface):
        return "beam" if mi.has_flag(flags, mi.EmitterFlags.DeltaDirection) else "surface"
    return None


def left_out(emitters: Sequence[mi.Emitter]) -> None:
    """Warns of those that are no sources of photons."""
    if names := ", ".join(repr(e.id()) for e in emitters if kind(e) is None):
        mi.Log(
            mi.LogLevel.Warn,
            f"prosim: caustics leave out the light of the emitters {names}, whose flags do not say where they are. "
            "Allowed are those with DeltaPosition, Surface or Infinite among them.",
        )


class Sources:
    """The emitters of ``scene`` that photons can start from, and the pairs of each of them with each of ``targets``:
    pair ``p`` is that of the source ``p // targets.count`` and the target ``p % targets.count``.
    """

    def __init__(self, scene: mi.Scene, targets: Targets) -> None:
        self.scene, self.targets = scene, targets
        all_emitters = list(scene.emitters())
        left_out(all_emitters)
        chosen = [(i, e) for i, e in enumerate(all_emitters) if kind(e) is not None]
        self.emitters = [e for _, e in chosen]
        self.count = len(chosen)
        self.kinds = {kind(e) for e in self.emitters}
        if not chosen:
            return
        self.pointers = dr.gather(mi.EmitterPtr, scene.emitters_dr(), mi.UInt32([i for i, _ in chosen]))
        self.kind = mi.UInt32([KINDS.index(str(kind(e))) for e in self.emitters])
        balls = [ball(e) if kind(e) == "surface" and Balls.takes(e) else None for e in self.emitters]
        self.has_balls = any(balls)
        values = [[*np.ravel(np.array(b[0])), *np.ravel(np.array(b[1]))] if b else [0, 0, 0, 0] for b in balls]
        centers_and_radii = np.array(values, dtype=np.float32).T.copy()
        self.centers, self.radii = mi.Point3f(*centers_and_radii[:3]), mi.Float(centers_and_radii[3])
        sphere = scene.bbox().bounding_sphere()
        self.middle, self.far = mi.Point3f(sphere.center), mi.Float(2 * max(float(sphere.radius), 1e-3))
        dr.make_opaque(self.pointers, self.kind, self.centers, self.radii, self.middle, self.far)

    @property
    def pairs(self) -> int:
        """Number of pairs."""
        return self.count * self.targets.count

    def start(
        self, pair: mi.UInt32, shares: mi.Float, position: mi.Point2f, aimed: mi.Point2f, wavelengths: mi.Color0f
    ) -> Start:
        """Photons of the pairs ``pair``. ``shares``: the number of photons that each pair has, one entry a pair;
        ``position``, ``aimed``: points in [0, 1)²; ``wavelengths``: what the flux is wanted at.
        """
        number = pair // self.targets.count
        target = pair - number * self.targets.count
        emitter = dr.gather(mi.EmitterPtr, self.pointers, number)
        kinds = dr.gather(mi.UInt32, self.kind, number)
        draw = Draw(number, target, shares, position, aimed, wavelengths)
        start = Start(dr.zeros(mi.Ray3f), mi.Spectrum(0))
        for k, (name, method) in enumerate(zip(KINDS, (self._point, self._surface, self._beam, self._far))):
            if name in self.kinds:
                active = kinds == k
                one = method(emitter, draw, active)
                start = Start(dr.select(active, one.ray, start.ray), dr.select(active, one.flux, start.flux))
        start.flux = dr.select(dr.all(dr.isfinite(start.flux)), start.flux, 0)
        start.ray.wavelengths = wavelengths
        return start

    def _point(self, emitter: mi.EmitterPtr, draw: Draw, active: mi.Bool) -> Start:
        center, radius = self.targets.at(draw.target)
        x = emitter.sample_direction(draw.receiver(center), draw.position, active)[0].p
        ray = mi.Ray3f(x, aim.direction(x, center, radius, draw.aimed))
        density = self._density(draw, lambda c, r: (aim.meets(x, ray.d, c, r), dr.rcp(aim.solid_angle(x, c, r))))
        met, lit = self._met(draw, ray, active)
        weight = emitter.sample_direction(met, draw.position, lit)[1]
        return Start(ray, dr.select(lit, weight * (dr.squared_norm(met.p - x) / density), 0))

    def _surface(self, emitter: mi.EmitterPtr, draw: Draw, active: mi.Bool) -> Start:
        center, radius = self.targets.at(draw.target)
        ps, _ = emitter.sample_position(0.0, draw.position, active)
        per_area = mi.Float(ps.pdf)
        is_ball, middle, own_radius = mi.Bool(False), mi.Point3f(0), mi.Float(1)
        if self.has_balls:
            middle, own_radius = (
                dr.gather(mi.Point3f, self.centers, draw.number),
                dr.gather(mi.Float, self.radii, draw.number),
            )
            is_ball = own_radius > 0
            ps = dr.select(is_ball, on_ball(ps, middle, own_radius, center, draw.position), ps)
        x, n = ps.p, ps.n
        d = aim.direction(x, center, radius, draw.aimed)

        def density_of(c: mi.Point3f, r: mi.Float) -> tuple[mi.Bool, mi.Float]:
            area = per_area
            if self.has_balls:
                area = dr.select(is_ball, per_area_of_ball(n, middle, own_radius, c), area)
            return aim.meets(x, d, c, r), area / aim.solid_angle(x, c, r)

        density = self._density(draw, density_of)
        cos = dr.dot(n, d)
        active = active & (cos > 0) & (density > 0)
        ray = mi.SurfaceInteraction3f(ps, draw.wavelengths).spawn_ray(d)
        met, lit = self._met(draw, ray, active)
        ds = mi.DirectionSample3f(ps)
        ds.d, ds.dist, ds.emitter = -d, dr.norm(met.p - x), emitter
        L = emitter.eval_direction(met, ds, lit)
        return Start(ray, dr.select(lit, L * (cos / dr.select(lit, density, 1)), 0))

    def _beam(self, emitter: mi.EmitterPtr, draw: Draw, active: mi.Bool) -> Start:
        """Not aimed: a point of the surface says where the photon goes."""
        ps, _ = emitter.sample_position(0.0, draw.position, active)
        density = self._density(draw, lambda c, r: (mi.Bool(True), mi.Float(ps.pdf)))
        si = mi.SurfaceInteraction3f(ps, draw.wavelengths)
        lit = active & (density > 0)
        L = dr.dispatch(emitter, beam, si, lit)
        return Start(si.spawn_ray(ps.n), dr.select(lit, L / dr.select(lit, density, 1), 0))

    def _far(self, emitter: mi.EmitterPtr, draw: Draw, active: mi.Bool) -> Start:
        center, radius = self.targets.at(draw.target)
        ds, weight = emitter.sample_direction(draw.receiver(center), draw.position, active)
        d = -ds.d
        disk = mi.warp.square_to_uniform_disk_concentric(draw.aimed) * radius
        x = center + mi.Frame3f(d).to_world(mi.Vector3f(disk.x, disk.y, 0))
        density = self._density(draw, lambda c, r: (aim.line_meets(x, d, c, r), dr.rcp(dr.pi * dr.square(r))))
        back = dr.dot(x - self.middle, d) + self.far
        return Start(mi.Ray3f(x - d * back, d), dr.select(active, weight / density, 0))

    def _density(self, draw: Draw, density_of: Callable[[mi.Point3f, mi.Float], tuple[mi.Bool, mi.Float]]) -> mi.Float:
        """Density of a ray among the photons of all pairs of the source of ``draw``. ``density_of``: from center and
        radius of a target, whether the ray meets it, and the density with which one photon of that pair takes it.
        """
        first, count = draw.number * self.targets.count, dr.opaque(mi.UInt32, self.targets.count)

        def step(k: mi.UInt32, total: mi.Float) -> tuple[mi.UInt32, mi.Float]:
            met, density = density_of(*self.targets.at(k))
            share = dr.gather(mi.Float, draw.shares, first + k)
            # A ray meets its own target whatever rounding says.
            return k + 1, total + dr.select(met | (k == draw.target), share * density, 0)

        return dr.while_loop((mi.UInt32(0), mi.Float(0)), lambda k, total: k < count, step, labels=("k", "total"))[1]

    def _met(self, draw: Draw, ray: mi.Ray3f, active: mi.Bool) -> tuple[mi.SurfaceInteraction3f, mi.Bool]:
        """Where ``ray`` ends, as the receiver of its light, and whether it does: of a source of 1992, which looks the
        same at any distance, it matters how far that is.
        """
        pi = self.scene.ray_intersect_preliminary(ray, active=active)
        lit = active & pi.is_valid()
        return draw.receiver(ray(dr.select(lit, pi.t, 1))), lit


def beam(emitter: mi.Emitter, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Spectrum:
    """Power per area that ``emitter`` sends out along its normal at ``si``. It gives no ray at given wavelengths: its
    texture is asked, where it has one.
    """
    radiance = parts(emitter).get("radiance")
    return mi.Spectrum(0) if radiance is None else mi.Spectrum(radiance.eval(si, active))


def on_ball(
    ps: mi.PositionSample3f, middle: mi.Point3f, radius: mi.Float, target: mi.Point3f, sample: mi.Point2f
) -> mi.PositionSample3f:
    """A point on a ball: most on the side that faces the point ``target``, uniform as seen from there."""
    faces = sample.x < FACING
    u = mi.Point2f(dr.select(faces, sample.x / FACING, (sample.x - FACING) / (1 - FACING)), sample.y)
    front = mi.Frame3f(dr.normalize(target - middle)).to_world(mi.warp.square_to_cosine_hemisphere(u))
    n = dr.select(faces, front, mi.warp.square_to_uniform_sphere(u))
    result = mi.PositionSample3f(ps)
    result.p, result.n = middle + n * radius, mi.Normal3f(n)
    return result


def per_area_of_ball(n: mi.Normal3f, middle: mi.Point3f, radius: mi.Float, target: mi.Point3f) -> mi.Float:
    """Density per area with which :func:`on_ball` takes the point with the normal ``n``."""
    facing = dr.maximum(dr.dot(n, dr.normalize(target - middle)), 0)
    return (FACING * 4 * facing + (1 - FACING)) / (4 * dr.pi * dr.square(radius))
