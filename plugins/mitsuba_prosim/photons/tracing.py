"""Photon tracing: ideal or glossy specular surfaces scatter photons until the photons land on diffuse or glossy
surfaces.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import drjit as dr
import mitsuba as mi

from ..masks import but_not
from ..sampling.hash import combine
from ..sampling.nrook import to_unit
from ..transport import lobes
from ..transport.absorption import medium_before, medium_beyond, transmittance
from ..transport.lobes import LobePoint
from ..transport.scattering import Scattering
from .emission import Start
from .grid import Landed
from .mis import Hit, PhotonMIS

#: A photon plays no Russian roulette at its first surface if glossy surfaces gather photons and this surface scatters
#: less than this fraction of the flux. Such a surface dims all photons alike. With roulette, the variance of
#: ``examples/esfera-metalica.scn`` is up to 6 times greater.
FAINT = 0.5

#: Maximum ratio of cosines at shading normals. Without this bound, single photons at grazing incidence would be as
#: bright as hundreds. The bound loses about a thousandth of the light that a tessellated ball gathers.
MAX_COSINE_RATIO = 8

#: Ratio of the distance of a light source to the extent of the coordinates, beyond which photons start nearer. Rounding
#: would otherwise put their first surface point so far from the surface that they meet the surface again.
FAR = 100


@dataclass
class State:
    """The photons in flight and those that landed; ``level`` counts the specular surfaces met so far."""

    ray: mi.Ray3f
    flux: mi.Spectrum
    active: mi.Bool
    #: The medium around the photon.
    medium: mi.MediumPtr
    #: Whether a smooth lobe of a BSDF without separable lobes has scattered the photon.
    from_inseparable: mi.Bool
    #: Density of photons (:attr:`.Start.density`), 0 after a glossy surface; None without MIS.
    density: mi.Float | None
    #: Photons that have landed on glossy surfaces; None without MIS.
    glossy: Landed | None
    level: mi.UInt32 = field(default_factory=lambda: mi.UInt32(0))
    landed: Landed = field(default_factory=Landed.nowhere)


class PhotonTracer:
    """Traces photons in ``scene``; at most ``deepest`` specular surfaces reflect or refract each photon.

    An inseparable BSDF can only sample all its lobes together. If ``tree`` (the camera rays form a ray tree), all its
    specular lobes scatter photons; else only its ideal lobes, and the other photons land on the surface. ``mis`` is
    None if no photons land on glossy surfaces.
    """

    def __init__(self, scene: mi.Scene, deepest: mi.UInt32, tree: bool, mis: PhotonMIS | None) -> None:
        self.scene, self.deepest, self.tree, self.mis = scene, deepest, tree, mis
        self.specular = lobes.only(lobes.SPECULAR, mi.BSDFContext(mi.TransportMode.Importance))
        self.scattering = Scattering(scene)

    def __call__(self, start: Start, key: mi.UInt32) -> tuple[Landed, Landed | None]:
        """Traces the photons ``start`` with the hash keys ``key``; returns those that landed on diffuse surfaces, and
        those that landed on glossy surfaces (None without MIS).
        """
        active, medium = dr.max(start.flux) > 0, mi.MediumPtr(None)
        density, glossy = (None, None) if self.mis is None else (start.density, Landed.nowhere())
        state = State(start.ray, start.flux, active, medium, mi.Bool(False), density, glossy)
        (state,) = dr.while_loop((state,), lambda state: state.active, lambda state: (self._step(state, key),))
        return state.landed, state.glossy

    def _step(self, state: State, key: mi.UInt32) -> State:
        """Moves each photon to the next surface, where it continues by Russian roulette, else lands if the surface
        gathers photons, but not on the first surface. On a glossy surface a photon does both
        (:meth:`.PhotonMIS.scatter`).
        """
        hit, medium = self._intersect(state)
        flags = hit.bsdf.flags()
        choice, x, y, roulette = (to_unit(combine(key, hit.level * 4 + k)) for k in range(4))
        lands = hit.active & (hit.level > 0) & lobes.has_any(flags, *lobes.DIFFUSE)
        # Rays from one surface without separable lobes to another find the direct light there, so photons that would
        # add this light do not land.
        lands = dr.select(hit.inseparable, but_not(hit.level > 0, state.from_inseparable), lands)
        scatters = hit.active & (hit.level < self.deepest) & lobes.has_any(flags, *lobes.SPECULAR)
        bs, weight, scatters, by_all_lobes = self._sample(hit, (choice, mi.Point2f(x, y)), scatters)
        d = hit.si.to_world(bs.wo)
        # At a diffuse surface a photon either lands or continues. With the probability r / (1 + r) to
        # continue, where r is ``flux_ratio``, both alternatives have about 1 + r times the arriving flux.
        flux = hit.flux * (weight * adjoint_correction(hit.si, bs.wo, d))
        flux_ratio = dr.select(scatters, dr.max(flux) / dr.max(state.flux), 0)
        survival = dr.minimum(flux_ratio, dr.select(hit.level < 4, 1, 0.95))
        p_continue = dr.select(lands, flux_ratio / (1 + flux_ratio), survival)
        if self.mis is not None:  # with roulette, a varnish would reflect too few photons to glossy surfaces
            p_continue = dr.select((hit.level == 0) & (flux_ratio > 0) & (flux_ratio < FAINT), 1, p_continue)
        scatters &= roulette < p_continue
        lands = but_not(lands, scatters) & (hit.cos > 0)
        density, glossy = state.density, state.glossy
        if self.mis is not None:
            assert glossy is not None
            density, glossy = self.mis.scatter(glossy, hit, bs, weight)
        land_weight = dr.rcp(dr.maximum(1 - p_continue, 1e-6))
        landed = dr.select(lands, hit.landed(land_weight, mi.Float(0)), state.landed)
        flux = dr.select(scatters, flux / dr.select(scatters, p_continue, 1), state.flux)
        medium = medium_beyond(hit.si, medium, d, scatters)
        from_inseparable = state.from_inseparable | by_all_lobes
        ray, level = hit.si.spawn_ray(d), hit.level + 1
        return State(ray, flux, scatters, medium, from_inseparable, density, glossy, level, landed)

    def _intersect(self, state: State) -> tuple[Hit, mi.MediumPtr]:
        """Returns the points that the photons meet, with the flux that absorption leaves, and the medium before."""
        ray, d = state.ray, state.ray.d
        si = self.scene.ray_intersect(ray, state.active)
        surface = state.active & si.is_valid()
        far = surface & (state.level == 0) & (si.t > FAR * (1 + dr.norm(si.p)))
        skipped = dr.select(far, si.t * 0.999, 0)
        si = dr.select(far, self.scene.ray_intersect(mi.Ray3f(ray(skipped), d, ray.time, ray.wavelengths), far), si)
        surface &= si.is_valid()
        medium = medium_before(si, state.medium, d, surface & (state.level == 0))
        flux = state.flux * transmittance(medium, si.wavelengths, skipped + si.t, surface)
        surface &= dr.max(flux) > 0
        bsdf = si.bsdf()
        # A photon that lands is multiplied by cos(shading normal) / cos(facet's normal). Without this ratio, facets at
        # grazing incidence would be brighter or darker than their neighbours.
        cos = dr.abs(dr.dot(si.n, d))
        shading = bounded(dr.abs(mi.Frame3f.cos_theta(si.wi)), cos)
        inseparable = self.scattering.inseparable(bsdf, surface)
        return Hit(si, bsdf, surface, inseparable, d, state.level, flux, cos, shading, state.density), medium

    def _sample(self, hit: Hit, u: LobePoint, active: mi.Bool) -> tuple[mi.BSDFSample3f, mi.Spectrum, mi.Bool, mi.Bool]:
        """Samples the specular lobes of the surface ``hit``, and returns ``(bs, weight, active, by_all_lobes)``:
        ``active`` tells where it scatters a photon, ``by_all_lobes`` where a smooth lobe of an inseparable BSDF made
        the sample, which on paths scatters no photon.
        """
        si = hit.si
        bs, weight, belongs = self.scattering.sample(self.specular, hit, u, active, hit.flux)
        by_all_lobes = but_not(hit.inseparable, lobes.has_any(bs.sampled_type, *lobes.IDEAL))
        if not self.tree:  # on paths, these photons land instead
            belongs = but_not(belongs, by_all_lobes)
        active = active & (bs.pdf > 0) & belongs
        active &= (dr.abs(dr.dot(si.n, si.to_world(si.wi))) > 0) & (dr.abs(mi.Frame3f.cos_theta(bs.wo)) > 0)
        return bs, mi.unpolarized_spectrum(weight), active, by_all_lobes


def adjoint_correction(si: mi.SurfaceInteraction3f, wo: mi.Vector3f, d: mi.Vector3f) -> mi.Float:
    """Returns the factor that corrects the flux of a photon where the shading normal ns differs from the normal n
    (Veach 1997, 5.3): |wi·ns| |wo·n| / (|wi·n| |wo·ns|), at most :data:`MAX_COSINE_RATIO`. ``d`` is ``wo`` in world
    coordinates.
    """
    cos_i, cos_o = dr.abs(mi.Frame3f.cos_theta(si.wi)), dr.abs(mi.Frame3f.cos_theta(wo))
    true_i, true_o = dr.abs(dr.dot(si.n, si.to_world(si.wi))), dr.abs(dr.dot(si.n, d))
    return bounded(cos_i * true_o, cos_o * true_i)


def bounded(a: mi.Float, b: mi.Float) -> mi.Float:
    """Returns a / b, or :data:`MAX_COSINE_RATIO` if the quotient is greater or b is 0."""
    return dr.select(a < MAX_COSINE_RATIO * b, a / dr.maximum(b, 1e-30), MAX_COSINE_RATIO)
