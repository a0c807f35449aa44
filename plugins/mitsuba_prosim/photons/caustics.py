"""Photon maps of a scene for one camera: emitted in passes, cached, and gathered."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..masks import but_not
from ..sampling import wavelengths
from ..sampling.hash import combine, hash32
from ..transport.ray import Vertex
from .emission import Sources, start_points
from .footprint import Footprint
from .gathering import Gathering
from .grid import Landed, Photons
from .importance import Importance
from .mis import PhotonMIS
from .targets import Targets, warn_of_missing_caustics
from .tracing import Walk

#: Greatest number of photon maps in a photon pass.
MAPS = 64

#: Pilot photons of a round, number of rounds, and the part of the photons that all cells share evenly.
PILOTS, ROUNDS, EVEN = 1 << 16, 3, 0.1

#: Greatest number of cells along the edge of a pair's unit square of directions, and mean number of photons in each.
EDGE, PER_CELL = 32, 8

#: Maximum number of photons in the cache for later work items, of 40 bytes each (48 on glossy surfaces, where a photon
#: may land too); at least two photon passes.
CAPACITY = 1 << 22

#: Identifies a photon pass: its seed, its number, and the samples that divide the spectrum.
Which = tuple[int, int, int]


@dataclass(frozen=True)
class Allocation:
    """Number of the photons of a map in each cell. The photons of a cell are consecutive."""

    #: Number of photons of each cell, and the index of the first of them.
    counts: mi.Float
    begins: mi.UInt32
    #: The cell of each photon.
    cells: mi.UInt32

    @classmethod
    def of(cls, wanted: np.ndarray) -> Allocation:
        """The allocation of about ``wanted`` photons to each cell, at least one."""
        counts = np.maximum(np.round(wanted.ravel()), 1).astype(np.uint32)
        begins = np.cumsum(counts, dtype=np.uint32) - counts
        cells = np.repeat(np.arange(len(counts), dtype=np.uint32), counts)
        result = cls(mi.Float(counts.tolist()), mi.UInt32(begins.tolist()), mi.UInt32(cells.tolist()))  # see Targets
        dr.make_opaque(result.counts, result.begins, result.cells)
        return result


class Caustics:
    """Photons of ``sources`` in ``scene`` for the image of ``sensor``: ``count`` in a photon pass, traced by ``walk``.

    A photon pass has several maps (:meth:`maps`), and each sample of a pixel gathers from its own: the ``t``-th from
    map ``t % maps`` of pass ``t // maps``, which must have been emitted (:meth:`draw`). In spectral variants all
    photons of a map have the same wavelengths as its samples (:meth:`wavelength`).
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
        self.walk = Walk(scene, limit, tree, self.footprint, self.mis)
        self.gathering = Gathering(scene, self.footprint)
        self._allocations: dict[int, Allocation] = {}
        #: Photon passes, the most recently used one last.
        self._passes: OrderedDict[Which, tuple[Photons, Photons | None]] = OrderedDict()
        self._current: Photons | None = None
        #: Number of photon passes that were emitted.
        self.draws = 0
        self._key, self._n = mi.UInt32(0), mi.UInt32(1)

    @classmethod
    def of(cls, scene: mi.Scene, sensor: mi.Sensor, count: int, deepest: int, tree: bool) -> Caustics | None:
        """The photons of ``scene``, through up to ``deepest`` specular surfaces; None if nothing is specular or nothing
        emits. ``tree``: see :class:`.Walk`.
        """
        targets = Targets.of(scene, tree)
        sources = None if targets is None else Sources(scene, targets)
        if sources is None or not sources.count:
            return None
        if tree:
            warn_of_missing_caustics(scene.shapes())
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
        self._current, glossy = self.photons((seed, number, n))
        if self.mis is not None and glossy is not None:
            self.mis.use(glossy, self._allocation(n).counts)
        self._key, self._n = dr.opaque(mi.UInt32, hash32(seed)), dr.opaque(mi.UInt32, n)

    def photons(self, which: Which) -> tuple[Photons, Photons | None]:
        """A photon pass, from the cache or emitted now: on diffuse surfaces, and on glossy ones if these gather any."""
        if which not in self._passes:
            (diffuse, glossy), map_of, _ = self._emit(*which, self._allocation(which[2]))
            rest = map_of, self.maps(which[2]), self.footprint
            self.put(which, (Photons.of(diffuse, *rest), None if glossy is None else Photons.of(glossy, *rest)))
            self.draws += 1
        self._passes.move_to_end(which)
        return self._passes[which]

    def put(self, which: Which, photons: tuple[Photons, Photons | None]) -> None:
        """Adds a photon pass to the cache; another process may have emitted it."""
        while len(self._passes) >= self.capacity:
            self._passes.popitem(last=False)
        self._passes[which] = photons

    def has(self, which: Which) -> bool:
        """Whether the cache has a photon pass."""
        return which in self._passes

    def wavelength(self, t: mi.UInt32) -> mi.Float:
        """The number in [0, 1) by which a sensor samples the wavelengths of the ``t``-th samples: those of their map,
        the same for all pixels.
        """
        return wavelengths.shared(self._key, *self.division(t))

    def division(self, t: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32]:
        """The divisor of the spectrum for the ``t``-th samples, see :attr:`.NRook.division`."""
        return t, self._n

    def add_to(self, L: mi.Spectrum, vertex: Vertex, drawn: Sequence[mi.BSDFContext], t: mi.UInt32) -> mi.Spectrum:
        """``L`` plus the radiance of the photons at ``vertex``, for the ``t``-th sample of a pixel. ``drawn``: the
        glossy lobes, each with its own ray; after a diffuse reflection they gather none.
        """
        assert self._current is not None, "no photons have been emitted"
        L = L + self.gathering(self._current, t % dr.opaque(mi.UInt32, self._current.maps), vertex)
        if self.mis is None:
            return L
        gathered = vertex.ray.gathered_photons
        active = vertex.active if gathered is None else but_not(vertex.active, gathered)
        return L + self.mis.radiance(vertex, drawn, t, active)

    def _emit(
        self, seed: int, number: int, n: int, allocation: Allocation, white: bool = False
    ) -> tuple[tuple[Landed, Landed | None], mi.UInt32, mi.UInt32]:
        """``(landed, map, cell)`` of all photons of a pass; ``landed`` as :class:`.Walk` returns it. ``white``: whether
        each photon has its own wavelengths instead of its map's.
        """
        maps, size = self.maps(n), dr.width(allocation.cells)
        i = dr.arange(mi.UInt32, size * maps)
        map_of = i // dr.opaque(mi.UInt32, size)
        of_map = i - map_of * dr.opaque(mi.UInt32, size)
        cell = dr.gather(mi.UInt32, allocation.cells, of_map)
        share = mi.UInt32(dr.gather(mi.Float, allocation.counts, cell))
        key = combine(combine(hash32(dr.opaque(mi.UInt32, seed)), dr.opaque(mi.UInt32, number)), 0)
        # The points of a cell continue from map to map, so that those of all maps together are evenly spread too.
        of_cell = map_of * share + of_map - dr.gather(mi.UInt32, allocation.begins, cell)
        t = i if white else dr.opaque(mi.UInt32, number * maps) + map_of
        points = start_points(combine(key, cell), of_cell)
        start = self.sources.start(cell, allocation.counts, *points, self._wavelengths(seed, t, n))
        landed = self.walk(start, combine(key, i + 1))
        dr.eval(landed, map_of, cell)
        return landed, map_of, cell

    def _wavelengths(self, seed: int, t: mi.UInt32, n: int) -> mi.Color0f:
        """Wavelengths of the ``t``-th samples, as the sensor samples them; empty except in spectral variants."""
        if not mi.is_spectral:
            return dr.zeros(mi.Color0f)
        key, middle = dr.opaque(mi.UInt32, hash32(seed)), mi.Point2f(0.5)
        sample = wavelengths.shared(key, t, dr.opaque(mi.UInt32, n))
        return self.sensor.sample_ray_differential(self.sensor.shutter_open(), sample, middle, middle)[0].wavelengths

    def _allocation(self, n: int) -> Allocation:
        """The :class:`Allocation` of a map: in proportion to the RMS contribution of the photons of a cell to a pixel,
        which minimises the noise (Neyman 1934), by some rounds of pilot photons.
        """
        maps, pairs, edge = self.maps(n), self.sources.pairs, 1
        if maps in self._allocations:
            return self._allocations[maps]
        size = max(self.count // maps, 1)
        while edge < EDGE and PER_CELL * pairs * (2 * edge) ** 2 <= size:
            edge *= 2
        importance = Importance(self.scene, self.sensor, self.walk, self.footprint)
        squares = np.zeros((pairs, edge, edge))
        number, fractions = np.zeros_like(squares), np.full_like(squares, 1 / squares.size)
        for k in range(ROUNDS):
            pilots = Allocation.of(fractions * PILOTS)
            landed, _, cell = self._emit(0, k, 1, pilots, white=True)
            count = np.array(pilots.counts, dtype=np.float64)
            sums = np.bincount(np.array(cell), importance(landed), minlength=squares.size)
            squares += (count**2 * sums).reshape(squares.shape)
            number += count.reshape(squares.shape)
            fractions = self._fractions(np.sqrt(squares / number))
        self._allocations[maps] = Allocation.of(fractions * size)
        return self._allocations[maps]

    def _fractions(self, wanted: np.ndarray) -> np.ndarray:
        """Fraction of the photons for each cell, about in proportion to ``wanted``, shape (pairs, edge, edge)."""
        edge = wanted.shape[1]
        padded = np.pad(wanted, ((0, 0), (1, 1), (1, 1)), mode="edge")
        smooth = np.mean([padded[:, j : j + edge, i : i + edge] for j in range(3) for i in range(3)], axis=0)
        aimless = self.sources.aimless
        smooth[aimless] = smooth[aimless].mean(axis=(1, 2), keepdims=True)
        total, even = smooth.sum(), 1 / smooth.size
        return (1 - EVEN) * smooth / total + EVEN * even if total > 0 else np.full_like(smooth, even)
