"""Photon emission: photons start at the light sources and are aimed at specular surfaces (Jensen 1996).

A photon belongs to a pair of a light source and a target, a sphere around specular surfaces: it starts at a point of
the light source and flies towards a point of the target. If targets are behind each other, several pairs can emit
photons along the same ray. The flux of a photon is the emitted radiance divided by the total density of all these pairs
(the balance heuristic of Veach 1997), so that no light is counted twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import or_

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike

from ..compat import (
    INSTANCE,
    MAPS,
    SPHERE,
    emitter_pointers,
    emitters_in_order,
    eval_direction,
    mesh_positions,
    names_of,
    warn,
    warn_of,
)
from ..light.beam import sample_falloff
from ..light.emitter_methods import EmitterMethods, has_points
from ..masks import fold
from ..optics.nested import all_bsdfs, all_within
from ..sampling import sobol
from ..sampling.hash import combine
from ..transport import lobes
from ..transport.workarounds import is_inseparable

#: Maximum number of spheres. If there are more specular surfaces, neighbours share one sphere.
MAX_TARGETS = 64

#: Ratio of a sphere's radius to the radius of its contents, so that rounding loses nothing.
MARGIN = 1 + 1e-4


class Targets:
    """Bounding spheres around the specular ``shapes``, of which there is at least one; photons are aimed at them."""

    def __init__(self, shapes: Sequence[mi.Shape]) -> None:
        spheres = merged([bounding_sphere(shape) for shape in shapes])
        # The arrays are made of lists: Dr.Jit would share the memory of a NumPy array, and kernels differ by its
        # alignment.
        x, y, z, radii = np.array(spheres, dtype=np.float32).T.tolist()
        #: Number of the spheres, and their centers and radii, with one entry per sphere.
        self.count, self.centers, self.radii = len(spheres), mi.Point3f(x, y, z), mi.Float(radii)
        dr.make_opaque(self.centers, self.radii)

    def at(self, k: mi.UInt32) -> tuple[mi.Point3f, mi.Float]:
        """Returns the center and the radius of the sphere number ``k``."""
        return dr.gather(mi.Point3f, self.centers, k), dr.gather(mi.Float, self.radii, k)

    def density(
        self, x: mi.Point3f, d: mi.Vector3f, far: bool, active: mi.Bool, own: mi.UInt32 | None = None
    ) -> mi.Float:
        """Returns the density of photons along the ray from ``x`` in the direction ``d``, if one photon is aimed at
        each sphere: per solid angle or, if ``far``, per area at right angles to parallel rays.

        ``own`` is the number of the sphere at which the ray was aimed, which it meets despite rounding errors.
        """

        def add(k: mi.UInt32, total: mi.Float) -> mi.Float:
            center, radius = self.at(k)
            to_center, r2 = center - x, dr.square(radius)
            met = dr.squared_norm(dr.cross(to_center, d)) <= r2
            if not far:
                met = (met & (dr.dot(to_center, d) > 0)) | (dr.squared_norm(to_center) <= r2)
            if own is not None:
                met |= k == own
            # The area of the disk, or the solid angle of the sphere, over which one photon is spread.
            size = dr.pi * r2 if far else dr.two_pi * versine(x, center, radius)
            return total + dr.select(met, dr.rcp(size), 0)

        return fold(self.count, add, mi.Float(0), active, unrolled=False)


def is_specular(shape: mi.Shape, tree: bool) -> bool:
    """Tells whether ``shape`` may scatter photons by a specular lobe; on paths, without ``tree``, inseparable BSDFs
    scatter them only by ideal or null lobes.
    """
    if shape.class_name() == INSTANCE:
        return True  # an instance does not expose its BSDFs
    bsdf = shape.bsdf()
    if bsdf is None:
        return False
    names = lobes.IDEAL if is_inseparable(bsdf) and not tree else lobes.SPECULAR
    return bool(lobes.has_any(int(bsdf.flags()), *names))


def warn_of_light_missed_by_trees(shapes: Sequence[mi.Shape]) -> None:
    """Warns if at least two of the ``shapes`` have inseparable BSDFs, and one of these has a glossy transmission."""
    inseparable = [shape for shape in shapes if shape.bsdf() is not None and is_inseparable(shape.bsdf())]
    through = [s for s in inseparable if lobes.has_any(int(s.bsdf().flags()), "GlossyTransmission")]
    if through and len(inseparable) > 1:
        onto, caster = names_of(s for s in inseparable if s is not through[0]), names_of(through[:1])
        warn(
            f"in a ray tree, caustics omit the light that {caster} casts on {onto}: their materials "
            "have inseparable lobes. Paths (diffuse_bounces) find this light. In a ray tree, use prosim_dielectric or "
            "roughdielectric for the glass, or prosim_composite, roughplastic or diffuse for the other materials."
        )


def warn_of_maps(scene: mi.Scene) -> None:
    """Warns of specular BSDFs in a ``bumpmap`` or ``normalmap``, whose normals photons do not know."""
    specular = [bsdf for bsdf in all_bsdfs(scene) if lobes.has_any(int(bsdf.flags()), *lobes.SPECULAR)]
    warn_of(
        (bsdf for bsdf in specular if any(one.class_name() in MAPS for one in all_within(bsdf))),
        "{} may scatter too much or too little light to caustics: about 7 % where the bumpmap or normalmap tilts the "
        "normal by 30 degrees, 16 % at 45 degrees, because photons do not know this normal. Model the bumps as "
        "geometry, or leave caustics out.",
    )


def bounding_sphere(shape: mi.Shape) -> tuple[float, float, float, float]:
    """Returns ``(x, y, z, radius)`` of a sphere around ``shape``, with the factor :data:`MARGIN`."""
    box = shape.bbox()
    center = np.array(box.center(), dtype=np.float64)
    if (vertices := mesh_positions(shape)) is not None:
        radius = float(np.sqrt(np.max(np.sum((vertices - center) ** 2, axis=1))))
    elif shape.class_name() == SPHERE:
        radius = float(box.extents()[0]) / 2
    else:
        radius = float(box.bounding_sphere().radius)
    return (*center.tolist(), MARGIN * radius)


def merged(spheres: ArrayLike, max_count: int = MAX_TARGETS) -> list[tuple[float, ...]]:
    """Returns at most ``max_count`` spheres that together contain all the given ``spheres``, which are split into two
    halves along the axis of their greatest extent, and so on.
    """
    group = np.array(spheres, dtype=np.float64)
    if min(max_count, len(group)) == 1:
        return [sphere_around(group)]
    group = group[np.argsort(group[:, np.argmax(np.ptp(group[:, :3], axis=0))], kind="stable")]
    half, half_count = len(group) // 2, max_count // 2
    return merged(group[:half], half_count) + merged(group[half:], max_count - half_count)


def sphere_around(spheres: np.ndarray) -> tuple[float, ...]:
    """Returns one sphere, (x, y, z, radius), around all ``spheres``, an array of shape (n, 4)."""
    low, high = (spheres[:, :3] - spheres[:, 3:]).min(axis=0), (spheres[:, :3] + spheres[:, 3:]).max(axis=0)
    center = (low + high) / 2 if len(spheres) > 1 else spheres[0, :3]
    radius = float(np.max(np.linalg.norm(spheres[:, :3] - center, axis=1) + spheres[:, 3]))
    return (*center.tolist(), radius)


# ---------------------------------------------------------------- from a point


def versine(x: mi.Point3f, center: mi.Point3f, radius: mi.Float) -> mi.Float:
    """Returns 1 - cos of half the angle of a sphere, seen from ``x``; 2, all directions, from inside."""
    sin2 = dr.square(radius) / dr.maximum(dr.squared_norm(center - x), 1e-30)
    return dr.select(sin2 < 1, sin2 / (1 + dr.safe_sqrt(1 - sin2)), 2)


def direction_to_sphere(x: mi.Point3f, center: mi.Point3f, radius: mi.Float, sample: mi.Point2f) -> mi.Vector3f:
    """Samples a direction from ``x`` to a sphere, uniform over its solid angle; any direction from inside."""
    axis = dr.select(dr.squared_norm(center - x) > 1e-30, dr.normalize(center - x), mi.Vector3f(0, 0, 1))
    return mi.Frame3f(axis).to_world(sample_falloff(sample, versine(x, center, radius)))


#: Density of photons from a point light or in a single direction: far above all other densities, but finite.
DELTA_DENSITY = 1e30


@dataclass
class Start:
    """Photons at the start of their flight: the ray, flux and density of each emitted photon."""

    ray: mi.Ray3f
    #: Power of each photon; 0 in lanes without a photon.
    flux: mi.Spectrum
    #: Number of photons per area at right angles to the ray and per solid angle; :data:`DELTA_DENSITY` for point lights
    #: and light of a single direction.
    density: mi.Float


@dataclass(frozen=True)
class EmissionSample:
    """The targets, random numbers and wavelengths of photons to be emitted; an entry per photon."""

    #: Number of the target at which the photon is aimed.
    target: mi.UInt32
    #: Points in [0, 1)² that sample the light source, and the place on the target.
    on_source: mi.Point2f
    on_target: mi.Point2f
    #: Wavelengths in nm; empty except in spectral variants.
    wavelengths: mi.Color0f

    def receiver(self, p: mi.Point3f) -> mi.SurfaceInteraction3f:
        """Returns the point ``p`` as a receiver of light of the photons' wavelengths."""
        result = dr.zeros(mi.SurfaceInteraction3f)
        result.p, result.wavelengths = p, self.wavelengths
        return result


