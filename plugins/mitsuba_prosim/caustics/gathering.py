"""Light of the photons around a point of a diffuse surface."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..masks import but_not
from ..transport import lobes
from ..transport.indivisible import is_whole
from . import photons as grid
from .footprint import Footprint
from .photons import Photons

#: How far a photon may lie off the plane of the surface, over the reach: beyond the edge of a wall is another wall.
OFF = 0.25


def gathered(
    photons: Photons,
    footprint: Footprint,
    indivisible: bool,
    si: mi.SurfaceInteraction3f,
    bsdf: mi.BSDFPtr,
    number: mi.UInt32,
    active: mi.Bool,
) -> mi.Spectrum:
    """Radiance towards the viewer of the photons of the map ``number`` by the diffuse lobes of ``bsdf`` at ``si``.

    They count within a pixel's width, those in the middle most (Epanechnikov's kernel, 2 (1 - d² / r²) / (π r²)):
    what comes between the samples of a pixel is blurred by that, and no more.
    """
    context = lobes.diffuse()
    active = active & lobes.has_any(bsdf.flags(), *lobes.DIFFUSE)
    if indivisible:
        active = but_not(active, is_whole(bsdf, active))
    distance = footprint.distance(si.p)
    reach = footprint.at(distance)
    # What lies within reach is seen at about the same distance: mostly from one grid, seldom from two.
    first = grid.level_of(footprint.at(dr.maximum(distance - reach, 0)))
    last = grid.level_of(footprint.at(distance + reach))
    cells = dr.select(active, 8 * mi.UInt32(last - first + 1), 0)
    inv_reach2 = dr.rcp(dr.square(reach))

    def step(
        k: mi.UInt32, i: mi.UInt32, end: mi.UInt32, here: mi.Vector4f, E: mi.Spectrum
    ) -> tuple[mi.UInt32, mi.UInt32, mi.UInt32, mi.Vector4f, mi.Spectrum]:
        opens = i >= end
        level = first + mi.Int32(k >> 3)
        x, y, z = grid.cell(si.p, level, -0.5)
        x, y, z = x + mi.Int32(k & 1), y + mi.Int32((k >> 1) & 1), z + mi.Int32((k >> 2) & 1)
        at = grid.bucket(number, level, x, y, z, photons.mask)
        i = dr.select(opens, dr.gather(mi.UInt32, photons.begins, at, opens), i)
        end = dr.select(opens, dr.gather(mi.UInt32, photons.begins, at + 1, opens), end)
        here = dr.select(opens, mi.Vector4f(mi.Float(x), mi.Float(y), mi.Float(z), mi.Float(level)), here)
        k = dr.select(opens, k + 1, k)
        there = i < end
        place = dr.gather(mi.Vector4f, photons.places, i, there)
        p = mi.Point3f(place.x, place.y, place.z)
        off = p - si.p
        d2 = dr.squared_norm(off) * inv_reach2
        near = there & (d2 < 1) & (dr.square(dr.dot(off, si.n)) * inv_reach2 < OFF**2)
        # Of those that share the bucket, only the photons of this very cell: the others are met with theirs.
        own = [mi.Float(v) for v in grid.cell(p, mi.Int32(here.w))]
        near &= (place.w == here.w) & (own[0] == here.x) & (own[1] == here.y) & (own[2] == here.z)
        d = dr.gather(mi.Vector3f, photons.directions, i, near)
        flux = dr.gather(mi.Spectrum, photons.flux, i, near)
        f = bsdf.eval(context, si, si.to_local(-d), near)
        cos = dr.abs(dr.dot(si.n, d))
        near &= cos > 1e-6
        E += dr.select(near, f * flux * ((1 - d2) / dr.select(near, cos, 1)), 0)
        return k, i + 1, end, here, E

    *_, E = dr.while_loop(
        (mi.UInt32(0), mi.UInt32(0), mi.UInt32(0), mi.Vector4f(0), mi.Spectrum(0)),
        lambda k, i, end, here, E: (k < cells) | (i < end),
        step,
        labels=("k", "i", "end", "here", "E"),
    )
    return E * (2 * dr.inv_pi * inv_reach2)
