"""Light that rays of the eye and photons both find, shared between them (Georgiev et al. 2012; Hachisuka et al. 2012).

Light that a glossy surface G gets by way of ideally smooth ones, the highlight of a mirror in a rough metal, is met by
rays that G's lobe draws and that end in a source by luck; the smaller the source, the fewer and brighter they are.
Photons that lie on G find the same light. Of a path that either could have found, each counts by the power heuristic
(Veach 1997), for which it need be known how many photons lie within reach of G for each ray that is drawn: R.

Along a chain of ideally smooth surfaces, the number of photons per area at right angles to the ray and per solid angle,
their density, only falls by what is absorbed and by the choice of a lobe, and is scaled by the square of the index as
radiance is: neither mirrors nor lenses change the product of area and solid angle of a beam. So R is that density,
known at the source, times what a ray of the eye has brought along since G, the reach (:meth:`Merging.begun`): the area
that photons count on, seen from the ray, over the density that the lobe has drawn the ray with.

What is glossy, but nearly smooth (:mod:`..transport.narrow`), is part of such a chain too. There each end multiplies by
what the lobe scatters over the density of the eye's sample; sources that are sampled there, and photons at several
glossy surfaces, are further ways to find the light, whose shares add up to 1 (:mod:`.passing`).
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi

from ..light.table import Lights
from ..masks import but_not
from ..transport import lobes, workarounds
from ..transport.context import scene_flags
from ..transport.merging import before, share
from ..transport.narrow import LIES, Narrow
from ..transport.ray import Ray, viewer_side
from ..transport.workarounds import any_careful, is_whole
from .emission import ENDLESS, Sources, Start
from .footprint import Footprint
from .grid import Photons, within_reach


class Merging:
    """Glossy lobes lit by photons that came by way of smooth surfaces alone, ideally or nearly (``narrow``), at most
    ``deepest`` with those of the eye's ray; within a pixel's width (``footprint``). ``indivisible``: whether any BSDF
    is taken whole; ``careful``: whether any has to be asked for its lobes with care.
    """

    def __init__(
        self,
        footprint: Footprint,
        sources: Sources,
        narrow: Narrow,
        deepest: mi.UInt32,
        indivisible: bool,
        careful: bool,
    ) -> None:
        self.footprint, self.sources, self.narrow, self.deepest = footprint, sources, narrow, deepest
        self.indivisible, self.careful = indivisible, careful
        self._drawn: tuple[Photons, mi.Float] | None = None

    def draw(self, photons: Photons, shares: mi.Float) -> None:
        """Makes ``photons`` what samples gather from; ``shares``: how many of each pair are in a map."""
        self._drawn = photons, shares

    def density(self, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Bool) -> mi.Float:
        """How close together photons are on the ray of light that comes to ``it`` along ``ds`` from its source."""
        assert self._drawn is not None, "no photons have been drawn"
        return self.sources.density(it, ds, self._drawn[1], active)

    def begun(self, si: mi.SurfaceInteraction3f, bsdf: mi.BSDFPtr, d: mi.Vector3f, pdf: mi.Float) -> mi.Float:
        """Area around ``si`` on which photons count, seen along ``d``, over ``pdf``, the density per solid angle with
        which a lobe of ``bsdf`` draws that direction.
        """
        return over(self.area(si, bsdf) * dr.abs(dr.dot(si.n, d)), pdf)

    def area(self, si: mi.SurfaceInteraction3f, bsdf: mi.BSDFPtr) -> mi.Float:
        """That area; of nearly smooth surfaces the part of it that is left to those photons that lie there."""
        area = self.footprint.evenly(si.p)
        if self.narrow.table is None:
            return area
        return dr.select(self.narrow(bsdf, mi.Bool(True)), area * LIES, area)

    def __call__(
        self,
        ray: Ray,
        si: mi.SurfaceInteraction3f,
        bsdf: mi.BSDFPtr,
        drawn: Sequence[mi.BSDFContext],
        t: mi.UInt32,
        active: mi.Bool,
    ) -> mi.Spectrum:
        """Radiance towards the viewer of photons by the glossy lobes of ``bsdf`` at ``si``, which ``ray`` has met, for
        the ``t``-th sample of a pixel, less what its rays find themselves, and photons at the surfaces before.
        ``drawn``: the lobes, each with a ray of its own.
        """
        assert self._drawn is not None, "no photons have been drawn"
        photons = self._drawn[0]
        density, levels = photons.density, photons.level
        assert density is not None and levels is not None
        level = ray.level
        active = active & lobes.has_any(bsdf.flags(), *lobes.GLOSSY) & (level < self.deepest)
        if self.indivisible:
            active = but_not(active, is_whole(bsdf, active))
        area = self.area(si, bsdf)
        reach = None if self.narrow.table is None else dr.select(self.narrow(bsdf, active), before(ray), 0)

        def light(i: mi.UInt32, kernel: mi.Float, near: mi.Bool) -> mi.Spectrum:
            near = near & (level + dr.gather(mi.UInt32, levels, i, near) < self.deepest)
            d = -dr.gather(mi.Vector3f, photons.directions, i, near)
            wo = si.to_local(d)
            cos = dr.abs(mi.Frame3f.cos_theta(wo))
            near = near & (cos > 1e-6)
            dense, f = dr.gather(mi.Float, density, i, near), mi.Spectrum(0)
            for lobe in drawn:
                f_lobe, pdf = workarounds.eval_pdf(lobe, si, bsdf, wo, near, self.careful)
                f += f_lobe * (1 - share(expected(area * dr.abs(dr.dot(si.n, d)), f_lobe, pdf, dense, reach)))
            flux = dr.gather(mi.Spectrum, photons.flux, i, near)
            return dr.select(near, f * flux * (kernel / dr.select(near, cos, 1)), 0)

        number = t % dr.opaque(mi.UInt32, photons.maps)
        L, per_area = within_reach(photons, number, self.footprint, si, light, active)
        return L * per_area


def expected(area: mi.Float, f: mi.Spectrum, pdf: mi.Float, density: mi.Float, reach: mi.Float | None) -> mi.Float:
    """How many photons of this ``density`` are to be expected on ``area``, seen from where they come from, for each ray
    that is drawn there with the density ``pdf`` and all other ways by which the eye finds the light.

    ``f``: what the lobe scatters. ``reach``: what the ray has brought along that sees the surface, if that is nearly
    smooth, for photons beyond it; 0 or None if there are none.
    """
    begun = over(area, pdf)
    of_rays = begun * density
    if reach is None:
        return of_rays
    passed = over(dr.max(mi.unpolarized_spectrum(f)) * (1 - LIES), pdf)
    of_all = over(begun, dr.sqrt(dr.square(dr.rcp(density)) + dr.square(reach * passed)))
    return dr.select(reach > 0, of_all, of_rays)


def over(value: mi.Float, pdf: mi.Float) -> mi.Float:
    """``value`` over ``pdf``, 0 where that is 0."""
    return dr.select(pdf > 0, value / dr.select(pdf > 0, pdf, 1), 0)


class Passing:
    """Photons in ``scene`` at nearly smooth surfaces. ``tree``: whether the eye's rays follow both lobes of a surface,
    or one of the two.
    """

    def __init__(self, scene: mi.Scene, footprint: Footprint, tree: bool) -> None:
        self.footprint, self.lights = footprint, Lights(scene, choose=not tree)
        self.drawn = (lobes.reflected(), lobes.refracted()) if tree else (lobes.specular(),)
        self.careful = any_careful(scene)
        self.both_sides = bool(lobes.has_any(scene_flags(scene), *lobes.BOTH_SIDES))

    def __call__(
        self,
        density: mi.Float,
        start: Start,
        level: mi.UInt32,
        si: mi.SurfaceInteraction3f,
        bsdf: mi.BSDFPtr,
        wo: mi.Vector3f,
        active: mi.Bool,
    ) -> mi.Float:
        """The ``density`` of photons that ``start`` at a source and have met ``level`` surfaces before ``si``, beyond
        that, along ``wo``: over what all other ways add up to that end before, and find the same light.
        """
        eye = mi.SurfaceInteraction3f(si)
        eye.wi = wo
        f, pdf = mi.Spectrum(0), mi.Float(0)
        for lobe in self.drawn:
            f_lobe, pdf_lobe = workarounds.eval_pdf(lobe, eye, bsdf, si.wi, active, self.careful)
            f, pdf = f + f_lobe, pdf + pdf_lobe
        first = level == 0
        # Light that comes straight from a source without size is found where that is sampled, that of a sky by rays.
        alone = start.density == ENDLESS
        if self.lights.sky is not None:
            alone |= start.emitter.is_environment()
        active = but_not(active & (density > 0), first & alone)
        to_light = si.to_world(si.wi)
        lying = LIES * self.footprint.evenly(si.p) * dr.abs(dr.dot(si.n, to_light))
        sampled = self._of_source(start, eye, bsdf, to_light, active & first)
        found = dr.square(pdf) + dr.select(first, dr.square(sampled), 0)
        ways = dr.sqrt(found * dr.square(dr.rcp(density)) + dr.select(first, 0, dr.square(lying)))
        going = dr.max(mi.unpolarized_spectrum(f)) * dr.select(first, 1, 1 - LIES)
        return dr.select(active & (ways > 0), going / dr.select(ways > 0, ways, 1), 0)

    def _of_source(
        self, start: Start, eye: mi.SurfaceInteraction3f, bsdf: mi.BSDFPtr, d: mi.Vector3f, active: mi.Bool
    ) -> mi.Float:
        """Density per solid angle with which the source is sampled at ``eye``, by rays that are to be seen there, in
        the direction ``d`` that photons come from.
        """
        ds = mi.DirectionSample3f(start.place)
        ds.d, ds.dist, ds.emitter = d, eye.t, start.emitter
        both_sides = lobes.has_any(bsdf.flags(), *lobes.BOTH_SIDES) if self.both_sides else False
        return self.lights.pdf(eye, viewer_side(eye), both_sides, ds, active)
