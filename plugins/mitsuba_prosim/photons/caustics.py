"""Photon maps of a scene for one camera: emitted in passes, kept, and gathered from."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from ..masks import but_not
from ..sampling import wavelengths
from ..sampling.hash import combine, hash32
from ..transport.ray import Ray
from .emission import Sources, start_points
from .footprint import Footprint
from .gathering import Gathering
from .grid import Landed, Photons
from .importance import Importance
from .mis import GlossyGathering
from .targets import Targets, warn_of_missing_caustics
from .tracing import Walk

#: Greatest number of photon maps in a photon pass.
MAPS = 64

#: Pilot photons of a round, number of rounds, and the part of the photons that all cells share evenly.
PILOTS, ROUNDS, EVEN = 1 << 16, 3, 0.1

#: Greatest number of cells along the edge of a pair's unit square of directions, and mean number of photons in each.
EDGE, PER_CELL = 32, 8

#: Number of photons that are kept for later work items, of 40 bytes each (48 on glossy surfaces, where a photon may
#: land too); at least two photon passes.
KEPT = 1 << 22

#: Identifies a photon pass: its seed, its number, and the samples that divide the spectrum.
Which = tuple[int, int, int]


class Caustics:
    """Photons of ``sources`` in ``scene`` for what ``sensor`` sees: ``count`` in a photon pass, traced by ``walk``.

    A photon pass has several maps (:meth:`maps`), and each sample of a pixel gathers from its own: the ``t``-th from
    map ``t % maps`` of pass ``t // maps``, which must have been emitted (:meth:`draw`). In spectral variants all
    photons of a map have the same wavelengths as its samples (:meth:`wavelength`).
    """

    def __init__(
        self, scene: mi.Scene, sensor: mi.Sensor, sources: Sources, count: int, walk: Walk, footprint: Footprint
    ) -> None:
        self.scene, self.sensor, self.sources, self.count = scene, sensor, sources, count
        self.walk, self.footprint = walk, footprint
        self.gathering = Gathering(scene, self.footprint)
        #: What shares light between photons and rays at glossy surfaces; None where nothing is to be shared.
        self.mis: GlossyGathering | None = None
        if walk.shares_light:
            self.mis = GlossyGathering(footprint, sources, walk.near_specular, walk.deepest, walk.scattering)
        self._shares: dict[int, tuple[mi.Float, mi.UInt32, mi.UInt32]] = {}
        #: Photon passes, the most recently used one last.
        self._sets: OrderedDict[Which, tuple[Photons, Photons | None]] = OrderedDict()
        self._drawn: Photons | None = None
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
        footprint = Footprint.of(scene, sensor)
        return cls(scene, sensor, sources, count, Walk(scene, deepest, tree, footprint), footprint)

    @property
    def kept(self) -> int:
        """Number of photon passes that are kept."""
        return max(KEPT // self.count, 2)

    @staticmethod
    def maps(n: int) -> int:
        """Number of maps of a photon pass, for patterns of ``n``² samples."""
        return min(n * n, MAPS)

    def draw(self, seed: int, number: int, n: int) -> None:
        """Lets samples gather from the photon pass ``number`` under ``seed``; ``n`` samples divide the spectrum."""
        self._drawn, glossy = self.photons((seed, number, n))
        if self.mis is not None and glossy is not None:
            self.mis.use(glossy, self._places(self.maps(n))[0])
        self._key, self._n = dr.opaque(mi.UInt32, hash32(seed)), dr.opaque(mi.UInt32, n)

    def photons(self, which: Which) -> tuple[Photons, Photons | None]:
        """A photon pass, kept or emitted now: on diffuse surfaces, and on glossy ones if these gather any."""
        if which not in self._sets:
            self.put(which, self._photons(*which))
            self.draws += 1
        self._sets.move_to_end(which)
        return self._sets[which]

    def put(self, which: Which, photons: tuple[Photons, Photons | None]) -> None:
        """Keeps a photon pass, which another process may have emitted."""
        while len(self._sets) >= self.kept:
            self._sets.popitem(last=False)
        self._sets[which] = photons

    def has(self, which: Which) -> bool:
        """Whether a photon pass is kept."""
        return which in self._sets

    def wavelength(self, t: mi.UInt32) -> mi.Float:
        """The number in [0, 1) by which a sensor samples the wavelengths of the ``t``-th samples: those of their map,
        the same for all pixels.
        """
        return wavelengths.shared(self._key, *self.division(t))

    def division(self, t: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32]:
        """What the ``t``-th samples divide the spectrum by, see :attr:`.NRook.division`."""
        return t, self._n

    def add_to(
        self,
        L: mi.Spectrum,
        ray: Ray,
        si: mi.SurfaceInteraction3f,
        bsdf: mi.BSDFPtr,
        drawn: Sequence[mi.BSDFContext],
        t: mi.UInt32,
        active: mi.Bool,
        scattered: mi.Bool | bool,
    ) -> mi.Spectrum:
        """``L`` plus the radiance of the photons at ``si``, which ``ray`` meets, for the ``t``-th sample of a pixel.

        ``drawn``: the glossy lobes, each with a ray of its own. ``scattered``: the lanes behind a diffuse reflection,
        whose glossy lobes gather none.
        """
        assert self._drawn is not None, "no photons have been emitted"
        number = t % dr.opaque(mi.UInt32, self._drawn.maps)
        L = L + self.gathering(self._drawn, number, si, bsdf, active)
        return L if self.mis is None else L + self.mis(ray, si, bsdf, drawn, t, but_not(active, scattered))

    def _photons(self, seed: int, number: int, n: int) -> tuple[Photons, Photons | None]:
        maps = self.maps(n)
        landed, map_of, _ = self._landed(seed, number, n, self._places(maps))
        diffuse, glossy = (None if one is None else Photons.of(one, map_of, maps, self.footprint) for one in landed)
        assert diffuse is not None
        return diffuse, glossy

    def _places(self, maps: int) -> tuple[mi.Float, mi.UInt32, mi.UInt32]:
        """Number of photons of each pair in a map, as :func:`placed` returns it."""
        if maps not in self._shares:
            self._shares[maps] = self._shared(max(self.count // maps, 1))
        return self._shares[maps]

    def _landed(
        self, seed: int, number: int, n: int, places: tuple[mi.Float, mi.UInt32, mi.UInt32], white: bool = False
    ) -> tuple[tuple[Landed, Landed | None], mi.UInt32, mi.UInt32]:
        """``(landed, map, pair)`` of all photons of a pass; ``landed`` as :class:`.Walk` returns it. ``places``: of
        :func:`placed`; ``white``: whether each photon has its own wavelengths instead of its map's.
        """
        (shares, begins, pairs), maps = places, self.maps(n)
        size = dr.width(pairs)
        i = dr.arange(mi.UInt32, size * maps)
        map_of = i // dr.opaque(mi.UInt32, size)
        of_map = i - map_of * dr.opaque(mi.UInt32, size)
        pair = dr.gather(mi.UInt32, pairs, of_map)
        share = mi.UInt32(dr.gather(mi.Float, shares, pair))
        key = combine(combine(hash32(dr.opaque(mi.UInt32, seed)), dr.opaque(mi.UInt32, number)), 0)
        # The photons of a pair go on from map to map, so that those of all together are evenly spread too.
        of_pair = map_of * share + of_map - dr.gather(mi.UInt32, begins, pair)
        t = i if white else dr.opaque(mi.UInt32, number * maps) + map_of
        wanted = self._wavelengths(seed, t, n)
        start = self.sources.start(pair, shares, *start_points(combine(key, pair), of_pair), wanted)
        landed = self.walk(start, combine(key, i + 1))
        dr.eval(landed, map_of, pair)
        return landed, map_of, pair

    def _wavelengths(self, seed: int, t: mi.UInt32, n: int) -> mi.Color0f:
        """Wavelengths of the ``t``-th samples, as the sensor samples them; empty except in spectral variants."""
        if not mi.is_spectral:
            return dr.zeros(mi.Color0f)
        key, middle = dr.opaque(mi.UInt32, hash32(seed)), mi.Point2f(0.5)
        sample = wavelengths.shared(key, t, dr.opaque(mi.UInt32, n))
        return self.sensor.sample_ray_differential(self.sensor.shutter_open(), sample, middle, middle)[0].wavelengths

    def _shared(self, size: int) -> tuple[mi.Float, mi.UInt32, mi.UInt32]:
        """How many of the ``size`` photons of a map each cell of each pair gets: in proportion to the RMS of what its
        photons add to a pixel, which minimises the noise (Neyman 1934).
        """
        pairs, edge = self.sources.pairs, 1
        while edge < EDGE and PER_CELL * pairs * (2 * edge) ** 2 <= size:
            edge *= 2
        cells = pairs * edge**2
        importance = Importance(self.scene, self.sensor, self.walk, self.footprint)
        part, squares, number = np.full(cells, 1 / cells), np.zeros(cells), np.zeros(cells)
        for k in range(ROUNDS):
            places = placed(np.maximum(np.round(part * PILOTS), 1))
            landed, _, cell = self._landed(0, k, 1, places, white=True)
            weights = importance(landed)
            count = np.array(places[0], dtype=np.float64)
            squares += count**2 * np.bincount(np.array(cell), weights, minlength=cells)
            number += count
            part = self._parts(np.sqrt(squares / number).reshape(pairs, edge, edge))
        return placed(np.maximum(np.round(part * size), 1))

    def _parts(self, wanted: np.ndarray) -> np.ndarray:
        """Fraction of the photons for each cell, about in proportion to ``wanted``, shape (pairs, edge, edge)."""
        edge = wanted.shape[1]
        padded = np.pad(wanted, ((0, 0), (1, 1), (1, 1)), mode="edge")
        smooth = np.mean([padded[:, j : j + edge, i : i + edge] for j in range(3) for i in range(3)], axis=0)
        aimless = self.sources.aimless
        smooth[aimless] = smooth[aimless].mean(axis=(1, 2), keepdims=True)
        whole, even = smooth.sum(), 1 / smooth.size
        return (1 - EVEN) * smooth.ravel() / whole + EVEN * even if whole > 0 else np.full(smooth.size, even)


def placed(shares: np.ndarray) -> tuple[mi.Float, mi.UInt32, mi.UInt32]:
    """``(shares, begins, pairs)`` of a map: the number of photons of each pair, the index of its first photon, and the
    pair of each photon.
    """
    counts = shares.astype(np.uint32)
    begins = np.cumsum(counts, dtype=np.uint32) - counts
    pairs = np.repeat(np.arange(len(counts), dtype=np.uint32), counts)
    result = mi.Float(counts.tolist()), mi.UInt32(begins.tolist()), mi.UInt32(pairs.tolist())  # lists: see Targets
    dr.make_opaque(*result)
    return result
