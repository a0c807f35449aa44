"""Photon maps: grids whose cells sort photons by position, and the search for the photons near a point."""

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

#: Minimum width of a pixel, as a fraction of the scene's radius, which a wide ground may make large.
MIN_PIXEL_WIDTH = 1e-8

#: This width for sensors whose rays tell of no pixels: a meter of one ray, or ``batch``.
WIDTH_WITHOUT_PIXELS = 1e-3

#: Logarithm to base 2 of the ratio between one kernel radius and the next; kernel radii of photons, in pixel widths.
OCTAVES = 2
RADII = tuple(2 ** (OCTAVES * k) for k in range(3))

#: Maximum kernel radius, as a fraction of the image, except for a radius of one pixel.
WIDEST = 1 / 25

#: Ratio of two areas with the same noise: the area on which photons have equal weights, over the area of an
#: Epanechnikov kernel.
UNIFORM_AREA = 0.75

#: Number of cell sizes per octave. Each size has its own grid. A photon is in the grid that fits the pixel footprint at
#: its place, so a search meets about as many photons near the camera as far away.
SIZES = 4

#: Maximum distance of a photon from the plane of the surface, over the search radius. A photon farther away may lie on
#: another wall behind an edge.
MAX_PLANE_DISTANCE = 0.25

#: Minimum cosine by which the value of a BSDF is divided.
MIN_COSINE = 1e-6

#: Minimum number of neighbours of a photon, over all maps. A photon gets the smallest of the :data:`RADII` with about
#: this number of photons around it.
MIN_NEIGHBOURS = 100

#: Number of entries of the hash table that counts photons per cell.
COUNTERS = 1 << 18

#: Function that returns the value of a BSDF, without the cosine. Its arguments are the index of a photon, the direction
#: from which the photon comes, and a mask of lanes.
ValueOf = Callable[[Any, Any, Any], Any]


@dataclass(frozen=True)
class Footprint:
    """The footprint of a pixel at a point p of the scene: its width is ``size + spread * |p - eye|`` in scene units."""

    eye: mi.Point3f
    size: mi.Float
    spread: mi.Float
    #: The :data:`RADII` that are small enough for the image.
    radii: tuple[int, ...] = RADII

    @classmethod
    def of(cls, scene: mi.Scene, sensor: mi.Sensor) -> Footprint:
        """Returns the footprint of the pixel at the centre of the film, without its crop window.

        Its width is at least :data:`MIN_PIXEL_WIDTH` times the radius of the scene, or :data:`WIDTH_WITHOUT_PIXELS`
        times this radius, with all :data:`RADII`, if the rays of ``sensor`` have no differentials.
        """
        with without_crop_window(sensor):
            middle = mi.Point2f(0.5)
            ray, _ = sensor.sample_ray_differential(sensor.shutter_open(), 0.5, middle, middle, True)
        offset = spread = 0.0
        if ray.has_differentials:
            offset = min(float(dr.norm(o - ray.o)[0]) for o in (ray.o_x, ray.o_y))
            spread = min(float(dr.norm(d - ray.d)[0]) for d in (ray.d_x, ray.d_y))
        least = MIN_PIXEL_WIDTH if ray.has_differentials else WIDTH_WITHOUT_PIXELS
        least *= float(scene.bbox().bounding_sphere().radius)
        # Rays start at the near plane. There, rays of neighbouring pixels of a perspective camera are already apart.
        # ``size`` is their distance at the eye: about 0 for a perspective camera, but at least ``least``.
        eye = world_transform(sensor, sensor.shutter_open()).translation()
        near = float(dr.norm(ray.o - eye)[0])
        widest = WIDEST * max(sensor.film().size()) if ray.has_differentials else RADII[-1]
        radii = tuple(radius for radius in RADII if radius == 1 or radius <= widest)
        result = cls(mi.Point3f(eye), mi.Float(max(offset - near * spread, least)), mi.Float(spread), radii)
        dr.make_opaque(result.eye, result.size, result.spread)
        return result

    def width(self, p: mi.Point3f) -> mi.Float:
        """Returns the width of a pixel at the point ``p``, in scene units."""
        return self.size + self.spread * dr.norm(p - self.eye)

    def area(self, p: mi.Point3f) -> mi.Float:
        """Returns the area, in square scene units, on which photons with equal weights cause the same noise as photons
        with the weights of the kernel at the point ``p``.
        """
        return UNIFORM_AREA * dr.pi * dr.square(self.width(p))


