"""Photon tracing: from one specular surface to the next, until photons land on diffuse or glossy ones."""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from ..masks import but_not
from ..sampling.hash import combine
from ..sampling.nrook import to_unit
from ..transport import lobes
from ..transport.media import before, beyond, media_of, only_absorbs, transmittance
from ..transport.scattering import Scattering
from .emission import Start
from .footprint import Footprint
from .grid import WIDE, Landed
from .mis import DensityBeyond, passed_on, shares_light
from .near_specular import LANDING, NearSpecular

#: Indices of a photon's random numbers at a surface, and how many each surface has.
CHOICE, DIRECTION, ROULETTE, NUMBERS = 0, 1, 3, 4

#: Index of the first random number, one for each surface, that decides whether it lands on a near-specular one.
LANDS = 1 << 16

#: Photons for glossy surfaces play no Russian roulette at the first surface if it leaves them less than this part of
#: their flux: it dims all of them alike.
FAINT = 0.5

#: Bound on the ratio of cosines at shading normals. Without it single photons at grazing incidence would be as bright
#: as hundreds. It loses about a thousandth of the light that a ball of facets gathers.
MOST = 8

#: A lobe is wide if this part of its width is more than the reach :data:`.grid.WIDE`, where its width is the distance
#: times the root of the solid angle 1 / pdf.
PART = 0.2


@dataclass
class State:
    """Photons on their way, and where they have landed. ``level``: number of specular surfaces so far."""

    ray: mi.Ray3f
    #: The medium, where anything in the scene absorbs.
    medium: mi.MediumPtr | None
    flux: mi.Spectrum
    level: mi.UInt32
    active: mi.Bool
    landed: Landed
    #: Width over distance of the glossy lobe that it comes from; 0 of an ideal one.
    lobe: mi.Float
    #: Whether a smooth lobe of a BSDF without separable lobes has scattered it; None where no BSDF is like that.
    from_inseparable: mi.Bool | None
    #: With MIS: density of photons, 0 beyond a glossy surface that is not near-specular; else None.
    density: mi.Float | None
    #: Photons on glossy surfaces.
    glossy: Landed | None
    #: How many photons each of them counts for there, where any surface is near-specular.
    times: mi.Float | None = None


