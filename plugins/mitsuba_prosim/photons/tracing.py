"""Photon tracing: from one specular surface to the next, until photons land on diffuse or glossy ones."""

from __future__ import annotations

from dataclasses import dataclass, field

import drjit as dr
import mitsuba as mi

from ..masks import but_not
from ..sampling.hash import combine
from ..sampling.nrook import to_unit
from ..transport import lobes
from ..transport.absorption import media_of, medium_before, medium_beyond, only_absorbs, transmittance
from ..transport.scattering import Scattering
from .emission import Start
from .grid import Landed
from .mis import Hit, PhotonMIS

#: Indices of a photon's random numbers at a surface, and how many each surface has.
CHOICE, DIRECTION, ROULETTE, NUMBERS = 0, 1, 3, 4

#: Photons for glossy surfaces play no Russian roulette at the first surface if it leaves them less than this part of
#: their flux: it dims all of them alike. Else esfera-metalica has up to 6 times the variance.
FAINT = 0.5

#: Bound on the ratio of cosines at shading normals. Without it single photons at grazing incidence would be as bright
#: as hundreds. It loses about a thousandth of the light that a ball of facets gathers.
MAX_COSINE_RATIO = 8


@dataclass
class State:
    """Photons on their way, and where they have landed. ``level``: number of specular surfaces so far."""

    ray: mi.Ray3f
    flux: mi.Spectrum
    active: mi.Bool
    #: The medium, where anything in the scene absorbs.
    medium: mi.MediumPtr | None
    #: Whether a smooth lobe of a BSDF without separable lobes has scattered it; None where no BSDF is like that.
    from_inseparable: mi.Bool | None
    #: With MIS: density of photons (:attr:`.Start.density`), 0 beyond a glossy surface if it is not near-specular ...
    density: mi.Float | None
    #: ... and where they have landed on glossy surfaces; else None.
    glossy: Landed | None
    level: mi.UInt32 = field(default_factory=lambda: mi.UInt32(0))
    landed: Landed = field(default_factory=Landed.nowhere)


