"""Light of the photons around a point of a diffuse surface."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi

from ..optics.nested import all_within
from ..transport import lobes
from ..transport.indivisible import any_indivisible, is_whole
from ..transport.scene_facts import scene_flags
from . import photons as grid
from .footprint import Footprint
from .photons import Photons
from .walk import WIDE

#: How far a photon may lie off the plane of the surface, over the reach: beyond the edge of a wall is another wall.
OFF = 0.25

#: Class names of BSDFs whose diffuse lobe is Lambert's, and of those around others that change nothing in it. (Mitsuba
#: knows no class of ours.)
LAMBERTIAN = ("Lambertian", "Phong", "Composite", "SmoothDiffuse")
AROUND = ("TwoSidedBRDF", "MaskBSDF", "BlendBSDF")


class Gathering:
    """The diffuse lobes of the surfaces of ``scene``, lit by photons within a pixel's width (``footprint``)."""

    def __init__(self, scene: mi.Scene, footprint: Footprint) -> None:
        self.footprint = footprint
        bsdfs = list(dict.fromkeys(shape.bsdf() for shape in scene.shapes() if shape.bsdf() is not None))
        self.indivisible = any_indivisible(scene)
        #: Whether photons may come by way of glossy lobes.
        self.glossy = bool(lobes.has_any(scene_flags(scene), *lobes.GLOSSY))
        #: Whether the diffuse lobes of all of them are Lambert's.
        self.lambertian = (
            not any(s.class_name() == "Instance" for s in scene.shapes())
            and not self.indivisible
            and all(map(is_lambertian, bsdfs))
        )

    def __call__(
        self, photons: Photons, number: mi.UInt32, si: mi.SurfaceInteraction3f, bsdf: mi.BSDFPtr, active: mi.Bool
    ) -> mi.Spectrum:
        """Radiance towards the viewer of the photons of the map ``number`` by the diffuse lobes of ``bsdf`` at ``si``,
        or by all of what is taken whole.

        They count within a pixel's width, those in the middle most (Epanechnikov's kernel, 2 (1 - d² / r²) / (π r²)):
        what comes between the samples of a pixel is blurred by that, and no more.
        """
        whole = active & is_whole(bsdf, active) if self.indivisible else mi.Bool(False)
        active = active & (lobes.has_any(bsdf.flags(), *lobes.DIFFUSE) | whole)

        def light(i: mi.UInt32, kernel: mi.Float, near: mi.Bool) -> mi.Spectrum:
            wo = -dr.gather(mi.Vector3f, photons.directions, i, near)
            flux = dr.gather(mi.Spectrum, photons.flux, i, near)
            cos = dr.dot(si.sh_frame.n, wo)
            if self.lambertian:
                near = near & (cos * si.wi.z > 0)
                return dr.select(near, flux * kernel, 0)
            near = near & (dr.abs(cos) > 1e-6)
            f = bsdf.eval(lobes.diffuse(), si, si.to_local(wo), near)
            if self.indivisible:
                f = dr.select(whole, bsdf.eval(lobes.everything(), si, si.to_local(wo), near & whole), f)
            return dr.select(near, f * flux * (kernel / dr.select(near, dr.abs(cos), 1)), 0)

        L = mi.Spectrum(0)
        for times in (1, WIDE) if self.glossy else (1,):
            total, per_area = within_reach(photons, number, self.footprint, si, light, active, times)
            L += total * per_area
        if self.lambertian:
            lit = active & (dr.max(L) > 0)
            L *= bsdf.eval(lobes.diffuse(), si, mi.Vector3f(0, 0, dr.sign(si.wi.z)), lit)
        return L


def within_reach(
    photons: Photons,
    number: mi.UInt32,
    footprint: Footprint,
    si: mi.SurfaceInteraction3f,
    light: Callable[[mi.UInt32, mi.Float, mi.Bool], mi.Spectrum],
    active: mi.Bool,
    times: int = 1,
) -> tuple[mi.Spectrum, mi.Float]:
    """``(sum, per_area)``: that of ``light(i, kernel, near)`` over the photons i of the map ``number`` within reach of
    ``si``, and what makes it a density, the kernel being 1 in the middle. ``near``: where there is one. ``times``: the
    reach, in pixel widths; only photons of this reach count.
    """
    distance = footprint.distance(si.p)
    reach = times * footprint.at(distance)
    # What lies within reach is seen at about the same distance: mostly from one grid, seldom from two.
    first = grid.level_of(times * footprint.at(dr.maximum(distance - reach, 0)))
    last = grid.level_of(times * footprint.at(distance + reach))
    inv_reach2 = dr.rcp(dr.square(reach))
    # They lie between two planes beside the surface: along its normal mostly in one cell, not in two.
    n2 = dr.square(si.n)
    off_axis = dr.minimum(dr.safe_sqrt(1 - n2) + OFF * dr.sqrt(n2), 1) * (reach * (1 + 1e-3))
    low_corner, high_corner = si.p - off_axis, si.p + off_axis

    def second(axis: int) -> mi.UInt32:
        """1 where they lie in two cells along ``axis``, else 0."""
        two = mi.Bool(False)
        for level in (first, last):
            two |= grid.cell(low_corner, level)[axis] != grid.cell(high_corner, level)[axis]
        return dr.select(two, mi.UInt32(1), 0)

    more_y, more_z = second(1), second(2)
    rows = dr.select(active, mi.UInt32(last - first + 1) << (more_y + more_z), 0)
    of_map, size = photons.of_map(number, active)

    def photon(i: mi.UInt32, end: mi.UInt32, key: mi.UInt32, L: mi.Spectrum) -> tuple[mi.UInt32, mi.Spectrum]:
        there = i < end
        k = dr.select(i < of_map + size, i, i - size)
        place = dr.gather(mi.Vector4f, photons.places, k, there)
        off = mi.Point3f(place.x, place.y, place.z) - si.p
        d2 = dr.squared_norm(off) * inv_reach2
        # Rows that share a bucket are met in turn: the photons of each, with it alone.
        near = there & (d2 < 1) & (dr.reinterpret_array(mi.UInt32, place.w) == key)
        near &= dr.square(dr.dot(off, si.n)) * inv_reach2 < OFF**2
        return i + 1, L + light(k, 1 - d2, near)

    def row(k: mi.UInt32, L: mi.Spectrum) -> tuple[mi.UInt32, mi.Spectrum]:
        level = first + mi.Int32(k >> (more_y + more_z))
        x, y, z = grid.cell(low_corner, level)
        key = grid.key(level, y + mi.Int32(k & more_y), z + mi.Int32((k >> more_y) & more_z))
        i, end = photons.run(number, key, x, grid.cell(high_corner, level)[0], size, k < rows)
        _, L = dr.while_loop((i, L), lambda i, L: i < end, lambda i, L: photon(i, end, key, L), labels=("i", "L"))
        return k + 1, L

    _, L = dr.while_loop((mi.UInt32(0), mi.Spectrum(0)), lambda k, L: k < rows, row, labels=("k", "L"))
    return L, 2 * dr.inv_pi * inv_reach2


def is_lambertian(bsdf: mi.BSDF) -> bool:
    """Whether all diffuse lobes of ``bsdf`` reflect alike in every direction."""
    return all(
        one.class_name() in AROUND
        or {one.class_name(), type(one).__name__} & set(LAMBERTIAN)
        or not lobes.has_any(int(one.flags()), *lobes.DIFFUSE)
        for one in all_within(bsdf)
    )
