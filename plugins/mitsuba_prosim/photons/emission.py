"""Photons at their sources, aimed at what is specular (Jensen 1996).

A photon belongs to a pair of a source and a target: it starts at a point of the source and goes to a point of the
target. As one target may be behind another, a ray could have come of several pairs; a photon's flux is the radiance
over the density of all of them together (the balance heuristic of Veach 1997), so that no light is counted twice, and
no photon is brighter than the best of its pairs would make it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compat import emitter_pointers, emitters_in_order, eval_direction
from ..light.spheres import SphereLights, sphere_of
from ..masks import but_not
from ..optics.nested import parts
from ..sampling import sobol
from ..sampling.hash import combine
from . import targets as aim
from .targets import Targets

#: A density that no other comes near, and that can still be reckoned with.
ENDLESS = 1e30

#: From center and radius of a target: whether a ray meets it, with which density a photon of that pair takes it, and by
#: which point of the square that it is aimed by.
DensityOf = Callable[[Any, Any], tuple[Any, Any, Any]]


@dataclass(frozen=True)
class Draw:
    """Which photons start: the numbers of their sources, targets and cells, how many photons each cell has
    (``shares``), the points in [0, 1)² that they are drawn by, and their wavelengths.
    """

    number: mi.UInt32
    target: mi.UInt32
    cell: mi.UInt32
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
    #: How close together they are: number per area at right angles to the ray and per solid angle; :data:`ENDLESS` from
    #: points and in a single direction.
    density: mi.Float
    #: Where they start, if that is on a surface ...
    place: mi.PositionSample3f
    #: ... and of what.
    emitter: mi.EmitterPtr


#: How many of the photons of a ball start on the side that faces their way; the others start anywhere on it.
FACING = 0.9

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

    The square that a pair's photons are aimed by is divided into ``k`` x ``k`` cells, each with its own number of
    photons. Cell ``c`` belongs to the pair ``c // k²``. ``k`` follows from the number of entries of ``shares``.
    """

    def __init__(self, scene: mi.Scene, targets: Targets) -> None:
        self.scene, self.targets = scene, targets
        all_emitters = emitters_in_order(scene)
        left_out(all_emitters)
        self.emitters = [e for e in all_emitters if kind(e) is not None]
        self.count = len(self.emitters)
        self.kinds = {kind(e) for e in self.emitters}
        if not self.emitters:
            return
        self.pointers = emitter_pointers(scene, self.emitters)
        self.kind = mi.UInt32([KINDS.index(str(kind(e))) for e in self.emitters])
        balls = [sphere_of(e) if kind(e) == "surface" and SphereLights.takes(e) else None for e in self.emitters]
        self.has_balls = any(balls)
        values = [[*np.ravel(np.array(b[0])), *np.ravel(np.array(b[1]))] if b else [0, 0, 0, 0] for b in balls]
        x, y, z, radii = np.array(values, dtype=np.float32).T.tolist()  # see Targets
        self.centers, self.radii = mi.Point3f(x, y, z), mi.Float(radii)
        sphere = scene.bbox().bounding_sphere()
        self.middle, self.far = mi.Point3f(sphere.center), mi.Float(2 * max(float(sphere.radius), 1e-3))
        # The way back from Dr.Jit's identity of an emitter.
        everyone = dr.reinterpret_array(mi.UInt32, scene.emitters_dr())
        self.numbers = dr.full(mi.UInt32, self.count, int(dr.max(everyone)[0]) + 1)
        dr.scatter(self.numbers, dr.arange(mi.UInt32, self.count), dr.reinterpret_array(mi.UInt32, self.pointers))
        dr.make_opaque(self.pointers, self.kind, self.centers, self.radii, self.middle, self.far, self.numbers)

    @property
    def pairs(self) -> int:
        """Number of pairs."""
        return self.count * self.targets.count

    @property
    def aimless(self) -> np.ndarray:
        """Whether the photons of each pair are not aimed."""
        return np.repeat([kind(e) == "beam" for e in self.emitters], self.targets.count)

    def cells(self, shares: mi.Float) -> mi.UInt32:
        """Number of cells along an edge of the square that each pair is aimed by."""
        return dr.opaque(mi.UInt32, math.isqrt(dr.width(shares) // self.pairs))

    def start(
        self, cell: mi.UInt32, shares: mi.Float, position: mi.Point2f, aimed: mi.Point2f, wavelengths: mi.Color0f
    ) -> Start:
        """Photons of the cells ``cell``. ``shares``: the number of photons of each cell;
        ``position``, ``aimed``: points in [0, 1)²; ``wavelengths``: what the flux is wanted at.
        """
        edge = self.cells(shares)
        pair = cell // edge**2
        of_pair = cell - pair * edge**2
        row = of_pair // edge
        aimed = (aimed + mi.Point2f(of_pair - row * edge, row)) / mi.Float(edge)
        number = pair // self.targets.count
        target = pair - number * self.targets.count
        emitter = dr.gather(mi.EmitterPtr, self.pointers, number)
        kinds = dr.gather(mi.UInt32, self.kind, number)
        draw = Draw(number, target, cell, shares, position, aimed, wavelengths)
        start = Start(dr.zeros(mi.Ray3f), mi.Spectrum(0), mi.Float(0), dr.zeros(mi.PositionSample3f), emitter)
        for k, (name, method) in enumerate(zip(KINDS, (self._point, self._surface, self._beam, self._far))):
            if name in self.kinds:
                active = kinds == k
                one = method(emitter, draw, active)
                start = dr.select(active, one, start)
        start.flux = dr.select(dr.all(dr.isfinite(start.flux)), start.flux, 0)
        start.ray.wavelengths = wavelengths
        return start

    def _point(self, emitter: mi.EmitterPtr, draw: Draw, active: mi.Bool) -> Start:
        center, radius = self.targets.at(draw.target)
        x = emitter.sample_direction(draw.receiver(center), draw.position, active)[0].p
        ray = mi.Ray3f(x, aim.direction(x, center, radius, draw.aimed))
        density = self._density(draw.number, draw.shares, self._of_point(x, ray.d), draw)
        met, lit = self._met(draw, ray, active)
        weight = emitter.sample_direction(met, draw.position, lit)[1]
        flux = dr.select(lit, weight * (dr.squared_norm(met.p - x) / density), 0)
        return Start(ray, flux, mi.Float(ENDLESS), dr.zeros(mi.PositionSample3f), emitter)

    def _surface(self, emitter: mi.EmitterPtr, draw: Draw, active: mi.Bool) -> Start:
        center, radius = self.targets.at(draw.target)
        ps, _ = emitter.sample_position(0.0, draw.position, active)
        per_area = mi.Float(ps.pdf)
        if self.has_balls:
            middle, own_radius = self._ball(draw.number)
            towards = aim.direction(middle, center, radius, draw.aimed)
            ps = dr.select(own_radius > 0, on_ball(ps, middle, own_radius, towards, draw.position), ps)
        x, n = ps.p, ps.n
        d = aim.direction(x, center, radius, draw.aimed)
        density = self._density(draw.number, draw.shares, self._of_surface(draw.number, per_area, x, n, d), draw)
        cos = dr.dot(n, d)
        active = active & (cos > 0) & (density > 0)
        ray = mi.SurfaceInteraction3f(ps, draw.wavelengths).spawn_ray(d)
        met, lit = self._met(draw, ray, active)
        ds = mi.DirectionSample3f(ps)
        ds.d, ds.dist, ds.emitter = -d, dr.norm(met.p - x), emitter
        L = eval_direction(emitter, met, ds, lit)
        flux = dr.select(lit, L * (cos / dr.select(lit, density, 1)), 0)
        return Start(ray, flux, density / dr.select(lit, cos, 1), ps, emitter)

    def _beam(self, emitter: mi.EmitterPtr, draw: Draw, active: mi.Bool) -> Start:
        """Not aimed: a point of the surface says where the photon goes."""
        ps, _ = emitter.sample_position(0.0, draw.position, active)
        density = self._density(
            draw.number, draw.shares, lambda c, r: (mi.Bool(True), mi.Float(ps.pdf), draw.aimed), draw
        )
        si = mi.SurfaceInteraction3f(ps, draw.wavelengths)
        lit = active & (density > 0)
        L = dr.dispatch(emitter, beam, si, lit)
        flux = dr.select(lit, L / dr.select(lit, density, 1), 0)
        return Start(si.spawn_ray(ps.n), flux, mi.Float(ENDLESS), ps, emitter)

    def _far(self, emitter: mi.EmitterPtr, draw: Draw, active: mi.Bool) -> Start:
        center, radius = self.targets.at(draw.target)
        ds, weight = emitter.sample_direction(draw.receiver(center), draw.position, active)
        d = -ds.d
        disk = mi.warp.square_to_uniform_disk_concentric(draw.aimed) * radius
        x = center + mi.Frame3f(d).to_world(mi.Vector3f(disk.x, disk.y, 0))
        density = self._density(draw.number, draw.shares, self._from_afar(x, d), draw)
        back = dr.dot(x - self.middle, d) + self.far
        flux = dr.select(active, weight / density, 0)
        density = dr.select(ds.delta, ENDLESS, density * ds.pdf)
        return Start(mi.Ray3f(x - d * back, d), flux, density, dr.zeros(mi.PositionSample3f), emitter)

    def density(self, it: mi.Interaction3f, ds: mi.DirectionSample3f, shares: mi.Float, active: mi.Bool) -> mi.Float:
        """How close together (:attr:`Start.density`) photons are on the ray of light that comes to ``it`` along ``ds``;
        0 where none start. ``shares``: as for :meth:`start`.
        """
        number = dr.gather(mi.UInt32, self.numbers, dr.reinterpret_array(mi.UInt32, ds.emitter), active)
        active = active & (number < self.count)
        kinds = dr.gather(mi.UInt32, self.kind, number, active)
        d, result = -ds.d, mi.Float(0)
        if "surface" in self.kinds:
            cos = dr.dot(ds.n, d)
            lit = active & (kinds == KINDS.index("surface")) & (cos > 0)
            # What varies over a surface is sampled by that, else by the surface itself.
            varies = mi.has_flag(ds.emitter.flags(), mi.EmitterFlags.SpatiallyVarying)
            per_area = dr.select(
                varies,
                ds.emitter.pdf_direction(it, ds, lit & varies) * cos / dr.square(ds.dist),
                ds.emitter.get_shape().pdf_position(ds, but_not(lit, varies)),
            )
            density = self._density(number, shares, self._of_surface(number, per_area, ds.p, ds.n, d), active=lit)
            result = dr.select(lit, density / dr.select(lit, cos, 1), result)
        if "far" in self.kinds:
            lit = active & (kinds == KINDS.index("far"))
            pdf = ds.emitter.pdf_direction(it, ds, lit)
            density = self._density(number, shares, self._from_afar(it.p, d), active=lit)
            result = dr.select(lit, density * pdf, result)
        return result

    def _ball(self, number: mi.UInt32) -> tuple[mi.Point3f, mi.Float]:
        return dr.gather(mi.Point3f, self.centers, number), dr.gather(mi.Float, self.radii, number)

    def _of_point(self, x: mi.Point3f, d: mi.Vector3f) -> DensityOf:
        """The :data:`DensityOf` of the ray (x, d) from a point."""
        return lambda c, r: (aim.meets(x, d, c, r), dr.rcp(aim.solid_angle(x, c, r)), aim.aimed_by(x, d, c, r))

    def _of_surface(
        self, number: mi.UInt32, per_area: mi.Float, x: mi.Point3f, n: mi.Normal3f, d: mi.Vector3f
    ) -> DensityOf:
        """That of a ray from a surface, whose own method takes the point ``x`` with the density ``per_area``."""
        middle, own_radius = self._ball(number) if self.has_balls else (mi.Point3f(0), mi.Float(0))

        def density_of(c: mi.Point3f, r: mi.Float) -> tuple[mi.Bool, mi.Float, mi.Point2f]:
            area, aimed = per_area, aim.aimed_by(x, d, c, r)
            if self.has_balls:
                towards = aim.direction(middle, c, r, aimed)
                area = dr.select(own_radius > 0, per_area_of_ball(n, own_radius, towards), area)
            return aim.meets(x, d, c, r), area / aim.solid_angle(x, c, r), aimed

        return density_of

    def _from_afar(self, x: mi.Point3f, d: mi.Vector3f) -> DensityOf:
        """That of a ray from without through ``x``, apart from its direction."""

        def density_of(c: mi.Point3f, r: mi.Float) -> tuple[mi.Bool, mi.Float, mi.Point2f]:
            across = mi.Frame3f(d).to_local(x - c)
            aimed = mi.warp.uniform_disk_to_square_concentric(mi.Point2f(across.x, across.y) / r)
            return aim.line_meets(x, d, c, r), dr.rcp(dr.pi * dr.square(r)), aimed

        return density_of

    def _density(
        self,
        number: mi.UInt32,
        shares: mi.Float,
        density_of: DensityOf,
        own: Draw | None = None,
        active: mi.Bool | bool = True,
    ) -> mi.Float:
        """Density of a ray among the photons of all pairs of the source ``number``. ``own``: how the ray was drawn; it
        meets its target and lies in its cell, whatever rounding says.
        """
        first, count = number * self.targets.count, dr.opaque(mi.UInt32, self.targets.count)
        edge = self.cells(shares)

        def step(k: mi.UInt32, total: mi.Float) -> tuple[mi.UInt32, mi.Float]:
            met, density, aimed = density_of(*self.targets.at(k))
            column, row = (dr.minimum(mi.UInt32(dr.maximum(v, 0) * mi.Float(edge)), edge - 1) for v in aimed)
            cell = ((first + k) * edge + row) * edge + column
            if own is not None:
                met |= k == own.target
                cell = dr.select(k == own.target, own.cell, cell)
            share = dr.gather(mi.Float, shares, cell, active)
            return k + 1, total + dr.select(met, share * density, 0) * mi.Float(edge**2)

        return dr.while_loop(
            (mi.UInt32(0), mi.Float(0)), lambda k, total: active & (k < count), step, labels=("k", "total")
        )[1]

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
    ps: mi.PositionSample3f, middle: mi.Point3f, radius: mi.Float, d: mi.Vector3f, sample: mi.Point2f
) -> mi.PositionSample3f:
    """A point on a ball: most on the side that faces the direction ``d``, uniform as seen from there."""
    faces = sample.x < FACING
    u = mi.Point2f(dr.select(faces, sample.x / FACING, (sample.x - FACING) / (1 - FACING)), sample.y)
    front = mi.Frame3f(d).to_world(mi.warp.square_to_cosine_hemisphere(u))
    n = dr.select(faces, front, mi.warp.square_to_uniform_sphere(u))
    result = mi.PositionSample3f(ps)
    result.p, result.n = middle + n * radius, mi.Normal3f(n)
    return result


def per_area_of_ball(n: mi.Normal3f, radius: mi.Float, d: mi.Vector3f) -> mi.Float:
    """Density per area with which :func:`on_ball` takes the point with the normal ``n``."""
    facing = dr.maximum(dr.dot(n, d), 0)
    return (FACING * 4 * facing + (1 - FACING)) / (4 * dr.pi * dr.square(radius))


def start_points(key: mi.UInt32, i: mi.UInt32) -> tuple[mi.Point2f, mi.Point2f]:
    """Two points in [0, 1)² for the ``i``-th photon under ``key``.

    Both are Owen-scrambled Sobol' points, so that any aligned 2^k photons have one in each of 2^k rectangles of any
    shape.
    """
    i = sobol.reverse(i)
    return sobol.point(combine(key, 0), i), sobol.point(combine(key, 1), i)