@dataclass
class Landed:
    """Photons that have landed on surfaces."""

    p: mi.Point3f
    #: Unit direction of flight.
    d: mi.Vector3f
    #: Power divided by the cosine of the direction to the geometric normal, and multiplied by the cosine to the shading
    #: normal.
    flux: mi.Spectrum
    #: Whether the photon has landed, after at least one specular surface.
    valid: mi.Bool
    #: Density of photons at a glossy surface (:attr:`.Start.density`); 0 on diffuse surfaces.
    density: mi.Float
    #: Number of surfaces that the photon met before a glossy surface; 0 on diffuse surfaces.
    level: mi.UInt32

    @classmethod
    def nowhere(cls) -> Landed:
        """Returns photons that have not landed."""
        return cls(mi.Point3f(0), mi.Vector3f(0), mi.Spectrum(0), mi.Bool(False), mi.Float(0), mi.UInt32(0))

    def at(self, i: mi.UInt32) -> Landed:
        """Returns the photons with the indices ``i``."""
        # The tuple avoids that Dr.Jit caches the types of the fields, which differ between variants.
        return Landed(*dr.gather(tuple, tuple(vars(self).values()), i))


class Photons:
    """The photons ``landed``, sorted into ``maps`` independent photon maps, so that every sum over photons has a fixed
    order: by their map ``map_of``, then by bucket of grid cells (:func:`bucket_of`), then by their index.
    """

    def __init__(self, landed: Landed, map_of: mi.UInt32, maps: int, footprint: Footprint) -> None:
        self.maps, self.footprint = maps, footprint
        size = dr.width(map_of) // maps
        buckets = 1 << max(4, (size - 1).bit_length())  # about one bucket for each photon that was emitted
        #: Number of buckets of a map, which is a power of two, minus one.
        self.mask = dr.opaque(mi.UInt32, buckets - 1)
        indices = dr.compress(landed.valid)
        if dr.width(indices) == 0:
            indices = mi.UInt32(0)  # a photon without flux
        landed = landed.at(indices)
        grid = grid_of(kernel_radii(landed.p, footprint))
        x, y, z = cell(landed.p, grid)
        rows = row_hash(grid, y, z)
        bucket = bucket_of(dr.gather(mi.UInt32, map_of, indices), rows, x, self.mask)
        dr.eval(landed, rows, bucket)
        order = dr.argsort(bucket)
        #: The photons; their places are only in ``places``.
        self.landed, (rows, bucket) = landed.at(order), dr.gather(tuple, (rows, bucket), order)
        #: Index of the first photon of each bucket, one map after the other; the last entry is the number of all
        #: photons.
        self.begins = counts_below(bucket, maps * buckets)
        #: Four numbers for each photon: x, y, z, and the bits of the hash of its row of cells.
        self.places = dr.ravel(mi.Vector4f(*self.landed.p, dr.reinterpret_array(mi.Float, rows)))
        dr.eval(self.places, self.landed, self.begins)
        self.landed.p = mi.Point3f(0)

    def row_range(
        self, number: mi.UInt32, row: mi.UInt32, low: mi.Int32, high: mi.Int32, size: mi.UInt32, active: mi.Bool
    ) -> tuple[mi.UInt32, mi.UInt32]:
        """Returns ``(begin, end)``: the indices of the photons in the cells ``low`` to ``high`` of a row of cells of
        the map ``number``, and perhaps of photons of other rows, which may share a bucket.

        The ``size`` photons of a map form a ring: an index beyond the last photon continues at the first photon.
        """
        first, last = (bucket_of(number, row, x, self.mask) for x in (low, high))
        begin, end = (dr.gather(mi.UInt32, self.begins, at, active) for at in (first, last + 1))
        return begin, dr.select(last < first, end + size, end)


