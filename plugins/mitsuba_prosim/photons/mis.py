"""Multiple importance sampling of photon maps and camera rays at glossy surfaces.

The idea is from vertex connection and merging (Georgiev, Křivánek, Davidovič and Slusallek 2012) and unified path
sampling (Hachisuka, Pantaleoni and Jensen 2012); this module connects no vertices.

If the light of a lamp reaches a glossy surface G via a mirror, G shows a highlight. Rays that are sampled from the lobe
of G find it only if they hit the lamp by chance: the smaller the lamp, the rarer and brighter these hits are. Photons
that land on G find the same light. Each light path that both could have found is weighted by the power heuristic (Veach
1997), which needs R, the expected number of photons that land within one pixel of G for each sampled ray.

R is the density of photons, their number per area at right angles to the ray and per solid angle, times the étendue of
the ray. The density is known where the photons leave the light source. At each ideally specular surface, the choice of
a lobe and Russian roulette reduce it in proportion to the reflectance or transmittance of the lobe. It also scales with
the square of the index of refraction, as radiance does, but a mirror or a lens does not change it otherwise. The
étendue of a camera ray (:attr:`.Ray.etendue`) is the area of a photon's kernel on G, projected at right angles to the
ray, divided by the density with which the lobe samples the ray.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from ..masks import but_not
from ..optics.nested import all_flags
from ..transport import lobes
from ..transport.ray import Ray, Surface, Vertex
from ..transport.scattering import Scattering
from .emission import Sources
from .grid import MIN_COSINE, Footprint, Landed, Photons, gather


@dataclass
class Hit(Surface):
    """The surface points that photons hit, with the data of the arriving photons."""

    #: Direction of flight, and number of surfaces that the photon met before.
    d: mi.Vector3f
    level: mi.UInt32
    #: The arriving flux.
    flux: mi.Spectrum
    #: Cosine between the direction of flight and the geometric normal.
    cos: mi.Float
    #: Cosine between the direction of flight and the shading normal, divided by ``cos`` and bounded.
    shading_ratio: mi.Float
    #: Density of the arriving photons (:attr:`.Start.density`); None without MIS.
    density: mi.Float

    def landed(self, weight: mi.Float, density: mi.Float) -> Landed:
        """Returns the photons that land. ``weight``, one over the probability of landing, is a factor of their flux."""
        return Landed(self.si.p, self.d, self.flux * (self.shading_ratio * weight), mi.Bool(True), density, self.level)


class PhotonMIS:
    """Gathers photons on glossy surfaces of ``scene``, with the MIS weights of photons and rays.

    A photon is gathered only if surfaces have scattered it, all of them ideally specular. ``deepest`` is the maximum
    number of specular surfaces of a light path, ``tree`` tells whether camera rays form a ray tree. The weights assume
    that the kernel radius of each photon is the width of a pixel (``footprint``).
    """

    def __init__(self, scene: mi.Scene, sources: Sources, footprint: Footprint, deepest: mi.UInt32, tree: bool) -> None:
        self.scene, self.footprint, self.sources, self.deepest = scene, footprint, sources, deepest
        self.scattering, flags = Scattering(scene), all_flags(scene)
        #: The glossy lobes; camera rays sample each of them separately (:func:`.lobes.glossy`).
        self.lobes = lobes.glossy(flags, tree)
        #: Whether photons may land on glossy surfaces: the scene also has an ideally specular surface.
        self.needed = bool(self.lobes and lobes.has_any(flags, *lobes.IDEAL))

    def next(self, vertex: Vertex, following: Ray, bs: mi.BSDFSample3f, weight: mi.Spectrum) -> Ray:
        """Returns the ray ``following``, which leaves ``vertex`` by the BSDF sample ``bs`` and ``weight``, with its
        étendue: that at ``vertex`` after a smooth lobe, that of the arriving ray, times the fraction of light that the
        lobe keeps, after an ideal lobe (:func:`ideal_throughput`); 0 at an inseparable BSDF.
        """
        si = vertex.si
        kept = vertex.ray.etendue * ideal_throughput(bs, weight, vertex.bsdf.flags())
        here = quotient(self.footprint.area(si.p) * dr.abs(dr.dot(si.n, following.d)), bs.pdf)
        etendue = dr.select(following.pdf > 0, here, kept)
        return replace(following, etendue=dr.select(vertex.inseparable, 0, etendue))

    def emission_weight(
        self, ray: Ray, origin: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Bool
    ) -> mi.Float:
        """Returns the factor by which photons reduce the MIS weight of ``ray``, which leaves ``origin`` by an ideal
        lobe where ``active``, and meets the light source point ``ds``; 1 where no photon could have found its light.
        """
        assert ray.etendue is not None
        return ray_weight(ray.etendue * self.sources.density(origin, ds, active & (ray.etendue > 0)))

    def radiance(self, photons: Photons, number: mi.UInt32, vertex: Vertex) -> mi.Spectrum:
        """Returns the radiance that the glossy lobes at ``vertex`` scatter from the photon map ``number``, with MIS
        weights; 0 at an inseparable BSDF, and where the light is already found (:attr:`.Ray.light_found`). At most
        ``deepest`` surfaces count, those of the photon and of the camera ray together.
        """
        ray, si = vertex.ray, vertex.si
        active = vertex.active & lobes.has_any(vertex.bsdf.flags(), *lobes.GLOSSY)
        active = but_not(active, vertex.inseparable | ray.light_found)
        area = self.footprint.area(si.p)

        def value(i: mi.UInt32, d: mi.Vector3f, in_reach: mi.Bool) -> mi.Spectrum:
            # The glossy surface itself counts as a specular surface too.
            in_reach = in_reach & (ray.level + dr.gather(mi.UInt32, photons.landed.level, i, in_reach) < self.deepest)
            wo = si.to_local(d)
            density, f = dr.gather(mi.Float, photons.landed.density, i, in_reach), mi.Spectrum(0)
            for lobe in self.lobes:
                f_lobe, pdf = self.scattering.eval_pdf(lobe, vertex, wo, in_reach)
                f += f_lobe * (1 - ray_weight(quotient(area * dr.abs(dr.dot(si.n, d)), pdf) * density))
            return dr.select(in_reach, f / dr.maximum(dr.abs(wo.z), MIN_COSINE), 0)

        return gather(photons, number, si, value, active)

    def scatter(self, landed: Landed, hit: Hit, bs: mi.BSDFSample3f, weight: mi.Spectrum) -> tuple[mi.Float, Landed]:
        """Returns ``(density, landed)`` after the surface ``hit``, which scatters photons by the BSDF sample ``bs`` and
        ``weight``: the density of the photons, 0 where :meth:`next` has no étendue either; and the photons that have
        landed on glossy surfaces, in addition to those of the argument ``landed``.
        """
        flags = hit.bsdf.flags()
        lands = but_not(hit.active & (hit.level > 0) & (hit.density > 0) & (hit.cos > 0), hit.inseparable)
        here = hit.landed(mi.Float(1), hit.density)
        # The density of photons scales with the square of the index of refraction, as radiance does.
        kept = dr.select(hit.inseparable, 0, ideal_throughput(bs, weight, flags) * dr.square(bs.eta))
        return hit.density * kept, dr.select(lands & lobes.has_any(flags, *lobes.GLOSSY), here, landed)


def ray_weight(photons: mi.Float) -> mi.Float:
    """Returns a ray's weight by the power heuristic, 1 / (1 + R²), for R expected photons per ray."""
    return dr.rcp(1 + dr.square(photons))


def ideal_throughput(bs: mi.BSDFSample3f, weight: mi.Spectrum, flags: mi.UInt32) -> mi.Float:
    """Returns the fraction of a beam's light that the sampled ideal lobe keeps, in the brightest channel; 0 where it is
    not ideal, and where the BSDF has a glossy lobe too, as its ``flags`` tell.

    It is the same in both directions along the beam, except that for camera rays it contains the squared ratio of the
    indices of refraction.
    """
    ideal = but_not(lobes.has_any(bs.sampled_type, *lobes.IDEAL), lobes.has_any(flags, *lobes.GLOSSY))
    return dr.select(ideal, dr.max(mi.unpolarized_spectrum(weight)) * bs.pdf, 0)


def quotient(value: mi.Float, pdf: mi.Float) -> mi.Float:
    """Returns ``value`` divided by ``pdf``, or 0 where ``pdf`` is 0."""
    return dr.select(pdf > 0, value / dr.select(pdf > 0, pdf, 1), 0)