class PhotonTracer:
    """Traces photons in ``scene`` through up to ``deepest`` specular surfaces.

    ``tree``: whether the eye's rays form a tree. Then BSDFs without separable lobes send photons on by all specular
    lobes; for paths only by their ideal ones, and all other photons land there. ``mis``: if photons land on glossy
    surfaces.
    """

    def __init__(self, scene: mi.Scene, deepest: mi.UInt32, tree: bool, mis: PhotonMIS | None) -> None:
        self.scene, self.deepest, self.tree, self.mis = scene, deepest, tree, mis
        self.specular = lobes.specular()
        self.specular.mode = mi.TransportMode.Importance
        self.absorbs = any(map(only_absorbs, media_of(scene)))
        self.scattering = Scattering.of(scene)

    def __call__(self, start: Start, key: mi.UInt32) -> tuple[Landed, Landed | None]:
        """Where the photons ``start`` land: on diffuse surfaces, and on glossy ones with MIS. ``key``: the hash key of
        each.
        """
        medium = mi.MediumPtr(None) if self.absorbs else None
        from_inseparable = mi.Bool(False) if self.scattering.any_inseparable else None
        density, glossy = (None, None) if self.mis is None else (start.density, Landed.nowhere())
        state = State(start.ray, start.flux, dr.max(start.flux) > 0, medium, from_inseparable, density, glossy)
        (state,) = dr.while_loop((state,), lambda state: state.active, lambda state: (self._step(state, key),))
        return state.landed, state.glossy

    def _step(self, state: State, key: mi.UInt32) -> State:
        hit, medium = self._intersect(state)
        flags, first = hit.bsdf.flags(), hit.level * NUMBERS
        lands = hit.active & (hit.level > 0) & lobes.has_any(flags, *lobes.DIFFUSE)
        if state.from_inseparable is not None:
            # Rays from one such surface to another find the light of sources there, through any of its lobes.
            lands = dr.select(hit.inseparable, but_not(hit.level > 0, state.from_inseparable), lands)
        goes = hit.active & (hit.level < self.deepest) & lobes.has_any(flags, *lobes.REFLECTED, *lobes.REFRACTED)
        bs, weight, goes, by_all_lobes = self._scatter(hit, key, goes)
        d = hit.si.to_world(bs.wo)
        # A photon either lands or continues, with about the same flux.
        flux = hit.flux * (weight * adjoint_correction(hit.si, bs.wo, d))
        kept = dr.select(goes, dr.max(flux) / dr.max(state.flux), 0)
        stays = lands | (hit.near_specular & (hit.level > 0))
        p = dr.select(stays, kept / (1 + kept), dr.minimum(kept, dr.select(hit.level < 4, 1, 0.95)))
        if self.mis is not None:  # Too few would come back from a varnish for glossy surfaces, which have rays as well.
            p = dr.select((hit.level == 0) & (kept > 0) & (kept < FAINT), 1, p)
        goes &= number(key, first + ROULETTE) < p
        lands = but_not(lands, goes) & (hit.cos > 0)
        density, glossy, share = state.density, state.glossy, dr.rcp(dr.maximum(1 - p, 1e-6))
        if self.mis is not None:
            assert density is not None and glossy is not None
            density, glossy = self.mis.scatter(density, glossy, hit, bs, weight, share, goes)
        landed = dr.select(lands, hit.landed(share, mi.Float(0)), state.landed)
        flux = dr.select(goes, flux / dr.select(goes, p, 1), state.flux)
        medium = medium_beyond(hit.si, medium, d, goes) if self.absorbs else None
        from_inseparable = None if state.from_inseparable is None else state.from_inseparable | by_all_lobes
        ray, level = hit.si.spawn_ray(d), hit.level + 1
        return State(ray, flux, goes, medium, from_inseparable, density, glossy, level, landed)

    def _intersect(self, state: State) -> tuple[Hit, mi.MediumPtr | None]:
        """Where photons meet a surface, and the medium before it."""
        si, d = self.scene.ray_intersect(state.ray, state.active), state.ray.d
        surface, medium, flux = state.active & si.is_valid(), state.medium, state.flux
        if self.absorbs:
            medium = medium_before(si, medium, d, surface & (state.level == 0))
            flux = flux * transmittance(medium, si.wavelengths, si.t, surface)
            surface &= dr.max(flux) > 0
        bsdf = si.bsdf()
        # Per area as shaded: facets that light grazes would else be brighter or darker than their neighbours.
        cos = dr.abs(dr.dot(si.n, d))
        shading = bounded(dr.abs(mi.Frame3f.cos_theta(si.wi)), cos)
        inseparable = self.scattering.inseparable(bsdf, surface)
        near = mi.Bool(False) if self.mis is None else self.mis.near_specular(bsdf, surface)
        return Hit(si, bsdf, surface, inseparable, d, state.level, flux, cos, shading, near), medium

    def _scatter(
        self, hit: Hit, key: mi.UInt32, active: mi.Bool
    ) -> tuple[mi.BSDFSample3f, mi.Spectrum, mi.Bool, mi.Bool]:
        """``(bs, weight, active, by_all_lobes)``: a sample of the lobes that are not diffuse, its lanes, and whether it
        is one of a glossy lobe of a BSDF without separable lobes.
        """
        si, first = hit.si, hit.level * NUMBERS
        u = number(key, first + CHOICE), point(key, first + DIRECTION)
        bs, weight, belongs = self.scattering.sample(self.specular, hit, u, active, hit.flux)
        by_all_lobes = but_not(hit.inseparable, lobes.has_any(bs.sampled_type, *lobes.IDEAL))
        if not self.tree:
            belongs = but_not(belongs, by_all_lobes)
        active = active & (bs.pdf > 0) & belongs
        active &= (dr.abs(dr.dot(si.n, si.to_world(si.wi))) > 0) & (dr.abs(mi.Frame3f.cos_theta(bs.wo)) > 0)
        return bs, mi.unpolarized_spectrum(weight), active, by_all_lobes


def adjoint_correction(si: mi.SurfaceInteraction3f, wo: mi.Vector3f, d: mi.Vector3f) -> mi.Float:
    """Factor of the flux that is scattered along ``wo``, in the world ``d``: for photons, the cosines of shading and
    geometric normals are exchanged (Veach 1997, 5.3).
    """
    cos_i, cos_o = dr.abs(mi.Frame3f.cos_theta(si.wi)), dr.abs(mi.Frame3f.cos_theta(wo))
    true_i, true_o = dr.abs(dr.dot(si.n, si.to_world(si.wi))), dr.abs(dr.dot(si.n, d))
    return bounded(cos_i * true_o, cos_o * true_i)


def bounded(a: mi.Float, b: mi.Float) -> mi.Float:
    """a / b, but no more than :data:`MAX_COSINE_RATIO`."""
    return dr.select(a < MAX_COSINE_RATIO * b, a / dr.maximum(b, 1e-30), MAX_COSINE_RATIO)


def number(key: mi.UInt32, k: mi.UInt32) -> mi.Float:
    """The ``k``-th number in [0, 1) under a photon's ``key``."""
    return to_unit(combine(key, k))


def point(key: mi.UInt32, k: mi.UInt32) -> mi.Point2f:
    """The point in [0, 1)² of a photon's ``k``-th number and the next."""
    return mi.Point2f(number(key, k), number(key, k + 1))
