"""Multiple importance sampling of photon maps and camera rays at glossy surfaces.

The idea is from vertex connection and merging (Georgiev, Křivánek, Davidovič and Slusallek 2012) and unified path
sampling (Hachisuka, Pantaleoni and Jensen 2012); this module connects no vertices.

If the light of a lamp reaches a glossy surface G via a mirror, G shows a highlight. Rays that are sampled from the lobe
of G find it only if they hit the lamp by chance: the smaller the lamp, the rarer and brighter these hits are. Photons
that land on G find the same light. Each light path that both could have found is weighted by the power heuristic (Veach
1997), which needs R, the expected number of photons that land within one pixel of G for each sampled ray.

R is the density of photons, their number per area at right angles to the ray and per solid angle, times the étendue of
the ray. The density is known where the photons leave the light source. At each specular surface, the choice of a lobe
and Russian roulette reduce it in proportion to the reflectance or transmittance of the lobe. It also scales with the
square of the index of refraction, as radiance does, but a mirror or a lens does not change it otherwise. The étendue of
a camera ray (:func:`etendue_of`) is the area of a photon's kernel on G, projected at right angles to the ray, divided
by the density with which the lobe samples the ray.

A near-specular surface is a glossy surface whose lobe is much narrower than that of the roughest glossy surface of the
scene. It may be part of a chain of specular surfaces: there, the density of photons and the étendue are both multiplied
by the value of the lobe divided by the density with which the lobe samples the camera ray. Light sampling at a
near-specular surface, and photons at several glossy surfaces, are further strategies that find the same light; the MIS
weights of all strategies add up to 1. They ignore that only a fraction of the photons that reach a near-specular
surface lands there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ..light.strategy import Receiver
from ..light.table import Lights
from ..masks import but_not, dispatch
from ..optics.nested import all_bsdfs, all_flags
from ..sampling.hash import combine, hash32
from ..sampling.nrook import to_unit
from ..transport import lobes
from ..transport.ray import Ray, Surface, Vertex, viewer_side
from ..transport.scattering import Scattering
from ..transport.workarounds import is_inseparable
from .emission import MAX_DENSITY, Sources
from .grid import MIN_COSINE, Footprint, Landed, Photons, gather

#: Limits of a near-specular surface: nine in ten rays of its lobe have a density per solid angle above this multiple of
#: the density at the roughest surface, and above this density. A metal of m = 0.11 and glass of m = 0.25 have the
#: second density.
MIN_DENSITY_RATIO, MIN_DENSITY = 3.0, 1.0

#: Number of rays that are sampled from each lobe to measure its density.
RAYS = 256


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
    near_specular: mi.Bool
    #: Density of the arriving photons (:attr:`.Start.density`); None without MIS.
    density: mi.Float

    def landed(self, weight: mi.Float, density: mi.Float) -> Landed:
        """Returns the photons as :class:`.Landed`, which they are with the probability 1 / ``weight``."""
        return Landed(self.si.p, self.d, self.flux * (self.shading_ratio * weight), mi.Bool(True), density, self.level)


class PhotonMIS:
    """Gathers photons on glossy surfaces of ``scene``, with the MIS weights of photons and rays.

    A photon is gathered only if surfaces have scattered it, all of them ideally specular or near-specular. ``deepest``
    is the maximum number of specular surfaces of a light path, ``tree`` tells whether camera rays form a ray tree. The
    weights assume that the kernel radius of each photon is the width of a pixel (``footprint``).
    """

    def __init__(self, scene: mi.Scene, sources: Sources, footprint: Footprint, deepest: mi.UInt32, tree: bool) -> None:
        self.scene, self.footprint, self.sources, self.deepest = scene, footprint, sources, deepest
        self.near_specular_bsdfs, self.scattering = near_specular_bsdfs(scene), Scattering(scene)
        flags = all_flags(scene)
        #: The glossy lobes; camera rays sample each of them separately (:func:`.lobes.glossy`).
        self.lobes = lobes.glossy(flags, tree)
        #: Whether photons may land on glossy surfaces: the scene also has an ideally specular or a near-specular
        #: surface.
        self.needed = bool(self.near_specular_bsdfs or (self.lobes and lobes.has_any(flags, *lobes.IDEAL)))
        self.lights = Lights(scene, choose=not tree) if self.near_specular_bsdfs else None

    def near_specular(self, bsdf: mi.BSDFPtr, active: mi.Bool) -> mi.Bool:
        """Tells in which lanes ``bsdf`` is near-specular."""
        if not self.near_specular_bsdfs:
            return mi.Bool(False)
        return dispatch(bsdf, lambda one, active: mi.Bool(one in self.near_specular_bsdfs), active)

    # ------------------------------------------------------------ camera rays

    def next(self, vertex: Vertex, following: Ray, bs: mi.BSDFSample3f, weight: mi.Spectrum) -> Ray:
        """Returns the ray ``following``, which leaves ``vertex`` by the BSDF sample ``bs`` and ``weight``, with its
        ``last_etendue`` and ``earlier_etendue``.

        ``last_etendue`` is that at ``vertex``; 0 if no smooth lobe was sampled. ``earlier_etendue`` is that of the
        arriving ray, times the fraction of light that an ideal (:func:`ideal_throughput`) or near-specular lobe keeps;
        0 after other lobes. Both are 0 at an inseparable BSDF.
        """
        si, bsdf = vertex.si, vertex.bsdf
        smooth = but_not(following.pdf > 0, vertex.inseparable)
        near, kept = smooth & self.near_specular(bsdf, smooth), ideal_throughput(bs, weight, bsdf.flags())
        kept = dr.select(near, dr.max(mi.unpolarized_spectrum(weight)), kept)
        earlier = dr.select(vertex.inseparable, 0, etendue_of(vertex.ray) * kept)
        here = quotient(self.footprint.area(si.p) * dr.abs(dr.dot(si.n, following.d)), bs.pdf)
        return replace(following, last_etendue=dr.select(smooth, here, 0), earlier_etendue=earlier)

    def emission_weight(
        self, ray: Ray, origin: mi.Interaction3f, ds: mi.DirectionSample3f, pdf: mi.Float, active: mi.Bool
    ) -> mi.Float:
        """Returns the factor by which photons reduce the MIS weight of ``ray`` where it meets the light source point
        ``ds``; 1 where no photon could have found its light.

        Light sampling at ``origin`` would take ``ds`` with the density ``pdf``; 0 after an ideal lobe.
        """
        assert ray.earlier_etendue is not None
        density = self.sources.density(origin, ds, active & (ray.earlier_etendue > 0))
        return ray_weight(effective_photons(ray.earlier_etendue * density, quotient(pdf, ray.pdf)))

    def light_weight(
        self, vertex: Vertex, ds: mi.DirectionSample3f, f: mi.Spectrum, pdf: mi.Float, active: mi.Bool
    ) -> mi.Float:
        """Returns the factor by which photons reduce the MIS weight of the light sample ``ds`` at ``vertex``, for a
        lobe with the value ``f`` and the density ``pdf``; 1 where the surface is not near-specular, or no photon could
        have found the same light.
        """
        active = active & (pdf > 0) & self.near_specular(vertex.bsdf, active)
        expected = etendue_of(vertex.ray) * kept_fraction(f, pdf) * self.sources.density(vertex.si, ds, active)
        return ray_weight(effective_photons(expected, quotient(ds.pdf, dr.select(active, pdf, 0))))

    def radiance(self, photons: Photons, number: mi.UInt32, vertex: Vertex) -> mi.Spectrum:
        """Returns the radiance that the glossy lobes at ``vertex`` scatter from the photon map ``number``, with MIS
        weights; 0 at an inseparable BSDF, and where the light is already found (:attr:`.Ray.light_found`). At most
        ``deepest`` surfaces count, those of the photon and of the camera ray together.
        """
        ray, si, bsdf = vertex.ray, vertex.si, vertex.bsdf
        active = vertex.active & lobes.has_any(bsdf.flags(), *lobes.GLOSSY) & (ray.level < self.deepest)
        active = but_not(active, vertex.inseparable | ray.light_found)
        area, etendue = self.footprint.area(si.p), dr.select(self.near_specular(bsdf, active), etendue_of(ray), 0)

        def value(i: mi.UInt32, d: mi.Vector3f, in_reach: mi.Bool) -> mi.Spectrum:
            # The glossy surface itself counts as a specular surface too.
            in_reach = in_reach & (ray.level + dr.gather(mi.UInt32, photons.landed.level, i, in_reach) < self.deepest)
            wo = si.to_local(d)
            density, f = dr.gather(mi.Float, photons.landed.density, i, in_reach), mi.Spectrum(0)
            for lobe in self.lobes:
                f_lobe, pdf = self.scattering.eval_pdf(lobe, vertex, wo, in_reach)
                # Photons per ray that land here; the others are photons that land at glossy surfaces
                # that the camera ray met before.
                here = quotient(area * dr.abs(dr.dot(si.n, d)), pdf) * density
                f += f_lobe * (1 - ray_weight(effective_photons(here, etendue * kept_fraction(f_lobe, pdf) * density)))
            return dr.select(in_reach, f / dr.maximum(dr.abs(wo.z), MIN_COSINE), 0)

        return gather(photons, number, si, value, active)

    # ------------------------------------------------------------ photons

    def scatter(
        self, landed: Landed, hit: Hit, bs: mi.BSDFSample3f, weight: mi.Spectrum, land_weight: mi.Float, active: mi.Bool
    ) -> tuple[mi.Float, Landed]:
        """Returns ``(density, landed)`` after the surface ``hit``: the density of the photons, and the photons that
        have landed on glossy surfaces, in addition to those of the argument ``landed``.

        The BSDF sample ``bs`` and ``weight`` scatters the photons in the ``active`` lanes; other photons end here. On a
        near-specular surface, a photon either lands, with the probability 1 / ``land_weight``, or continues; on another
        glossy surface it may do both. The returned density is 0 where :meth:`next` has no étendue either.
        """
        flags, density = hit.bsdf.flags(), hit.density
        lands = but_not(hit.active & (hit.level > 0) & (density > 0) & (hit.cos > 0), hit.inseparable)
        lands &= but_not(lobes.has_any(flags, *lobes.GLOSSY), hit.near_specular & active)
        here = hit.landed(dr.select(hit.near_specular, land_weight, 1), density)
        # The density of photons scales with the square of the index of refraction, as radiance does.
        beyond = density * dr.select(hit.inseparable, 0, ideal_throughput(bs, weight, flags) * dr.square(bs.eta))
        if self.near_specular_bsdfs:
            glossy = active & hit.near_specular & lobes.has_any(bs.sampled_type, *lobes.GLOSSY)
            beyond = dr.select(glossy, self.density_after(hit, bs.wo, glossy), beyond)
        return beyond, dr.select(lands, here, landed)

    def density_after(self, hit: Hit, wo: mi.Vector3f, active: mi.Bool) -> mi.Float:
        """Returns the density of photons in the local direction ``wo`` after the near-specular surface ``hit``, which
        the light that the lobe loses, and the MIS weights of further strategies at this surface, reduce.
        """
        assert self.lights is not None
        # A camera ray of the same light path arrives from the direction in which the photon leaves.
        camera_si = mi.SurfaceInteraction3f(hit.si)
        camera_si.wi = wo
        seen, f, pdf = Surface(camera_si, hit.bsdf, active, hit.inseparable), mi.Spectrum(0), mi.Float(0)
        for lobe in self.lobes:
            f_lobe, pdf_lobe = self.scattering.eval_pdf(lobe, seen, hit.si.wi, active)
            f, pdf = f + f_lobe, pdf + pdf_lobe
        # A third strategy finds the same light at this surface: light sampling if this is the photon's first surface,
        # else photons that land on it. ``lit`` and ``landed`` are the numbers of their samples per camera ray.
        first = hit.level == 0
        back = self.scene.ray_intersect(hit.si.spawn_ray(-hit.d), active & first)
        ds = mi.DirectionSample3f(self.scene, back, hit.si)
        receiver = Receiver(camera_si, viewer_side(camera_si), lobes.has_any(hit.bsdf.flags(), *lobes.BOTH_SIDES))
        lit = quotient(self.lights.pdf(receiver, ds, active & first), pdf)
        landed = quotient(self.footprint.area(hit.si.p) * hit.cos, pdf) * hit.density
        next_density = effective_photons(hit.density, dr.select(first, lit, landed)) * kept_fraction(f, pdf)
        # Only light sampling finds light that comes directly from a point light, and only rays find light directly from
        # a constant sky.
        single_strategy = hit.density > MAX_DENSITY
        if self.lights.sky is not None:
            single_strategy |= ds.emitter.is_environment()
        return dr.select(first & single_strategy, 0, next_density)


def etendue_of(ray: Ray) -> mi.Float:
    """Returns the root of ``last_etendue``² + ``earlier_etendue``²: the power heuristic adds squares of densities."""
    assert ray.earlier_etendue is not None
    # Without an earlier étendue the result is exactly ``last_etendue``: the square root of a square may differ by
    # rounding.
    both = dr.sqrt(dr.square(ray.last_etendue) + dr.square(ray.earlier_etendue))
    return dr.select(ray.earlier_etendue > 0, both, ray.last_etendue)


def effective_photons(photons: mi.Float, others: mi.Float) -> mi.Float:
    """Returns P / √(1 + O²), for P expected ``photons`` (or their density), and O samples of a third strategy, per ray.

    For this result, :func:`ray_weight` returns (1 + O²) / (1 + O² + P²): the sum of the MIS weights of the ray and of
    the third strategy, such as light sampling.
    """
    return photons * dr.rsqrt(1 + dr.square(others))


def ray_weight(photons: mi.Float) -> mi.Float:
    """Returns a ray's weight by the power heuristic, 1 / (1 + P²), for P expected photons per ray."""
    return dr.rcp(1 + dr.square(photons))