def photon_emitters(emitters: Sequence[mi.Emitter]) -> list[mi.Emitter]:
    """Returns those ``emitters`` whose photons can be aimed at targets, and warns of all others."""
    others = [emitter for emitter in emitters if not can_be_aimed(emitter)]
    warn_of(
        others,
        "caustics omit the light of the emitters {}, because they emit only along their normals, their flags tell no "
        "place, or Mitsuba cannot sample their shape or texture (curves, ellipsoids, sdfgrid, mesh_attribute). Use "
        "emitters with the flag DeltaPosition or Infinite, or Surface but not DeltaDirection.",
    )
    return [emitter for emitter in emitters if emitter not in others]


def can_be_aimed(emitter: mi.Emitter) -> bool:
    """Tells whether photons of ``emitter`` can be aimed at a target: it is a point, infinitely far away, or a surface
    that emits in many directions (not ``directionalarea``, flag DeltaDirection) and :func:`.has_points`.
    """
    flags, names = emitter.flags(), mi.EmitterFlags
    emits_from_points = mi.has_flag(flags, names.Surface) and not mi.has_flag(flags, names.DeltaDirection)
    if emits_from_points:
        return has_points(emitter)
    return mi.has_flag(flags, names.DeltaPosition) or mi.has_flag(flags, names.Infinite)