class Walk:
    """Traces photons in ``scene`` through up to ``deepest`` specular surfaces, for pixels of this ``footprint``.

    ``tree``: whether the eye's rays form a tree. Then BSDFs without separable lobes send photons on by all specular
    lobes; for paths only by their ideal ones, and all other photons land there.
    """

    def __init__(self, scene: mi.Scene, deepest: int, tree: bool, footprint: Footprint) -> None:
        self.scene, self.deepest = scene, dr.opaque(mi.UInt32, deepest)
        self.specular = lobes.specular()
        self.specular.mode = mi.TransportMode.Importance
        self.absorbs = any(map(only_absorbs, media_of(scene)))
        self.scattering, self.near_specular = Scattering.of(scene), NearSpecular.of(scene)
        self.tree, self.footprint = tree, footprint
        self.shares_light = shares_light(scene, self.near_specular)
        self.density_beyond = None
        if self.near_specular.any:
            self.density_beyond = DensityBeyond(scene, footprint, tree, self.scattering)

    def __call__(self, start: Start, key: mi.UInt32) -> tuple[Landed, Landed | None]:
        """Where the photons ``start`` land: on diffuse surfaces, and on glossy ones with MIS. ``key``: the hash key of
        each.
        """

        def step(state: State) -> State:
            return self._step(state, key, start)

        medium = mi.MediumPtr(None) if self.absorbs else None
        scattered = mi.Bool(False) if self.scattering.any_inseparable else None
        density, glossy = None, None
        if self.shares_light:
            density, glossy = start.density, replace(Landed.nowhere(), density=mi.Float(0), level=mi.UInt32(0))
        active, nowhere = dr.max(start.flux) > 0, Landed.nowhere()
        state = State(
            start.ray, medium, start.flux, mi.UInt32(0), active, nowhere, mi.Float(0), scattered, density, glossy
        )
        if self.density_beyond is not None:
            state.times = mi.Float(1)
        (state,) = dr.while_loop((state,), lambda state: state.active, lambda state: (step(state),))
        return state.landed, state.glossy

    def _step(self, state: State, key: mi.UInt32, start: Start) -> State:
        si = self.scene.ray_intersect(state.ray, state.active)
        surface = state.active & si.is_valid()
        bsdf = si.bsdf()
        arrived, medium, density, glossy, times = state.flux, state.medium, state.density, state.glossy, state.times
        if self.absorbs:
            medium = before(si, medium, state.ray.d, surface & (state.level == 0))
            left = transmittance(medium, si.wavelengths, si.t, surface)
            arrived = arrived * left
            surface &= dr.max(arrived) > 0
            if density is not None:
                density = density * dr.max(left)
        whole = self.scattering.inseparable(bsdf, surface)
        flags = bsdf.flags()
        lands = surface & (state.level > 0) & lobes.has_any(flags, *lobes.DIFFUSE)
        if self.scattering.any_inseparable:
            # Rays from one such surface to another find the light of sources there, whatever its lobes.
            lands = dr.select(whole, but_not(state.level > 0, state.from_inseparable), lands)
        goes = surface & (state.level < self.deepest) & lobes.has_any(flags, *lobes.REFLECTED, *lobes.REFRACTED)
        first = state.level * NUMBERS
        # Per area as shaded: facets that light grazes would else be brighter or darker than their neighbours.
        shaded, true = dr.abs(mi.Frame3f.cos_theta(si.wi)), dr.abs(dr.dot(si.n, state.ray.d))
        as_shaded = bounded(shaded, true)
        if density is not None:
            meets = but_not(surface & (state.level > 0) & (density > 0) & (true > 0), whole)
            meets &= lobes.has_any(flags, *lobes.GLOSSY)
            share = as_shaded
            if times is not None:
                later = but_not(surface & self.near_specular(bsdf, surface), state.level == 0)
                times = dr.select(later, times / LANDING, times)
                meets = but_not(meets, later & (number(key, LANDS + state.level) >= LANDING))
                share = as_shaded * times
            here = Landed(si.p, state.ray.d, arrived * share, mi.Bool(True), mi.Bool(False), density, state.level)
            glossy = dr.select(meets, here, glossy)
        ray, weight, bs, passed, goes, by_whole = self._scatter(si, bsdf, key, first, arrived, goes, whole)
        if density is not None:
            if self.density_beyond is not None:
                drawn = goes & lobes.has_any(bs.sampled_type, *lobes.GLOSSY)
                drawn = but_not(drawn & self.near_specular(bsdf, drawn), meets)
                beyond_it = self.density_beyond(density, start, state.level, si, bsdf, bs.wo, drawn)
                density = dr.select(drawn, beyond_it, density * passed)
            else:
                density = density * passed
        # One photon either lies or goes on, and keeps about the flux that it has.
        flux = arrived * weight
        kept = dr.select(goes, dr.max(flux) / dr.max(state.flux), 0)
        p = dr.select(lands, kept / (1 + kept), dr.minimum(kept, dr.select(state.level < 4, 1, 0.95)))
        if density is not None:  # Too few would come back from a varnish for what gathers them beside its own rays.
            p = dr.select((state.level == 0) & (kept > 0) & (kept < FAINT), 1, p)
        goes &= number(key, first + ROULETTE) < p
        lands = but_not(lands, goes)
        lands &= true > 0
        wide = PART * state.lobe * si.t > WIDE * self.footprint.width(si.p)
        landed = Landed(si.p, state.ray.d, arrived * (as_shaded / dr.maximum(1 - p, 1e-6)), mi.Bool(True), wide)
        # Where a choice between reflection and refraction is part of the density, that does not tell the width.
        by_gloss = but_not(lobes.has_any(bs.sampled_type, *lobes.GLOSSY), lobes.has_any(flags, *lobes.REFRACTED))
        return State(
            ray,
            beyond(si, medium, ray.d, goes) if self.absorbs else None,
            dr.select(goes, flux / dr.select(goes, p, 1), state.flux),
            state.level + 1,
            goes,
            dr.select(lands, landed, state.landed),
            dr.select(by_gloss, dr.rsqrt(dr.maximum(bs.pdf, 1e-6)), 0),
            state.from_inseparable | by_whole if self.scattering.any_inseparable else None,
            density,
            glossy,
            times,
        )

    def _scatter(
        self,
        si: mi.SurfaceInteraction3f,
        bsdf: mi.BSDFPtr,
        key: mi.UInt32,
        first: mi.UInt32,
        flux: mi.Spectrum,
        active: mi.Bool,
        whole: mi.Bool,
    ) -> tuple[mi.Ray3f, mi.Spectrum, mi.BSDFSample3f, mi.Float, mi.Bool, mi.Bool]:
        """``(ray, weight, bs, passed, active, by_whole)`` of a photon that a specular lobe scatters: its ray, the
        factor of its flux, the sample, the factor of the density of photons at an ideal lobe, its lanes, and whether a
        smooth lobe of a BSDF without separable lobes (``whole``) scattered it.

        The BSDF is the adjoint one: flux is not divided by the square of an index of refraction as radiance is, and
        cosines of shading and geometric normals are exchanged (Veach 1997, 5.3).
        """
        choice, sample = number(key, first + CHOICE), point(key, first + DIRECTION)
        bs, weight, belongs = self.scattering.sample(self.specular, si, bsdf, choice, sample, flux, active, whole)
        by_whole = but_not(whole, lobes.has_any(bs.sampled_type, *lobes.IDEAL))
        if not self.tree:
            belongs = but_not(belongs, by_whole)
        active = active & (bs.pdf > 0) & belongs
        d = si.to_world(bs.wo)
        cos_i, cos_o = dr.abs(mi.Frame3f.cos_theta(si.wi)), dr.abs(mi.Frame3f.cos_theta(bs.wo))
        true_i, true_o = dr.abs(dr.dot(si.n, si.to_world(si.wi))), dr.abs(dr.dot(si.n, d))
        active = active & (true_i > 0) & (cos_o > 0)
        weight = mi.unpolarized_spectrum(weight)
        passed = dr.select(whole, 0, passed_on(bs, weight, bsdf.flags()) * dr.square(bs.eta))
        return si.spawn_ray(d), weight * bounded(cos_i * true_o, cos_o * true_i), bs, passed, active, by_whole


def bounded(a: mi.Float, b: mi.Float) -> mi.Float:
    """a / b, but no more than :data:`MOST`."""
    return dr.select(a < MOST * b, a / dr.maximum(b, 1e-30), MOST)


def number(key: mi.UInt32, k: mi.UInt32) -> mi.Float:
    """The ``k``-th number in [0, 1) under a photon's ``key``."""
    return to_unit(combine(key, k))


def point(key: mi.UInt32, k: mi.UInt32) -> mi.Point2f:
    """Two of them: the ``k``-th and the next."""
    return mi.Point2f(number(key, k), number(key, k + 1))