def ideal_throughput(bs: mi.BSDFSample3f, weight: mi.Spectrum, flags: mi.UInt32) -> mi.Float:
    """Returns the fraction of a beam's light that the sampled ideal lobe keeps, in the brightest channel; 0 where it is
    not ideal, and where the BSDF has a glossy lobe too, as its ``flags`` tell.

    It is the same in both directions along the beam, except that for camera rays it contains the squared ratio of the
    indices of refraction.
    """
    ideal = but_not(lobes.has_any(bs.sampled_type, *lobes.IDEAL), lobes.has_any(flags, *lobes.GLOSSY))
    return dr.select(ideal, dr.max(mi.unpolarized_spectrum(weight)) * bs.pdf, 0)


def kept_fraction(f: mi.Spectrum, pdf: mi.Float) -> mi.Float:
    """Returns the fraction of a beam that a near-specular lobe keeps: its greatest channel of ``f`` / ``pdf``."""
    return quotient(dr.max(mi.unpolarized_spectrum(f)), pdf)


def quotient(value: mi.Float, pdf: mi.Float) -> mi.Float:
    """Returns ``value`` divided by ``pdf``, or 0 where ``pdf`` is 0."""
    return dr.select(pdf > 0, value / dr.select(pdf > 0, pdf, 1), 0)


