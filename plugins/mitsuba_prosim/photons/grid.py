"""Photon maps: photons sorted into the cells of grids, and the search for those near a point."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compat import world_transform
from ..engine.camera import without_crop_window
from ..masks import fold
from ..sampling.hash import combine

#: Least width of a pixel, for sensors without pixels (a meter of one ray): this part of the scene's radius.
MIN_PIXEL_WIDTH = 1e-5

#: Radii of the kernels of photons, in pixel widths, and the logarithm to base 2 of the ratio of one to the next.
OCTAVES = 2
RADII = tuple(2 ** (OCTAVES * k) for k in range(3))

#: Greatest radius but that of a pixel, as a part of the image.
WIDEST = 1 / 25

#: Area on which photons have equal weights, over the area of an Epanechnikov kernel of the same noise.
UNIFORM_AREA = 0.75

#: Cell sizes per octave. Each size has a grid. A photon is in the grid that fits the pixel footprint at its place, so
#: that a search meets about as many photons near the eye as far away.
SIZES = 4

#: Greatest distance of a photon from the plane of the surface, over the search radius: behind the edge of a wall is
#: another wall.
MAX_PLANE_DISTANCE = 0.25

#: Least cosine that a BSDF's value is divided by.
MIN_COSINE = 1e-6

#: A photon has the first of the radii (:data:`RADII`) within which about this number of photons lie, of all
#: maps together.
MIN_NEIGHBOURS = 100

#: Entries of the hash table that photons are counted in.
COUNTERS = 1 << 18

#: Value of a BSDF, without the cosine, for the photon of an index and the direction that it comes from, in the lanes of
#: a mask.
ValueOf = Callable[[Any, Any, Any], Any]


@dataclass(frozen=True)
class Footprint:
    """A pixel is ``size + spread * |p - eye|`` wide at the point p."""

    eye: mi.Point3f
    size: mi.Float
    spread: mi.Float
    #: Those of :data:`RADII` that fit the image.
    radii: tuple[int, ...] = RADII

    @classmethod
    def of(cls, scene: mi.Scene, sensor: mi.Sensor) -> Footprint:
        """The footprint of the pixels in the middle of the whole film of ``sensor``."""
        with without_crop_window(sensor):
            ray, _ = sensor.sample_ray_differential(sensor.shutter_open(), 0.5, mi.Point2f(0.5), mi.Point2f(0.5))
        offset = spread = 0.0
        if ray.has_differentials:
            offset = min(float(dr.norm(o - ray.o)[0]) for o in (ray.o_x, ray.o_y))
            spread = min(float(dr.norm(d - ray.d)[0]) for d in (ray.d_x, ray.d_y))
        least = MIN_PIXEL_WIDTH * float(scene.bbox().bounding_sphere().radius)
        # Rays start at the near plane, where those of a perspective camera already have a distance.
        eye = world_transform(sensor, sensor.shutter_open()).translation()
        near = float(dr.norm(ray.o - eye)[0])
        radii = tuple(radius for radius in RADII if radius == 1 or radius <= WIDEST * max(sensor.film().size()))
        result = cls(mi.Point3f(eye), mi.Float(max(offset - near * spread, least)), mi.Float(spread), radii)
        dr.make_opaque(result.eye, result.size, result.spread)
        return result

    def width(self, p: mi.Point3f) -> mi.Float:
        """Width of a pixel at ``p``."""
        return self.size + self.spread * dr.norm(p - self.eye)

    def area(self, p: mi.Point3f) -> mi.Float:
        """Area around ``p`` on which photons with equal weights have the same noise as with those of the kernel."""
        return UNIFORM_AREA * dr.pi * dr.square(self.width(p))


@dataclass
class Landed:
    """Photons where they have landed."""

    p: mi.Point3f
    #: Unit direction of flight.
    d: mi.Vector3f
    #: Power over the cosine of that direction and the surface, times the cosine with the normal that it is shaded by.
    flux: mi.Spectrum
    #: Whether it has landed, after at least one specular surface.
    valid: mi.Bool
    #: On glossy surfaces: density of photons there (:attr:`.Start.density`) ...
    density: mi.Float
    #: ... and number of surfaces on their way. 0 on diffuse surfaces.
    level: mi.UInt32

    @classmethod
    def nowhere(cls) -> Landed:
        """Photons that have not landed."""
        return cls(mi.Point3f(0), mi.Vector3f(0), mi.Spectrum(0), mi.Bool(False), mi.Float(0), mi.UInt32(0))

    def at(self, i: mi.UInt32) -> Landed:
        """The photons of the indices ``i``."""
        # Dr.Jit resolves the types of fields once, and they differ between variants.
        return Landed(*dr.gather(tuple, tuple(vars(self).values()), i))


@dataclass(frozen=True)
class Photons:
    """Photons of ``maps`` independent photon maps, sorted by map, by a hash of the row of cells, by the cell in the
    row, and by their index, so that a sum over them has one order.
    """

    maps: int
    #: x, y, z and, bit by bit, the key of its row of cells, photon by photon.
    places: mi.Float
    #: All else of them, without places.
    landed: Landed
    #: First photon of each bucket, for each map one bucket after the other, and the number of all.
    begins: mi.UInt32
    #: Buckets of a map, a power of two, less one.
    mask: mi.UInt32
    #: Of the pixels that gather them.
    footprint: Footprint

    @classmethod
    def of(cls, landed: Landed, map_of: mi.UInt32, maps: int, footprint: Footprint) -> Photons:
        """Sorts the photons ``landed``; ``map_of``: the map of each."""
        size = dr.width(map_of) // maps
        buckets = 1 << max(4, (size - 1).bit_length())
        mask = dr.opaque(mi.UInt32, buckets - 1)
        there = dr.compress(landed.valid)
        if dr.width(there) == 0:
            there = mi.UInt32(0)  # a photon without flux
        landed = landed.at(there)
        level = level_of(kernel_radii(landed.p, footprint))
        x, y, z = cell(landed.p, level)
        rows = row_hash(level, y, z)
        at = bucket_of(dr.gather(mi.UInt32, map_of, there), rows, x, mask)
        dr.eval(landed, rows, at)
        order = dr.argsort(at)
        landed, (rows, at) = landed.at(order), dr.gather(tuple, (rows, at), order)
        begins = first_of_each(at, maps * buckets)
        places = dr.ravel(mi.Vector4f(*landed.p, dr.reinterpret_array(mi.Float, rows)))
        dr.eval(places, landed, begins)
        landed.p = mi.Point3f(0)
        return cls(maps, places, landed, begins, mask, footprint)

    def map_range(self, number: mi.UInt32, active: mi.Bool) -> tuple[mi.UInt32, mi.UInt32]:
        """First photon of the map ``number``, and the number of its photons."""
        first, end = (dr.gather(mi.UInt32, self.begins, (number + k) * (self.mask + 1), active) for k in range(2))
        return first, end - first

    def row_range(
        self, number: mi.UInt32, row: mi.UInt32, low: mi.Int32, high: mi.Int32, size: mi.UInt32, active: mi.Bool
    ) -> tuple[mi.UInt32, mi.UInt32]:
        """``(begin, end)`` of the photons in the cells ``low`` to ``high`` of a row, in the ``number``-th photon map.
        Photons of other rows may be among them. The ``size`` photons of a map are a ring: the first follows the last.
        """
        first, last = (bucket_of(number, row, x, self.mask) for x in (low, high))
        begin, end = (dr.gather(mi.UInt32, self.begins, at, active) for at in (first, last + 1))
        return begin, dr.select(last < first, end + size, end)


def kernel_radii(p: mi.Point3f, footprint: Footprint) -> mi.Float:
    """The kernel radius of each of the photons at ``p``.

    It is greater where photons are sparse: one alone would make an isolated bright pixel (Silverman 1986, 5.1). Photons
    of all maps are counted, so that the radius hardly depends on those of one map. Each photon keeps its power.
    """
    width = footprint.width(p)
    result = mi.Float(width)
    for narrow, wide in pairwise(footprint.radii):
        level, within = level_of(2 * narrow * width), mi.Float(0)
        # A cell at the edge of a caustic is nearly empty. One that is shifted by half an edge is not.
        for shift in (0, 0.5):
            x, y, z = cell(p + shift * cell_edge(level), level)
            entry = combine(row_hash(level, y, z), mi.UInt32(x)) & (COUNTERS - 1)
            count = dr.zeros(mi.UInt32, COUNTERS)
            dr.scatter_add(count, mi.UInt32(1), entry)
            within = dr.maximum(within, dr.gather(mi.UInt32, count, entry))
        within *= dr.pi * dr.square(narrow * width / cell_edge(level))
        result = dr.select((within < MIN_NEIGHBOURS) & (result == narrow * width), wide * width, result)
    return result


def first_of_each(key: mi.UInt32, count: int) -> mi.UInt32:
    """How many of the sorted ``key`` are below k, for each k from 0 to ``count``."""
    # On the host: a kernel would add in the order in which the threads end.
    counts = np.bincount(np.array(key), minlength=count)
    return mi.UInt32(np.concatenate([[0], np.cumsum(counts)]).astype(np.uint32))


def level_of(reach: mi.Float) -> mi.Int32:
    """The grid in which the surroundings of a point within ``reach`` lie in at most two cells along each axis."""
    return mi.Int32(dr.floor(SIZES * dr.log2(reach)))


def cell_edge(level: mi.Int32) -> mi.Float:
    """Edge of the cells of a grid: twice the longest reach of its level."""
    return 2 * dr.exp2(mi.Float(level + 1) * (1 / SIZES))


def cell(p: mi.Point3f, level: mi.Int32) -> tuple[mi.Int32, mi.Int32, mi.Int32]:
    """The cell of ``p``."""
    per_edge = dr.rcp(cell_edge(level))
    return tuple(mi.Int32(dr.floor(v * per_edge)) for v in p)


def row_hash(level: mi.Int32, y: mi.Int32, z: mi.Int32) -> mi.UInt32:
    """A hash that identifies a row of cells along x. Two neighbouring rows have the same one with probability 10⁻⁸."""
    return combine(combine(mi.UInt32(level), mi.UInt32(y)), mi.UInt32(z))


def bucket_of(number: mi.UInt32, row: mi.UInt32, x: mi.Int32, mask: mi.UInt32) -> mi.UInt32:
    """Number of the bucket of the cell ``x`` of a row in the map ``number``. ``row``: hash of the row; each map has
    ``mask`` + 1 buckets, a ring. The next cell has the next bucket; cells of different rows may share a bucket.
    """
    return number * (mask + 1) + ((row + mi.UInt32(x)) & mask)


def gather(
    photons: Photons, number: mi.UInt32, si: mi.SurfaceInteraction3f, value: ValueOf, active: mi.Bool
) -> mi.Spectrum:
    """Radiance by the photons of the map ``number`` near ``si``: the sum of the BSDF's ``value`` times flux and kernel.
    The kernel for the radius r of a photon is Epanechnikov's, 2 (1 - d² / r²) / (π r²).
    """
    footprint = photons.footprint
    width, n2 = footprint.width(si.p), dr.square(si.n)
    # They are between two planes parallel to the surface: along its normal mostly in one cell, not in two.
    off_axis = dr.minimum(dr.safe_sqrt(1 - n2) + MAX_PLANE_DISTANCE * dr.sqrt(n2), 1) * (1 + 1e-3)
    of_map, size = photons.map_range(number, active)

    def of_reach(k: mi.UInt32, L: mi.Spectrum) -> mi.Spectrum:
        """Adds the photons whose radius is the ``k``-th of the footprint's."""
        times = mi.Float(1 << (OCTAVES * k))
        reach = times * width
        # Photons within reach have about the same width of a pixel: mostly one grid has them, seldom two.
        change = footprint.spread * reach
        first = level_of(times * dr.maximum(width - change, footprint.size))
        last = level_of(times * (width + change))
        inv_reach2 = dr.rcp(dr.square(reach))
        low_corner, high_corner = si.p - off_axis * reach, si.p + off_axis * reach

        # The number of cells along y and along z, less one: 0 or 1, which is a mask of one bit of a row's number.
        cells = zip(cell(low_corner, first)[1:], cell(high_corner, first)[1:])
        bits_y, bits_z = (dr.select((low != high) | (first < last), mi.UInt32(1), 0) for low, high in cells)
        rows = dr.select(active, mi.UInt32(last - first + 1) << (bits_y + bits_z), 0)

        def photon(i: mi.UInt32, end: mi.UInt32, row_key: mi.UInt32, L: mi.Spectrum) -> tuple[mi.UInt32, mi.Spectrum]:
            there = i < end
            k = dr.select(i < of_map + size, i, i - size)
            place = dr.gather(mi.Vector4f, photons.places, k, there)
            off = mi.Point3f(place.x, place.y, place.z) - si.p
            d2 = dr.squared_norm(off) * inv_reach2
            # Rows that share a bucket are met in turn: the photons of each, with it alone.
            in_reach = there & (d2 < 1) & (dr.reinterpret_array(mi.UInt32, place.w) == row_key)
            in_reach &= dr.square(dr.dot(off, si.n)) * inv_reach2 < MAX_PLANE_DISTANCE**2
            d, flux = (dr.gather(type(v), v, k, in_reach) for v in (photons.landed.d, photons.landed.flux))
            light = dr.select(in_reach, value(k, -d, in_reach) * flux, 0)
            return i + 1, L + light * (2 * dr.inv_pi * inv_reach2 * (1 - d2))

        def row(k: mi.UInt32, L: mi.Spectrum) -> tuple[mi.UInt32, mi.Spectrum]:
            # The bits of k, the lowest first: y and z, each only if there are two cells; and the level.
            level = first + mi.Int32(k >> (bits_y + bits_z))
            x, y, z = cell(low_corner, level)
            row_key = row_hash(level, y + mi.Int32(k & bits_y), z + mi.Int32((k >> bits_y) & bits_z))
            i, end = photons.row_range(number, row_key, x, cell(high_corner, level)[0], size, k < rows)
            _, L = dr.while_loop((i, L), lambda i, L: i < end, lambda i, L: photon(i, end, row_key, L))
            return k + 1, L

        return dr.while_loop((mi.UInt32(0), L), lambda k, L: k < rows, row)[1]

    return fold(0, len(footprint.radii), of_reach, mi.Spectrum(0), active, unrolled=False)
