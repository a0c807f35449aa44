"""What is left of the density of photons beyond a nearly smooth surface (see :mod:`.merging`)."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..light.table import Lights
from ..masks import but_not
from ..transport import asking, lobes
from ..transport.asking import any_careful
from ..transport.narrow import LIES
from ..transport.ray import viewer_side
from ..transport.scene_facts import scene_flags
from .footprint import Footprint
from .sources import ENDLESS, Start


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
            f_lobe, pdf_lobe = asking.eval_pdf(lobe, eye, bsdf, si.wi, active, self.careful)
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