def kernel_radii(p: mi.Point3f, footprint: Footprint) -> mi.Float:
    """Returns the kernel radius, in scene units, of photons at the points ``p``: the width of a pixel there times the
    smallest of ``footprint.radii`` with at least about :data:`MIN_NEIGHBOURS` photons within the radius, or the
    greatest.

    The radius is greater where photons are sparse, because a single photon with a small radius would make an isolated
    bright pixel (Silverman 1986, chapter 5). The neighbours are counted in all photon maps together, so that the radius
    hardly depends on the photons of one map.
    """
    width = footprint.width(p)
    result = mi.Float(width)
    for narrow, wide in pairwise(footprint.radii):
        grid, neighbours = grid_of(2 * narrow * width), mi.Float(0)
        # A cell at the edge of a caustic may be nearly empty. A cell that is shifted by half its edge is then fuller.
        for shift in (0, 0.5):
            x, y, z = cell(p + shift * cell_edge(grid), grid)
            entry = combine(row_hash(grid, y, z), mi.UInt32(x)) & (COUNTERS - 1)
            count = dr.zeros(mi.UInt32, COUNTERS)
            dr.scatter_add(count, mi.UInt32(1), entry)
            neighbours = dr.maximum(neighbours, dr.gather(mi.UInt32, count, entry))
        neighbours *= dr.pi * dr.square(narrow * width / cell_edge(grid))  # in a circle, not in a cell
        result = dr.select((neighbours < MIN_NEIGHBOURS) & (result == narrow * width), wide * width, result)
    return result


def counts_below(key: mi.UInt32, count: int) -> mi.UInt32:
    """Returns, for each k from 0 to ``count``, how many entries of the sorted array ``key`` are less than k."""
    # NumPy counts on the host: a kernel would add in the order in which its threads end.
    counts = np.bincount(np.array(key), minlength=count)
    return mi.UInt32(np.concatenate([[0], np.cumsum(counts)]).astype(np.uint32))


def grid_of(radius: mi.Float) -> mi.Int32:
    """Returns the number of the grid for photons of a kernel radius. A sphere with this radius touches at most two of
    its cells along each axis.
    """
    return mi.Int32(dr.floor(SIZES * dr.log2(radius)))


def cell_edge(grid: mi.Int32) -> mi.Float:
    """Returns the edge length of the cells of ``grid``: twice the greatest kernel radius in it."""
    return 2 * dr.exp2(mi.Float(grid + 1) * (1 / SIZES))


def cell(p: mi.Point3f, grid: mi.Int32) -> tuple[mi.Int32, mi.Int32, mi.Int32]:
    """Returns the integer coordinates of the cell of the point ``p``."""
    per_edge = dr.rcp(cell_edge(grid))
    return tuple(mi.Int32(dr.floor(v * per_edge)) for v in p)


def row_hash(grid: mi.Int32, y: mi.Int32, z: mi.Int32) -> mi.UInt32:
    """Returns a hash of the row of cells with the coordinates ``y`` and ``z``."""
    return combine(combine(mi.UInt32(grid), mi.UInt32(y)), mi.UInt32(z))


def bucket_of(number: mi.UInt32, row: mi.UInt32, x: mi.Int32, mask: mi.UInt32) -> mi.UInt32:
    """Returns the number of the bucket for the cell ``x`` of the row with the hash ``row`` in the map ``number``.

    Each map has ``mask`` + 1 buckets, which form a ring. The photons of the next cell of a row are in the next bucket.
    """
    return number * (mask + 1) + ((row + mi.UInt32(x)) & mask)


