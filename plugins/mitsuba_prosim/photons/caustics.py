"""Photon maps of a scene for one camera: photons are emitted in passes, stored in a cache, and gathered at surfaces."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..compat import shapes_in_order, warn
from ..sampling import wavelengths
from ..sampling.hash import combine, hash32
from ..sampling.nrook import to_unit
from ..transport import lobes
from ..transport.ray import Vertex
from ..transport.scattering import Scattering
from ..transport.workarounds import repair_boxes
from .emission import Sources, Targets, is_specular, start_points, warn_of_light_missed_by_trees, warn_of_maps
from .grid import MIN_COSINE, Footprint, Photons, gather
from .mis import PhotonMIS
from .tracing import PhotonTracer

#: Maximum number of photon maps in a photon pass.
MAPS = 64

#: Maximum number of photons in the cache for later work items. A photon takes 40 bytes, or 48 on a glossy surface. The
#: cache always holds two photon passes.
CAPACITY = 1 << 22


class Caustics:
    """The photons that the light ``sources`` in ``scene`` emit for the image of ``sensor``, about ``count`` in each
    photon pass.

    A photon pass has several photon maps (:meth:`maps`). The ``t``-th sample of a pixel gathers photons from the map
    ``t % maps`` of the pass ``t // maps``, which :meth:`use_pass` selects before. ``deepest`` and ``tree`` are those of
    :class:`.PhotonTracer`. In spectral variants, the photons of a map have the same wavelengths as the samples that
    gather them: ``key`` is the hash key of both, and every ``n`` samples of a pixel together cover the spectrum.
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
        self.scattering = Scattering(scene)
        #: Arguments of :meth:`use_pass` -> photon pass: its photons on diffuse surfaces, and those on glossy surfaces
        #: if these gather photons. The oldest pass is first.
        self._passes: dict[tuple[int, int, int], tuple[Photons, Photons | None]] = {}
        self._current: tuple[Photons, Photons | None] | None = None
        self.key, self.n = mi.UInt32(0), mi.UInt32(1)

    @classmethod
    def of(cls, scene: mi.Scene, sensor: mi.Sensor, count: int, deepest: int, tree: bool) -> Caustics | None:
        """Returns the caustics of ``scene``; None, with a warning, if no surface is specular or no light source can
        emit photons.
        """
        repair_boxes(scene)
        shapes = [shape for shape in shapes_in_order(scene) if is_specular(shape, tree)]
        sources = Sources(scene, Targets(shapes)) if shapes else None
        if sources is None or not sources.pairs:
            why = "lamp can emit photons" if shapes else "surface is a mirror, glass or glossy"
            warn(f"caustics have no effect: no {why}.")
            return None
        warn_of_maps(scene)
        if tree:
            warn_of_light_missed_by_trees(scene.shapes())
        return cls(scene, sensor, sources, count, deepest, tree)

    @staticmethod
    def maps(n: int) -> int:
        """Returns the number of photon maps of a pass of ``n``² samples: one for each, at most :data:`MAPS`."""
        return min(n * n, MAPS)

    def use_pass(self, seed: int, number: int, n: int) -> None:
        """Selects the photon pass ``number`` of the random ``seed``, whose photons samples then gather; emits and
        traces them unless the cache holds them. A full cache loses its oldest pass. ``n`` is that of :meth:`maps`.
        """
        which = seed, number, n
        self.key, self.n = dr.opaque(mi.UInt32, hash32(seed)), dr.opaque(mi.UInt32, n)
        self.sources.per_pair = dr.opaque(mi.Float, self.per_pair(n))
        if which not in self._passes:
            if len(self._passes) >= max(CAPACITY // self.count, 2):
                del self._passes[next(iter(self._passes))]
            self._passes[which] = self._emit(number, n)
        self._current = self._passes[which]

    def add_to(self, L: mi.Spectrum, vertex: Vertex, t: mi.UInt32) -> mi.Spectrum:
        """Returns the radiance ``L`` plus the radiance that ``vertex`` scatters from the photons for the ``t``-th
        sample of each pixel: diffuse lobes from photons on diffuse surfaces, glossy lobes from photons on glossy ones.
        """
        assert self._current is not None, "no photons have been emitted"
        diffuse, glossy = self._current
        number = t % dr.opaque(mi.UInt32, diffuse.maps)
        L = L + diffuse_radiance(self.scattering, diffuse, number, vertex)
        return L if self.mis is None or glossy is None else L + self.mis.radiance(glossy, number, vertex)

    def per_pair(self, n: int) -> float:
        """Returns how many photons a pair of light source and target has in a map: a whole number, or the mean number
        if it is less than 1.
        """
        in_map = max(self.count // self.maps(n), 1)
        return in_map // self.sources.pairs or in_map / self.sources.pairs

    def _emit(self, number: int, n: int) -> tuple[Photons, Photons | None]:
        """Returns the photons of the pass ``number`` on diffuse surfaces, and those on glossy surfaces, or None."""
        maps, pairs, per_pair = self.maps(n), self.sources.pairs, self.per_pair(n)
        # Photon i belongs to one map and to one pair of a light source and a target.
        in_map = dr.opaque(mi.UInt32, round(pairs * per_pair))
        i = dr.arange(mi.UInt32, maps * round(pairs * per_pair))
        map_of = i // in_map
        key = combine(combine(self.key, dr.opaque(mi.UInt32, number)), 0)
        if per_pair < 1:  # each photon draws one of several pairs
            pair = mi.UInt32((i - map_of * in_map + to_unit(combine(key, i))) * dr.opaque(mi.Float, 1 / per_pair))
            pair, of_pair = dr.minimum(pair, dr.opaque(mi.UInt32, pairs - 1)), i
        else:
            pair_of_map = i // dr.opaque(mi.UInt32, per_pair)
            pair = pair_of_map - map_of * dr.opaque(mi.UInt32, pairs)
            # The points of a pair continue from map to map, so that all of them together are evenly spread too.
            of_pair = map_of * dr.opaque(mi.UInt32, per_pair) + i - pair_of_map * dr.opaque(mi.UInt32, per_pair)
        points = start_points(combine(key, pair), of_pair)
        wavelengths = self._wavelengths(dr.opaque(mi.UInt32, number * maps) + map_of)
        start = self.sources.start(pair, *points, wavelengths)
        diffuse, glossy = self.tracer(start, combine(key, i + 1))
        dr.eval(diffuse, glossy, map_of)
        on_diffuse = Photons(diffuse, map_of, maps, self.footprint)
        return on_diffuse, None if glossy is None else Photons(glossy, map_of, maps, self.footprint)

    def _wavelengths(self, t: mi.UInt32) -> mi.Color0f:
        """Returns the wavelengths in nm for the ``t``-th sample of every pixel; empty except in spectral variants."""
        sample, middle = wavelengths.wavelength_number(self.key, t, self.n), mi.Point2f(0.5)
        time = self.sensor.shutter_open()
        return self.sensor.sample_ray_differential(time, sample, middle, middle, True)[0].wavelengths


def diffuse_radiance(scattering: Scattering, photons: Photons, number: mi.UInt32, vertex: Vertex) -> mi.Spectrum:
    """Returns the radiance that the diffuse lobes at ``vertex``, or all lobes of an inseparable BSDF, reflect from the
    photons of the map ``number``.
    """

    def value(_: mi.UInt32, d: mi.Vector3f, in_reach: mi.Bool) -> mi.Spectrum:
        wo = vertex.si.to_local(d)
        f = scattering.eval(lobes.only(lobes.DIFFUSE), vertex, wo, in_reach)
        return f / dr.maximum(dr.abs(wo.z), MIN_COSINE)

    active = vertex.active & (lobes.has_any(vertex.bsdf.flags(), *lobes.DIFFUSE) | vertex.inseparable)
    return gather(photons, number, vertex.si, value, active)
