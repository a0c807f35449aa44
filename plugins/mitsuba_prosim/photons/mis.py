"""Multiple importance sampling of photons and rays (Georgiev et al. 2012; Hachisuka et al. 2012).

A glossy surface G sees a lamp in a mirror. Rays from the lobe of G find that highlight when they hit the lamp by
chance: the smaller the lamp, the fewer and brighter they are. Photons that land on G find the same light. Each path
that both could have found counts by the power heuristic (Veach 1997). It needs R, the number of photons that land
within a pixel of G for each ray that is sampled.

R is the density of photons times an étendue. The density is their number per area at right angles to the ray and per
solid angle. It is known at the source. Along a chain of specular surfaces it falls only by absorption and by the choice
of a lobe, and scales with the square of the index of refraction as radiance does: neither mirrors nor lenses change the
product of area and solid angle of a beam. The étendue belongs to the ray of the eye (:class:`Etendue`): the area on
which photons count at G, seen along the ray, over the density with which the lobe samples the ray.

A near-specular surface (:mod:`.near_specular`) may be part of such a chain. There each end multiplies by the value of
the lobe over the density of the eye's sample. Light sampling there, and photons at several glossy surfaces, are further
strategies, whose weights add up to 1.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from ..light.strategy import Receiver
from ..light.table import Lights
from ..masks import but_not
from ..optics.nested import all_shapes
from ..transport import lobes
from ..transport.context import scene_flags
from ..transport.ray import Ray, Vertex, viewer_side
from ..transport.scattering import Scattering
from .emission import ENDLESS, Sources, Start
from .footprint import Footprint
from .grid import Photons, within_reach
from .near_specular import LANDING, NearSpecular

#: Density of all other strategies that find a light sample, from the sample, the value and density of a lobe, a mask.
OtherDensity = Callable[[Any, Any, Any, Any], Any]


@dataclass
class Etendue:
    """Area times solid angle that one ray of the eye stands for: number of expected photons over their density."""

    #: At the last glossy surface that the ray left; 0 if it left none.
    last: mi.Float
    #: At the glossy surfaces before, if the ray has met only specular and near-specular ones since; else 0.
    earlier: mi.Float

    def __mul__(self, factor: mi.Float) -> Etendue:
        """The étendue of a ray that keeps this part of its light."""
        return Etendue(self.last * factor, self.earlier * factor)

    @property
    def total(self) -> mi.Float:
        """The root of the sum of squares, as the power heuristic adds strategies."""
        # The square root of a square is not always the same to the bit.
        both = dr.sqrt(dr.square(self.last) + dr.square(self.earlier))
        return dr.select(self.earlier > 0, both, self.last)


def shares_light(scene: mi.Scene, near_specular: NearSpecular) -> bool:
    """Whether ``scene`` has both glossy surfaces and specular or near-specular ones."""
    bsdfs = [shape.bsdf() for shape in all_shapes(scene) if shape.bsdf() is not None]
    glossy, ideal = (any(lobes.has_any(int(b.flags()), *names) for b in bsdfs) for names in (lobes.GLOSSY, lobes.IDEAL))
    return near_specular.any or (glossy and ideal)


def ray_weight(photons: mi.Float, others: mi.Float | float = 1) -> mi.Float:
    """MIS weight of a ray where this number of ``photons`` is expected. ``others``: the sum over all other strategies,
    the ray included, as squares over the ray's.
    """
    return dr.rcp(others + dr.square(photons))


def passed_on(bs: mi.BSDFSample3f, weight: mi.Spectrum, flags: mi.UInt32) -> mi.Float:
    """Part of a beam that an ideal lobe passes on, by its sample ``bs`` of this ``weight``: the probability of the lobe
    times its reflectance; 0 where any lobe of the surface is glossy (``flags``).

    It is the same from either end of the beam, but for the squares of the indices that radiance is scaled by.
    """
    ideal = but_not(lobes.has_any(bs.sampled_type, *lobes.IDEAL), lobes.has_any(flags, *lobes.GLOSSY))
    return dr.select(ideal, dr.max(mi.unpolarized_spectrum(weight)) * bs.pdf, 0)


class GlossyGathering:
    """Glossy lobes lit by photons that came through specular or near-specular surfaces, and the MIS weights of these
    photons and of the rays that find the same light.

    ``deepest``: greatest number of specular surfaces, those of the eye's ray included; ``scattering``: of the scene.
    Photons count within a pixel's width (``footprint``).
    """

    def __init__(
        self,
        footprint: Footprint,
        sources: Sources,
        near_specular: NearSpecular,
        deepest: mi.UInt32,
        scattering: Scattering,
    ) -> None:
        self.footprint, self.sources, self.deepest = footprint, sources, deepest
        self.near_specular, self.scattering = near_specular, scattering
        self._emitted: tuple[Photons, mi.Float] | None = None

    def use(self, photons: Photons, shares: mi.Float) -> None:
        """Samples gather from ``photons`` from now on; ``shares``: number of photons of each cell in a map."""
        self._emitted = photons, shares

    # ------------------------------------------------------------ rays

    def first(self) -> Etendue:
        """The state of a camera ray."""
        return Etendue(mi.Float(0), mi.Float(0))

    def next(self, vertex: Vertex, following: Ray, bs: mi.BSDFSample3f, weight: mi.Spectrum, whole: mi.Bool) -> Etendue:
        """The étendue of ``following``, which leaves ``vertex`` with the sample ``bs`` of this ``weight``; none in the
        lanes ``whole``, whose BSDFs have no separable lobes.
        """
        si, bsdf = vertex.si, vertex.bsdf
        smooth, passed = but_not(following.uses_mis, whole), passed_on(bs, weight, bsdf.flags())
        if self.near_specular.any:
            near = smooth & self.near_specular(bsdf, smooth)
            passed = dr.select(near, dr.max(mi.unpolarized_spectrum(weight)) * (1 - LANDING), passed)
        last = dr.select(smooth, over(self.area(si, bsdf) * dr.abs(dr.dot(si.n, following.d)), bs.pdf), 0)
        return Etendue(last, dr.select(whole, 0, vertex.ray.etendue.total * passed))

    def emission_weight(
        self,
        ray: Ray,
        origin: mi.Interaction3f,
        ds: mi.DirectionSample3f,
        pdf: mi.Float,
        shares: mi.Bool,
        weight: mi.Float,
        active: mi.Bool,
    ) -> mi.Float:
        """MIS weight of the emission that ``ray`` meets; ``weight`` where no photon could have found it.

        ``ds``: the source as seen from ``origin``, where light sampling has the density ``pdf`` in the lanes
        ``shares``.
        """
        # Rays alone find what comes directly from a sky.
        found = active & (ray.etendue.earlier > 0) & (shares | but_not(mi.Bool(True), ray.uses_mis))
        others = dr.select(shares & found, 1 + dr.square(pdf / ray.pdf), 1)
        # No photon lands on a near-specular surface that the source lights directly.
        etendue = dr.select(ray.uses_mis, ray.etendue.earlier * (1 / (1 - LANDING)), ray.etendue.earlier)
        photons = etendue * self.density(origin, ds, found)
        return dr.select(found, ray_weight(photons, others), weight)

    def light_pdf(self, ray: Ray, si: mi.SurfaceInteraction3f, bsdf: mi.BSDFPtr, active: mi.Bool) -> OtherDensity:
        """The :data:`OtherDensity` of light sampling at ``si``, which ``ray`` meets: rays of the lobe, and photons if
        the surface is near-specular.
        """
        if not self.near_specular.any:
            return lambda ds, f, pdf, active: pdf
        etendue = ray.etendue.total
        shared = active & (etendue > 0) & self.near_specular(bsdf, active)

        def with_photons(ds: mi.DirectionSample3f, f: mi.Spectrum, pdf: mi.Float, active: mi.Bool) -> mi.Float:
            active = active & shared
            photons = etendue * dr.max(mi.unpolarized_spectrum(f)) * self.density(si, ds, active)
            return dr.select(active, dr.sqrt(dr.square(pdf) + dr.square(photons)), pdf)

        return with_photons

    def density(self, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Bool) -> mi.Float:
        """Density of the photons that come from the source to ``it`` along ``ds``."""
        assert self._emitted is not None, "no photons have been emitted"
        return self.sources.density(it, ds, self._emitted[1], active)

    def area(self, si: mi.SurfaceInteraction3f, bsdf: mi.BSDFPtr) -> mi.Float:
        """Area around ``si`` on which photons count; on near-specular surfaces the part for those that land there."""
        area = self.footprint.area(si.p)
        if not self.near_specular.any:
            return area
        return dr.select(self.near_specular(bsdf, mi.Bool(True)), area * LANDING, area)

    # ------------------------------------------------------------ photons

    def __call__(
        self,
        ray: Ray,
        si: mi.SurfaceInteraction3f,
        bsdf: mi.BSDFPtr,
        drawn: Sequence[mi.BSDFContext],
        t: mi.UInt32,
        active: mi.Bool,
    ) -> mi.Spectrum:
        """Radiance of photons by the glossy lobes of ``bsdf`` at ``si``, which ``ray`` meets, with MIS weights, for the
        ``t``-th sample of a pixel. ``drawn``: the lobes, each with a ray of its own.
        """
        assert self._emitted is not None, "no photons have been emitted"
        photons = self._emitted[0]
        density, levels = photons.density, photons.level
        assert density is not None and levels is not None
        active = active & lobes.has_any(bsdf.flags(), *lobes.GLOSSY) & (ray.level < self.deepest)
        active = but_not(active, self.scattering.inseparable(bsdf, active))
        area, etendue = self.area(si, bsdf), None
        if self.near_specular.any:
            etendue = dr.select(self.near_specular(bsdf, active), ray.etendue.total, 0)

        def light(i: mi.UInt32, kernel: mi.Float, near: mi.Bool) -> mi.Spectrum:
            near = near & (ray.level + dr.gather(mi.UInt32, levels, i, near) < self.deepest)
            d = -dr.gather(mi.Vector3f, photons.directions, i, near)
            wo = si.to_local(d)
            cos = dr.abs(mi.Frame3f.cos_theta(wo))
            near = near & (cos > 1e-6)
            dense, f = dr.gather(mi.Float, density, i, near), mi.Spectrum(0)
            for lobe in drawn:
                f_lobe, pdf = self.scattering.eval_pdf(lobe, si, bsdf, wo, near)
                photons_expected = expected(area * dr.abs(dr.dot(si.n, d)), f_lobe, pdf, dense, etendue)
                f += f_lobe * (1 - ray_weight(photons_expected))
            flux = dr.gather(mi.Spectrum, photons.flux, i, near)
            return dr.select(near, f * flux * (kernel / dr.select(near, cos, 1)), 0)

        number = t % dr.opaque(mi.UInt32, photons.maps)
        L, per_area = within_reach(photons, number, self.footprint, si, light, active)
        return L * per_area


def expected(area: mi.Float, f: mi.Spectrum, pdf: mi.Float, density: mi.Float, etendue: mi.Float | None) -> mi.Float:
    """Number of photons of this ``density`` that are expected on ``area`` (seen from where they come from) for each ray
    that a lobe samples there with the density ``pdf``, and for each of the eye's other strategies.

    ``f``: value of the lobe. ``etendue``: of the ray that sees the surface, if that is near-specular, so that photons
    land beyond it too; 0 or None if it is not.
    """
    last = over(area, pdf)
    of_rays = last * density
    if etendue is None:
        return of_rays
    passed = over(dr.max(mi.unpolarized_spectrum(f)) * (1 - LANDING), pdf)
    of_all = over(last, dr.sqrt(dr.square(dr.rcp(density)) + dr.square(etendue * passed)))
    return dr.select(etendue > 0, of_all, of_rays)


def over(value: mi.Float, pdf: mi.Float) -> mi.Float:
    """``value`` over ``pdf``, 0 where that is 0."""
    return dr.select(pdf > 0, value / dr.select(pdf > 0, pdf, 1), 0)


class DensityBeyond:
    """The density of photons beyond a near-specular surface of ``scene``. ``tree``: whether the eye's rays follow both
    specular lobes of a surface, or one of the two.
    """

    def __init__(self, scene: mi.Scene, footprint: Footprint, tree: bool, scattering: Scattering) -> None:
        self.footprint, self.lights = footprint, Lights(scene, choose=not tree)
        self.drawn = (lobes.reflected(), lobes.refracted()) if tree else (lobes.specular(),)
        self.scattering = scattering
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
        """The ``density`` beyond ``si`` along ``wo``, of photons that ``start`` at a source and have met ``level``
        surfaces before: over the sum of all strategies that find the same light and end before.
        """
        eye = mi.SurfaceInteraction3f(si)
        eye.wi = wo
        f, pdf = mi.Spectrum(0), mi.Float(0)
        for lobe in self.drawn:
            f_lobe, pdf_lobe = self.scattering.eval_pdf(lobe, eye, bsdf, si.wi, active)
            f, pdf = f + f_lobe, pdf + pdf_lobe
        first = level == 0
        # Light sampling alone finds what comes directly from a source without size; rays alone, what comes from a sky.
        alone = start.density == ENDLESS
        if self.lights.sky is not None:
            alone |= start.emitter.is_environment()
        active = but_not(active & (density > 0), first & alone)
        to_light = si.to_world(si.wi)
        landed = LANDING * self.footprint.area(si.p) * dr.abs(dr.dot(si.n, to_light))
        sampled = self._light_pdf(start, eye, bsdf, to_light, active & first)
        found = dr.square(pdf) + dr.select(first, dr.square(sampled), 0)
        strategies = dr.sqrt(found * dr.square(dr.rcp(density)) + dr.select(first, 0, dr.square(landed)))
        passed = dr.max(mi.unpolarized_spectrum(f)) * dr.select(first, 1, 1 - LANDING)
        return dr.select(active & (strategies > 0), passed / dr.select(strategies > 0, strategies, 1), 0)

    def _light_pdf(
        self, start: Start, eye: mi.SurfaceInteraction3f, bsdf: mi.BSDFPtr, d: mi.Vector3f, active: mi.Bool
    ) -> mi.Float:
        """Density per solid angle with which light sampling at ``eye`` samples the source, in the direction ``d`` that
        photons come from.
        """
        ds = mi.DirectionSample3f(start.place)
        ds.d, ds.dist, ds.emitter = d, eye.t, start.emitter
        both_sides = lobes.has_any(bsdf.flags(), *lobes.BOTH_SIDES) if self.both_sides else False
        return self.lights.pdf(Receiver(eye, viewer_side(eye), both_sides), ds, active)
