"""Photon maps of a scene for one camera: emitted in passes, cached, and gathered."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..compat import BLEND, DIFFUSE, MASK, TWO_SIDED
from ..optics.nested import all_bsdfs, all_within
from ..sampling import wavelengths
from ..sampling.hash import combine, hash32
from ..transport import lobes
from ..transport.ray import Vertex
from ..transport.scattering import Scattering
from .emission import Sources, start_points
from .grid import MIN_COSINE, Footprint, Photons, gather
from .mis import PhotonMIS
from .targets import Targets, warn_of_light_missed_by_trees
from .tracing import PhotonTracer

#: Greatest number of photon maps in a photon pass.
MAPS = 64

#: Maximum number of photons in the cache for later work items, of 40 bytes each (48 on glossy surfaces, where a photon
#: may land too); at least two photon passes.
CAPACITY = 1 << 22

#: Class names of BSDFs whose diffuse lobe is Lambert's, ours and Mitsuba's, and of those around others that change
#: nothing in it.
LAMBERTIAN = ("Lambertian", "Phong", "Composite", *DIFFUSE)
AROUND = (TWO_SIDED, MASK, BLEND)


class Caustics:
    """Photons of ``sources`` in ``scene`` for the image of ``sensor``: ``count`` in a photon pass.

    A photon pass has several maps (:meth:`maps`), and each sample of a pixel gathers from its own: the ``t``-th from
    map ``t % maps`` of pass ``t // maps``, which must have been emitted (:meth:`draw`). In spectral variants all
    photons of a map have the same wavelengths as its samples (:attr:`key`, :meth:`division`).
    """

    def __init__(
        self, scene: mi.Scene, sensor: mi.Sensor, sources: Sources, count: int, deepest: int, tree: bool
    ) -> None:
        self.scene, self.sensor, self.sources, self.count = scene, sensor, sources, count
        self.footprint = Footprint.of(scene, sensor)
        limit = dr.opaque(mi.UInt32, deepest)
        mis = PhotonMIS(scene, sources, self.footprint, limit, tree)
        #: The MIS of photons and rays at glossy surfaces; None where only diffuse surfaces gather photons.
        self.mis = mis if mis.needed else None
        self.tracer = PhotonTracer(scene, limit, tree, self.mis)
        self.gathering = Gathering(scene)
        #: Photon passes, the oldest first: on diffuse surfaces, and on glossy ones if these gather any. Their keys are
        #: the arguments of :meth:`draw`.
        self._passes: dict[tuple[int, int, int], tuple[Photons, Photons | None]] = {}
        self._current: tuple[Photons, Photons | None] | None = None
        #: The hash key by which all pixels and photons share wavelengths.
        self.key, self._n = mi.UInt32(0), mi.UInt32(1)

    @classmethod
    def of(cls, scene: mi.Scene, sensor: mi.Sensor, count: int, deepest: int, tree: bool) -> Caustics | None:
        """The photons of ``scene``, through up to ``deepest`` specular surfaces; None if nothing is specular or nothing
        emits. ``tree``: see :class:`.PhotonTracer`.
        """
        targets = Targets.of(scene, tree)
        sources = None if targets is None else Sources(scene, targets)
        if sources is None or not sources.count:
            return None
        if tree:
            warn_of_light_missed_by_trees(scene.shapes())
        return cls(scene, sensor, sources, count, deepest, tree)

    @property
    def capacity(self) -> int:
        """Maximum number of photon passes in the cache."""
        return max(CAPACITY // self.count, 2)

    @staticmethod
    def maps(n: int) -> int:
        """Number of maps of a photon pass, for patterns of ``n``² samples."""
        return min(n * n, MAPS)

    def draw(self, seed: int, number: int, n: int) -> None:
        """Lets samples gather from the photon pass ``number`` under ``seed``; ``n`` samples divide the spectrum."""
        which = seed, number, n
        if which not in self._passes:
            if len(self._passes) >= self.capacity:
                del self._passes[next(iter(self._passes))]
            self._passes[which] = self._emit(*which)
        self._current = self._passes[which]
        if self.mis is not None:
            self.mis.per_pair = dr.opaque(mi.Float, self.per_pair(n))
        self.key, self._n = dr.opaque(mi.UInt32, hash32(seed)), dr.opaque(mi.UInt32, n)

    def division(self, t: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32]:
        """The divisor of the spectrum for the ``t``-th samples, see :attr:`.NRook.division`."""
        return t, self._n

    def add_to(self, L: mi.Spectrum, vertex: Vertex, t: mi.UInt32) -> mi.Spectrum:
        """``L`` plus the radiance of the photons at ``vertex``, from the map of the ``t``-th sample of a pixel. After a
        diffuse reflection glossy lobes gather none.
        """
        assert self._current is not None, "no photons have been emitted"
        diffuse, glossy = self._current
        number = t % dr.opaque(mi.UInt32, diffuse.maps)
        L = L + self.gathering(diffuse, number, vertex)
        return L if self.mis is None or glossy is None else L + self.mis.radiance(glossy, number, vertex)

    def per_pair(self, n: int) -> int:
        """Number of photons of each pair of a source and a target in a map."""
        return max(self.count // (self.maps(n) * self.sources.pairs), 1)

    def _emit(self, seed: int, number: int, n: int) -> tuple[Photons, Photons | None]:
        """Emits a photon pass."""
        maps, of_pair = self.maps(n), dr.opaque(mi.UInt32, self.per_pair(n))
        i = dr.arange(mi.UInt32, maps * self.sources.pairs * self.per_pair(n))
        # The points of a pair continue from map to map, so that those of all maps together are evenly spread too.
        k = i // of_pair
        map_of = k // dr.opaque(mi.UInt32, self.sources.pairs)
        pair = k - map_of * dr.opaque(mi.UInt32, self.sources.pairs)
        key = combine(combine(hash32(dr.opaque(mi.UInt32, seed)), dr.opaque(mi.UInt32, number)), 0)
        points = start_points(combine(key, pair), map_of * of_pair + i - k * of_pair)
        wavelengths = self._wavelengths(seed, dr.opaque(mi.UInt32, number * maps) + map_of, n)
        start = self.sources.start(pair, mi.Float(of_pair), *points, wavelengths)
        diffuse, glossy = self.tracer(start, combine(key, i + 1))
        dr.eval(diffuse, glossy, map_of)
        rest = map_of, maps, self.footprint
        return Photons.of(diffuse, *rest), None if glossy is None else Photons.of(glossy, *rest)

    def _wavelengths(self, seed: int, t: mi.UInt32, n: int) -> mi.Color0f:
        """Wavelengths of the ``t``-th samples, as the sensor samples them; empty except in spectral variants."""
        if not mi.is_spectral:
            return dr.zeros(mi.Color0f)
        key, middle = dr.opaque(mi.UInt32, hash32(seed)), mi.Point2f(0.5)
        sample = wavelengths.shared(key, t, dr.opaque(mi.UInt32, n))
        return self.sensor.sample_ray_differential(self.sensor.shutter_open(), sample, middle, middle)[0].wavelengths


class Gathering:
    """Computes the radiance that diffuse lobes in ``scene`` reflect from photons."""

    def __init__(self, scene: mi.Scene) -> None:
        self.scattering = Scattering.of(scene)
        #: Whether all diffuse lobes are Lambert's.
        self.lambertian = not self.scattering.any_inseparable and all(map(is_lambertian, all_bsdfs(scene)))

    def __call__(self, photons: Photons, number: mi.UInt32, vertex: Vertex) -> mi.Spectrum:
        """The radiance that the diffuse lobes at ``vertex`` reflect from the photon map ``number``. Where lobes are
        inseparable, all of them reflect.
        """
        si, bsdf, inseparable = vertex.si, vertex.bsdf, vertex.inseparable
        active = vertex.active & (lobes.has_any(bsdf.flags(), *lobes.DIFFUSE) | inseparable)

        def value(i: mi.UInt32, d: mi.Vector3f, in_reach: mi.Bool) -> mi.Spectrum:
            if self.lambertian:
                return dr.select(dr.dot(si.sh_frame.n, d) * si.wi.z > 0, mi.Float(1), 0)
            wo = si.to_local(d)
            f = bsdf.eval(lobes.diffuse(), si, wo, in_reach)
            return self.scattering.replace_inseparable(f, vertex, wo, in_reach) / dr.maximum(dr.abs(wo.z), MIN_COSINE)

        L = gather(photons, number, si, value, active)
        if self.lambertian:  # constant: evaluated once, after the gathering
            lit = active & (dr.max(L) > 0)
            L *= bsdf.eval(lobes.diffuse(), si, mi.Vector3f(0, 0, dr.sign(si.wi.z)), lit)
        return L


def is_lambertian(bsdf: mi.BSDF) -> bool:
    """Whether all diffuse lobes of ``bsdf`` reflect alike in every direction."""
    return all(
        one.class_name() in AROUND
        or {one.class_name(), type(one).__name__} & set(LAMBERTIAN)
        or not lobes.has_any(int(one.flags()), *lobes.DIFFUSE)
        for one in all_within(bsdf)
    )