def near_specular_bsdfs(scene: mi.Scene) -> frozenset[mi.BSDF]:
    """Returns the glossy BSDFs of ``scene`` whose :func:`density_of_rays` is above :data:`MIN_DENSITY`, and above
    :data:`MIN_DENSITY_RATIO` times that of the roughest one. Inseparable BSDFs do not count; a dispersive one, only as
    the roughest.
    """
    glossy = [b for b in all_bsdfs(scene) if lobes.has_any(int(b.flags()), *lobes.GLOSSY) and not is_inseparable(b)]
    if len(glossy) < 2:
        return frozenset()
    densities = density_of_rays(Scattering(scene, separate=False), glossy)
    limit = max(MIN_DENSITY_RATIO * densities.min(), MIN_DENSITY)
    return frozenset(b for b, v in zip(glossy, densities) if v > limit and not getattr(b, "disperses", False))


def density_of_rays(scattering: Scattering, bsdfs: list[mi.BSDF]) -> np.ndarray:
    """Returns, for each BSDF, the density per solid angle that nine in ten sampled rays of its glossy lobes exceed, at
    an angle of incidence of 45° and random texture coordinates; 0 without glossy lobes.
    """
    count = len(bsdfs)
    i = dr.arange(mi.UInt32, RAYS * count)
    bsdf = dr.concat([dr.repeat(mi.BSDFPtr(one), RAYS) for one in bsdfs])
    key = combine(hash32(dr.opaque(mi.UInt32, 0)), i)
    numbers = [to_unit(combine(key, k)) for k in range(5)]
    si = dr.zeros(mi.SurfaceInteraction3f, RAYS * count)
    si.n, si.uv = mi.Normal3f(0, 0, 1), mi.Point2f(*numbers[3:])
    si.sh_frame, si.wi = mi.Frame3f(si.n), mi.Vector3f(0.5**0.5, 0, 0.5**0.5)
    if mi.is_spectral:
        si.wavelengths = mi.UnpolarizedSpectrum(550)
    surface, u = Surface(si, bsdf, mi.Bool(True), mi.Bool(False)), (numbers[0], mi.Point2f(*numbers[1:3]))
    bs, _, _ = scattering.sample(lobes.only(lobes.SPECULAR), surface, u, mi.Bool(True))
    drawn = (bs.pdf > 0) & lobes.has_any(bs.sampled_type, *lobes.GLOSSY)
    pdf = np.array(dr.select(drawn, bs.pdf, 0)).reshape(count, RAYS)
    return np.array([np.percentile(row[row > 0], 10) if row.any() else 0.0 for row in pdf])
