"""Photon emission: photons start at the sources and are aimed at specular surfaces (Jensen 1996).

A photon belongs to a pair of a source and a target: it starts at a point of the source and goes to a point of the
target. Where one target is behind another, several pairs could have emitted the same ray. The flux of a photon is the
radiance over the density of all these pairs together (the balance heuristic of Veach 1997): no light is counted twice,
and no photon is brighter than the best of its pairs would make it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compat import DIRECTIONAL, emitter_pointers, emitters_in_order, eval_direction
from ..light.spheres import SphereLights, sphere_of
from ..masks import but_not
from ..optics.nested import parts
from ..sampling import sobol
from ..sampling.hash import combine
from . import targets as aim
from .targets import Targets

#: A density far above all others that is still finite.
ENDLESS = 1e30

#: A function of center and radius of a target: whether a ray meets it, the density of the ray among the photons of that
#: pair, and the point of the pair's square that such a photon is aimed by.
DensityOf = Callable[[Any, Any], tuple[Any, Any, Any]]


@dataclass
class Start:
    """Photons as they leave their sources."""

    ray: mi.Ray3f
    #: ``mi.Spectrum``: power of each photon, 0 in lanes without a photon.
    flux: mi.Spectrum
    #: Number of photons per area at right angles to the ray and per solid angle; :data:`ENDLESS` from points and in a
    #: single direction.
    density: mi.Float
    #: Where they start, if that is on a surface ...
    place: mi.PositionSample3f
    #: ... and of which source.
    emitter: mi.EmitterPtr


@dataclass(frozen=True)
class Draw:
    """Photons to emit: the numbers of their sources, targets and cells, the number of photons of each cell
    (``counts``), the points in [0, 1)² that choose the start and the direction, and the wavelengths.
    """

    number: mi.UInt32
    target: mi.UInt32
    cell: mi.UInt32
    counts: mi.Float
    position: mi.Point2f
    aimed: mi.Point2f
    wavelengths: mi.Color0f

    def receiver(self, p: mi.Point3f) -> mi.SurfaceInteraction3f:
        """The point ``p``, which receives light of these wavelengths."""
        result = dr.zeros(mi.SurfaceInteraction3f)
        result.p, result.wavelengths = p, self.wavelengths
        return result


#: Fraction of the photons of a sphere that start on the side that faces their target; the others start anywhere on it.
FACING = 0.9

#: Kinds of sources, by how their photons start: from one point; from a surface to all sides, or along its normals
#: alone; from far away.
KINDS = ("point", "surface", "beam", "far")


def kind(emitter: mi.Emitter) -> str | None:
    """One of :data:`KINDS`; None if the flags of ``emitter`` do not tell where it is."""
    flags = emitter.flags()
    if mi.has_flag(flags, mi.EmitterFlags.Infinite) or emitter.class_name() == DIRECTIONAL:
        return "far"
    if mi.has_flag(flags, mi.EmitterFlags.DeltaPosition):
        return "point"
    if mi.has_flag(flags, mi.EmitterFlags.Surface):
        return "beam" if mi.has_flag(flags, mi.EmitterFlags.DeltaDirection) else "surface"
    return None


def located(emitters: Sequence[mi.Emitter]) -> dict[mi.Emitter, str]:
    """The :func:`kind` of each emitter that has one. Warns of the others."""
    kinds = {emitter: kind(emitter) for emitter in emitters}
    if names := ", ".join(repr(emitter.id()) for emitter, found in kinds.items() if found is None):
        mi.Log(
            mi.LogLevel.Warn,
            f"prosim: caustics leave out the light of the emitters {names}, whose flags do not say where they are. "
            "Allowed are those with DeltaPosition, Surface or Infinite among them.",
        )
    return {emitter: found for emitter, found in kinds.items() if found is not None}


class Sources:
    """The emitters of ``scene`` that photons can start from, and the pairs of each of them with each of ``targets``:
    pair ``p`` is that of the source ``p // targets.count`` and the target ``p % targets.count``.

    The square that a pair's photons are aimed by is divided into ``k`` x ``k`` cells, each with its own number of
    photons. Cell ``c`` belongs to the pair ``c // k²``. ``k`` follows from the number of entries of ``counts``.
    """

    def __init__(self, scene: mi.Scene, targets: Targets) -> None:
        self.scene, self.targets = scene, targets
        kinds = located(emitters_in_order(scene))
        self.emitters, self.count, self.kinds = list(kinds), len(kinds), set(kinds.values())
        #: Number of pairs.
        self.pairs = self.count * targets.count
        #: Whether the photons of each pair are not aimed.
        self.aimless = np.repeat([name == "beam" for name in kinds.values()], targets.count)
        if not self.emitters:
            return
        self.pointers = emitter_pointers(scene, self.emitters)
        self.kind = mi.UInt32([KINDS.index(name) for name in kinds.values()])
        spheres = [sphere_of(e) if name == "surface" and SphereLights.takes(e) else None for e, name in kinds.items()]
        self.has_spheres = any(spheres)
        values = [[*np.ravel(np.array(b[0])), *np.ravel(np.array(b[1]))] if b else [0, 0, 0, 0] for b in spheres]
        x, y, z, radii = np.array(values, dtype=np.float32).T.tolist()  # see Targets
        self.centers, self.radii = mi.Point3f(x, y, z), mi.Float(radii)
        sphere = scene.bbox().bounding_sphere()
        self.middle, self.far = mi.Point3f(sphere.center), mi.Float(2 * max(float(sphere.radius), 1e-3))
        # The number of a source by Dr.Jit's identity of its emitter.
        identities = dr.reinterpret_array(mi.UInt32, scene.emitters_dr())
        self.numbers = dr.full(mi.UInt32, self.count, int(dr.max(identities)[0]) + 1)
        dr.scatter(self.numbers, dr.arange(mi.UInt32, self.count), dr.reinterpret_array(mi.UInt32, self.pointers))
        dr.make_opaque(self.pointers, self.kind, self.centers, self.radii, self.middle, self.far, self.numbers)

    def cells(self, counts: mi.Float) -> mi.UInt32:
        """Number of cells along an edge of the square that each pair is aimed by."""
        return dr.opaque(mi.UInt32, math.isqrt(dr.width(counts) // self.pairs))

    def start(
        self, cell: mi.UInt32, counts: mi.Float, position: mi.Point2f, aimed: mi.Point2f, wavelengths: mi.Color0f
    ) -> Start:
        """Emits photons of the cells ``cell``. ``counts``: the number of photons of each cell;
        ``position``, ``aimed``: points in [0, 1)²; ``wavelengths``: those of the flux.
        """
        edge = self.cells(counts)
        pair = cell // edge**2
        of_pair = cell - pair * edge**2
        row = of_pair // edge
        aimed = (aimed + mi.Point2f(of_pair - row * edge, row)) / mi.Float(edge)
        number = pair // self.targets.count
        target = pair - number * self.targets.count
        emitter, kinds = dr.gather(mi.EmitterPtr, self.pointers, number), dr.gather(mi.UInt32, self.kind, number)
        draw = Draw(number, target, cell, counts, position, aimed, wavelengths)
        start = Start(dr.zeros(mi.Ray3f), mi.Spectrum(0), mi.Float(0), dr.zeros(mi.PositionSample3f), emitter)
        for k, (name, method) in enumerate(zip(KINDS, (self._point, self._surface, self._beam, self._far))):
            if name in self.kinds:
                active = kinds == k
                start = dr.select(active, method(emitter, draw, active), start)
        start.flux = dr.select(dr.all(dr.isfinite(start.flux)), start.flux, 0)
        start.ray.wavelengths = wavelengths
        return start

    def _point(self, emitter: mi.EmitterPtr, draw: Draw, active: mi.Bool) -> Start:
        center, radius = self.targets.at(draw.target)
        x = emitter.sample_direction(draw.receiver(center), draw.position, active)[0].p
        ray = mi.Ray3f(x, aim.direction(x, center, radius, draw.aimed))
        density = self._density(draw.number, draw.counts, _from_point(x, ray.d), active, draw)
        met, lit = self._met(draw, ray, active)
        weight = emitter.sample_direction(met, draw.position, lit)[1]
        flux = dr.select(lit, weight * (dr.squared_norm(met.p - x) / density), 0)
        return Start(ray, flux, mi.Float(ENDLESS), dr.zeros(mi.PositionSample3f), emitter)

    def _surface(self, emitter: mi.EmitterPtr, draw: Draw, active: mi.Bool) -> Start:
        center, radius = self.targets.at(draw.target)
        ps, _ = emitter.sample_position(0.0, draw.position, active)
        per_area = mi.Float(ps.pdf)
        if self.has_spheres:
            middle, own_radius = self._sphere(draw.number)
            towards = aim.direction(middle, center, radius, draw.aimed)
            ps = dr.select(own_radius > 0, on_sphere(ps, middle, own_radius, towards, draw.position), ps)
        x, n = ps.p, ps.n
        d = aim.direction(x, center, radius, draw.aimed)
        density_of = self._from_surface(draw.number, per_area, x, n, d)
        density = self._density(draw.number, draw.counts, density_of, active, draw)
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
        """Not aimed: the point of the surface decides where the photon goes."""
        ps, _ = emitter.sample_position(0.0, draw.position, active)
        pair = mi.Bool(True), mi.Float(ps.pdf), draw.aimed
        density = self._density(draw.number, draw.counts, lambda c, r: pair, active, draw)
        si = mi.SurfaceInteraction3f(ps, draw.wavelengths)
        lit = active & (density > 0)
        L = dr.dispatch(emitter, beam_radiance, si, lit)
        flux = dr.select(lit, L / dr.select(lit, density, 1), 0)
        return Start(si.spawn_ray(ps.n), flux, mi.Float(ENDLESS), ps, emitter)

    def _far(self, emitter: mi.EmitterPtr, draw: Draw, active: mi.Bool) -> Start:
        center, radius = self.targets.at(draw.target)
        ds, weight = emitter.sample_direction(draw.receiver(center), draw.position, active)
        d = -ds.d
        disk = mi.warp.square_to_uniform_disk_concentric(draw.aimed) * radius
        x = center + mi.Frame3f(d).to_world(mi.Vector3f(disk.x, disk.y, 0))
        density = self._density(draw.number, draw.counts, _from_afar(x, d), active, draw)
        back = dr.dot(x - self.middle, d) + self.far
        flux = dr.select(active, weight / density, 0)
        density = dr.select(ds.delta, ENDLESS, density * ds.pdf)
        return Start(mi.Ray3f(x - d * back, d), flux, density, dr.zeros(mi.PositionSample3f), emitter)

    def density(self, it: mi.Interaction3f, ds: mi.DirectionSample3f, counts: mi.Float, active: mi.Bool) -> mi.Float:
        """Density of photons (:attr:`Start.density`) on the ray of light that arrives at ``it`` along ``ds``; 0 where
        none start. ``counts``: as for :meth:`start`.
        """
        number = dr.gather(mi.UInt32, self.numbers, dr.reinterpret_array(mi.UInt32, ds.emitter), active)
        active = active & (number < self.count)
        kinds = dr.gather(mi.UInt32, self.kind, number, active)
        d, result = -ds.d, mi.Float(0)
        if "surface" in self.kinds:
            cos = dr.dot(ds.n, d)
            lit = active & (kinds == KINDS.index("surface")) & (cos > 0)
            # Emission that varies over a surface is sampled by its texture, else by the surface.
            varies = mi.has_flag(ds.emitter.flags(), mi.EmitterFlags.SpatiallyVarying)
            per_area = dr.select(
                varies,
                ds.emitter.pdf_direction(it, ds, lit & varies) * cos / dr.square(ds.dist),
                ds.emitter.get_shape().pdf_position(ds, but_not(lit, varies)),
            )
            density = self._density(number, counts, self._from_surface(number, per_area, ds.p, ds.n, d), lit)
            result = dr.select(lit, density / dr.select(lit, cos, 1), result)
        if "far" in self.kinds:
            lit = active & (kinds == KINDS.index("far"))
            pdf = ds.emitter.pdf_direction(it, ds, lit)
            result = dr.select(lit, self._density(number, counts, _from_afar(it.p, d), lit) * pdf, result)
        return result

    def _density(
        self, number: mi.UInt32, counts: mi.Float, density_of: DensityOf, active: mi.Bool, own: Draw | None = None
    ) -> mi.Float:
        """Density of a ray among the photons of all pairs of the source ``number``. ``own``: the photon of this ray,
        which counts as meeting its target in its cell, also where rounding contradicts.
        """
        first, count = number * self.targets.count, dr.opaque(mi.UInt32, self.targets.count)
        edge = self.cells(counts)

        def step(k: mi.UInt32, total: mi.Float) -> tuple[mi.UInt32, mi.Float]:
            met, density, aimed = density_of(*self.targets.at(k))
            column, row = (dr.minimum(mi.UInt32(dr.maximum(v, 0) * mi.Float(edge)), edge - 1) for v in aimed)
            cell = ((first + k) * edge + row) * edge + column
            if own is not None:
                met |= k == own.target
                cell = dr.select(k == own.target, own.cell, cell)
            in_cell = dr.gather(mi.Float, counts, cell, active)
            return k + 1, total + dr.select(met, in_cell * density, 0) * mi.Float(edge**2)

        return dr.while_loop(
            (mi.UInt32(0), mi.Float(0)), lambda k, total: active & (k < count), step, labels=("k", "total")
        )[1]

    def _from_surface(
        self, number: mi.UInt32, per_area: mi.Float, x: mi.Point3f, n: mi.Normal3f, d: mi.Vector3f
    ) -> DensityOf:
        """For the ray (x, d) from a surface of normal ``n``, whose own method samples ``x`` with this density."""
        middle, own_radius = self._sphere(number) if self.has_spheres else (mi.Point3f(0), mi.Float(0))

        def density_of(c: mi.Point3f, r: mi.Float) -> tuple[mi.Bool, mi.Float, mi.Point2f]:
            area, aimed = per_area, aim.aimed_by(x, d, c, r)
            if self.has_spheres:
                towards = aim.direction(middle, c, r, aimed)
                area = dr.select(own_radius > 0, per_area_of_sphere(n, own_radius, towards), area)
            return aim.meets(x, d, c, r), area / aim.solid_angle(x, c, r), aimed

        return density_of

    def _sphere(self, number: mi.UInt32) -> tuple[mi.Point3f, mi.Float]:
        return dr.gather(mi.Point3f, self.centers, number), dr.gather(mi.Float, self.radii, number)

    def _met(self, draw: Draw, ray: mi.Ray3f, active: mi.Bool) -> tuple[mi.SurfaceInteraction3f, mi.Bool]:
        """The receiver where ``ray`` ends, and whether it ends. The sources of 1992 look the same from any distance:
        their flux depends on it.
        """
        pi = self.scene.ray_intersect_preliminary(ray, active=active)
        lit = active & pi.is_valid()
        return draw.receiver(ray(dr.select(lit, pi.t, 1))), lit


def _from_point(x: mi.Point3f, d: mi.Vector3f) -> DensityOf:
    """For the ray (x, d) from a point."""
    return lambda c, r: (aim.meets(x, d, c, r), dr.rcp(aim.solid_angle(x, c, r)), aim.aimed_by(x, d, c, r))


def _from_afar(x: mi.Point3f, d: mi.Vector3f) -> DensityOf:
    """The :data:`DensityOf` of the ray through ``x`` from far away, without the density of its direction ``d``."""

    def density_of(c: mi.Point3f, r: mi.Float) -> tuple[mi.Bool, mi.Float, mi.Point2f]:
        across = mi.Frame3f(d).to_local(x - c)
        aimed = mi.warp.uniform_disk_to_square_concentric(mi.Point2f(across.x, across.y) / r)
        return aim.line_meets(x, d, c, r), dr.rcp(dr.pi * dr.square(r)), aimed

    return density_of


def beam_radiance(emitter: mi.Emitter, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Spectrum:
    """Power per area that ``emitter`` sends along its normal at ``si``, from its texture: ``directionalarea`` samples
    no ray at given wavelengths. 0 if it has no texture.
    """
    radiance = parts(emitter).get("radiance")
    return mi.Spectrum(0) if radiance is None else mi.Spectrum(radiance.eval(si, active))


def on_sphere(
    ps: mi.PositionSample3f, middle: mi.Point3f, radius: mi.Float, d: mi.Vector3f, sample: mi.Point2f
) -> mi.PositionSample3f:
    """A point on a sphere: most of them on the side that faces the direction ``d``, uniform in the projection along
    ``d``.
    """
    faces = sample.x < FACING
    u = mi.Point2f(dr.select(faces, sample.x / FACING, (sample.x - FACING) / (1 - FACING)), sample.y)
    front = mi.Frame3f(d).to_world(mi.warp.square_to_cosine_hemisphere(u))
    n = dr.select(faces, front, mi.warp.square_to_uniform_sphere(u))
    result = mi.PositionSample3f(ps)
    result.p, result.n = middle + n * radius, mi.Normal3f(n)
    return result


def per_area_of_sphere(n: mi.Normal3f, radius: mi.Float, d: mi.Vector3f) -> mi.Float:
    """Density per area with which :func:`on_sphere` samples the point with the normal ``n``."""
    facing = dr.maximum(dr.dot(n, d), 0)
    return (FACING * 4 * facing + (1 - FACING)) / (4 * dr.pi * dr.square(radius))


def start_points(key: mi.UInt32, i: mi.UInt32) -> tuple[mi.Point2f, mi.Point2f]:
    """Two points in [0, 1)² for the ``i``-th photon under ``key``.

    Both are Owen-scrambled Sobol' points, so that any aligned 2^k photons have one in each of 2^k rectangles of any
    shape.
    """
    i = sobol.reverse(i)
    return sobol.point(combine(key, 0), i), sobol.point(combine(key, 1), i)