class Sources:
    """The emitters of ``scene`` that emit photons. Pair p has emitter p // targets.count, target p % targets.count."""

    def __init__(self, scene: mi.Scene, targets: Targets) -> None:
        self.scene, self.targets = scene, targets
        emitters = photon_emitters(emitters_in_order(scene))
        #: Number of pairs of an emitter and a target; and the union of the ``mi.EmitterFlags`` of the emitters.
        self.pairs, self.flags = len(emitters) * targets.count, reduce(or_, (e.flags() for e in emitters), 0)
        self.pointers = emitter_pointers(scene, emitters) if emitters else None
        self.methods = EmitterMethods(emitters)
        sphere = scene.bbox().bounding_sphere()
        self.middle, self.far_distance = mi.Point3f(sphere.center), mi.Float(2 * max(float(sphere.radius), 1e-3))
        dr.make_opaque(self.pointers, self.middle, self.far_distance)
        #: Number of photons of each pair in one photon map, set by :meth:`.Caustics.use_pass`.
        self.per_pair = mi.Float(0)

    def start(self, pair: mi.UInt32, on_source: mi.Point2f, on_target: mi.Point2f, wavelengths: mi.Color0f) -> Start:
        """Emits one photon for each entry of ``pair``, the number of a pair; the other arguments are those of
        :class:`EmissionSample`. A photon whose flux is not finite gets the flux 0.
        """
        number = pair // self.targets.count
        target = pair - number * self.targets.count
        emitter, names = dr.gather(mi.EmitterPtr, self.pointers, number), mi.EmitterFlags
        sample = EmissionSample(target, on_source, on_target, wavelengths)
        start = Start(dr.zeros(mi.Ray3f), mi.Spectrum(0), mi.Float(0))
        methods = {names.DeltaPosition: self._point, names.Surface: self._surface, names.Infinite: self._far}
        for flag, method in methods.items():
            if mi.has_flag(self.flags, flag):
                active = mi.has_flag(emitter.flags(), flag)
                start = dr.select(active, method(emitter, sample, active), start)
        start.flux = dr.select(dr.all(dr.isfinite(start.flux)), start.flux, 0)
        start.ray.wavelengths = wavelengths
        return start

    def _point(self, emitter: mi.EmitterPtr, sample: EmissionSample, active: mi.Bool) -> Start:
        """Emits photons from point lights."""
        # Mitsuba tells the light that arrives at a surface, so the intensity is computed at the first surface. The
        # power of an ``unattenuated`` source depends on the distance of this surface.
        center, radius = self.targets.at(sample.target)
        x = self.methods.sample_direction(emitter, sample.receiver(center), sample.on_source, active)[0].p
        ray = mi.Ray3f(x, direction_to_sphere(x, center, radius, sample.on_target))
        density = self.per_pair * self.targets.density(x, ray.d, False, active, sample.target)
        hit, lit = self._first_hit(sample, ray, active)
        weight = self.methods.sample_direction(emitter, hit, sample.on_source, lit)[1]
        flux = dr.select(lit, weight * (dr.squared_norm(hit.p - x) / density), 0)
        return Start(ray, flux, mi.Float(DELTA_DENSITY))

    def _surface(self, emitter: mi.EmitterPtr, sample: EmissionSample, active: mi.Bool) -> Start:
        """Emits photons from points on emitting surfaces."""
        center, radius = self.targets.at(sample.target)
        ps = self.methods.sample_position(emitter, sample.on_source, active)
        # A ray starts a little above the surface: far from the origin so much that it must be aimed from there.
        ray = mi.SurfaceInteraction3f(ps, sample.wavelengths).spawn_ray(ps.n)
        x, per_area = ray.o, mi.Float(ps.pdf)
        d = direction_to_sphere(x, center, radius, sample.on_target)
        density = per_area * self.per_pair * self.targets.density(x, d, False, active, sample.target)
        cos = dr.dot(ps.n, d)
        active = active & (cos > 0) & (density > 0)
        ray.d = d
        met, lit = self._first_hit(sample, ray, active)
        ds = mi.DirectionSample3f(ps)
        ds.d, ds.dist, ds.emitter = -d, dr.norm(met.p - x), emitter
        L = eval_direction(emitter, met, ds, lit)
        flux = dr.select(lit, L * (cos / dr.select(lit, density, 1)), 0)
        return Start(ray, flux, density / dr.select(lit, cos, 1))  # per area at right angles to the ray

    def _far(self, emitter: mi.EmitterPtr, sample: EmissionSample, active: mi.Bool) -> Start:
        """Emits photons from distant light sources. They start outside the scene, on lines through random points of a
        disk: the outline of the target, seen from the light source.
        """
        center, radius = self.targets.at(sample.target)
        ds, weight = self.methods.sample_direction(emitter, sample.receiver(center), sample.on_source, active)
        d = -ds.d
        disk = mi.warp.square_to_uniform_disk_concentric(sample.on_target) * radius
        x = center + mi.Frame3f(d).to_world(mi.Vector3f(disk.x, disk.y, 0))
        density = self.per_pair * self.targets.density(x, d, True, active, sample.target)
        back = dr.dot(x - self.middle, d) + self.far_distance
        flux = dr.select(active, weight / density, 0)
        density = dr.select(ds.delta, DELTA_DENSITY, density * ds.pdf)
        return Start(mi.Ray3f(x - d * back, d), flux, density)

    def density(self, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Bool) -> mi.Float:
        """Returns the density of photons (:attr:`Start.density`) that arrive at the point ``it`` from the light source
        point ``ds``; 0 for point lights, for light of a single direction, and where no photon can start.
        """
        d, flags, result = -ds.d, ds.emitter.flags(), mi.Float(0)
        if mi.has_flag(self.flags, mi.EmitterFlags.Surface):
            cos = dr.dot(ds.n, d)
            lit = active & mi.has_flag(flags, mi.EmitterFlags.Surface) & (cos > 0)
            density = self.methods.pdf_position(ds.emitter, ds, lit) * self.targets.density(ds.p, d, False, lit)
            result = dr.select(lit, density / dr.select(lit, cos, 1), result)
        if mi.has_flag(self.flags, mi.EmitterFlags.Infinite):
            lit = active & mi.has_flag(flags, mi.EmitterFlags.Infinite)
            pdf = self.methods.pdf_direction(ds.emitter, it, ds, lit)
            result = dr.select(lit, pdf * self.targets.density(it.p, d, True, lit), result)
        return self.per_pair * result

    def _first_hit(
        self, sample: EmissionSample, ray: mi.Ray3f, active: mi.Bool
    ) -> tuple[mi.SurfaceInteraction3f, mi.Bool]:
        """Returns the first surface point that ``ray`` meets, as a receiver of light, and whether there is one."""
        pi = self.scene.ray_intersect_preliminary(ray, active=active)
        lit = active & pi.is_valid()
        # A ray that meets no surface gets any point; its flux becomes 0.
        return sample.receiver(ray(dr.select(lit, pi.t, 1))), lit


def start_points(key: mi.UInt32, i: mi.UInt32) -> tuple[mi.Point2f, mi.Point2f]:
    """Returns the random points ``on_source`` and ``on_target`` of :class:`EmissionSample` for photon number ``i``, by
    two independent Owen-scrambled Sobol' sequences with the hash ``key``.
    """
    i = sobol.reverse(i)  # :func:`.sobol.point` takes the index with its bits in reverse order
    return sobol.point(combine(key, 0), i), sobol.point(combine(key, 1), i)