def gather(
    photons: Photons, number: mi.UInt32, si: mi.SurfaceInteraction3f, value: ValueOf, active: mi.Bool
) -> mi.Spectrum:
    """Returns the radiance that the surface at ``si`` scatters from nearby photons of the map ``number``: the sum of
    the BSDF ``value`` times flux times kernel.

    A photon with the kernel radius r (for the width of a pixel at ``si``), at the distance d < r, has Epanechnikov's
    kernel, 2 (1 - d² / r²) / (π r²), unless it is farther from the plane of the surface than r times
    :data:`MAX_PLANE_DISTANCE`.
    """
    footprint = photons.footprint
    width, n2 = footprint.width(si.p), dr.square(si.n)
    # Half the extent of the searched space along each axis, in search radii, with a margin for rounding. The space lies
    # between two planes parallel to the surface. So it mostly lies in one cell along the normal, not in two.
    off_axis = dr.minimum(dr.safe_sqrt(1 - n2) + MAX_PLANE_DISTANCE * dr.sqrt(n2), 1) * (1 + 1e-3)
    ends = [dr.gather(mi.UInt32, photons.begins, (number + k) * (photons.mask + 1), active) for k in range(2)]
    first_of_map, size = ends[0], ends[1] - ends[0]

    def add_radius(k: mi.UInt32, L: mi.Spectrum) -> mi.Spectrum:
        pixels = mi.Float(1 << (OCTAVES * k))
        radius = pixels * width
        # A pixel is about equally wide at all photons within the radius. So these photons are mostly in one grid,
        # seldom in two.
        change = footprint.spread * radius
        first = grid_of(pixels * dr.maximum(width - change, footprint.size))
        last = grid_of(pixels * (width + change))
        inv_radius2 = dr.rcp(dr.square(radius))
        low_corner, high_corner = si.p - off_axis * radius, si.p + off_axis * radius

        # The number of cells along y and along z, minus one: 0 or 1. A row's number has one bit for y and one bit for z
        # if there are two cells. With two grids, two cells are assumed.
        cells = zip(cell(low_corner, first)[1:], cell(high_corner, first)[1:])
        bits_y, bits_z = (dr.select((low != high) | (first < last), mi.UInt32(1), 0) for low, high in cells)
        rows = dr.select(active, mi.UInt32(last - first + 1) << (bits_y + bits_z), 0)

        def add_photon(i: mi.UInt32, end: mi.UInt32, row: mi.UInt32, L: mi.Spectrum) -> tuple[mi.UInt32, mi.Spectrum]:
            in_range = i < end
            index = dr.select(i < first_of_map + size, i, i - size)
            place = dr.gather(mi.Vector4f, photons.places, index, in_range)
            offset = mi.Point3f(place.x, place.y, place.z) - si.p
            d2 = dr.squared_norm(offset) * inv_radius2
            # Rows that share a bucket are visited one after the other: each visit counts only the photons of its own
            # row.
            in_reach = in_range & (d2 < 1) & (dr.reinterpret_array(mi.UInt32, place.w) == row)
            in_reach &= dr.square(dr.dot(offset, si.n)) * inv_radius2 < MAX_PLANE_DISTANCE**2
            d, flux = (dr.gather(type(v), v, index, in_reach) for v in (photons.landed.d, photons.landed.flux))
            light = dr.select(in_reach, value(index, -d, in_reach) * flux, 0)
            return i + 1, L + light * (2 * dr.inv_pi * inv_radius2 * (1 - d2))

        def add_row(k: mi.UInt32, L: mi.Spectrum) -> tuple[mi.UInt32, mi.Spectrum]:
            # The bits of k, lowest first: one for y and one for z if there are two cells along that axis; the others
            # are the grid.
            grid = first + mi.Int32(k >> (bits_y + bits_z))
            x, y, z = cell(low_corner, grid)
            row_key = row_hash(grid, y + mi.Int32(k & bits_y), z + mi.Int32((k >> bits_y) & bits_z))
            i, end = photons.row_range(number, row_key, x, cell(high_corner, grid)[0], size, k < rows)
            _, L = dr.while_loop((i, L), lambda i, L: i < end, lambda i, L: add_photon(i, end, row_key, L))
            return k + 1, L

        return dr.while_loop((mi.UInt32(0), L), lambda k, L: k < rows, add_row)[1]

    return fold(len(footprint.radii), add_radius, mi.Spectrum(0), active, unrolled=False)
