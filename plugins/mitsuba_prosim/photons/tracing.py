"""The walk of light from specular surface to specular surface, to a diffuse one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from ..masks import but_not
from ..sampling.hash import combine
from ..sampling.nrook import to_unit
from ..transport import lobes, scattering, workarounds
from ..transport.media import before, beyond, media_of, only_absorbs, transmittance
from ..transport.merging import onward, possible
from ..transport.narrow import LIES, Narrow
from ..transport.workarounds import any_careful, any_indivisible, belongs_to, is_whole
from .emission import Start
from .footprint import Footprint
from .grid import WIDE, Landed
from .mis import Passing

#: Numbers that a photon is given for each surface.
CHOICE, DIRECTION, ROULETTE, NUMBERS = 0, 1, 3, 4

#: The first of those, one for each surface, that tell whether it lies on one that is nearly smooth.
LOT = 1 << 16

#: Photons for glossy surfaces that keep less than that of their light at the first one go on as they are, without
#: roulette: they are all dimmed alike there.
FAINT = 0.5

#: Facets that are met at grazing incidence, but shaded as if they were not, would make single photons as bright as
#: hundreds. About a thousandth of the light that a ball of facets gathers is lost by this bound.
MOST = 8

#: A lobe is wide if this part of its width is more than the reach :data:`.grid.WIDE`, where its width is the distance
#: times the root of the solid angle 1 / pdf.
PART = 0.2


@dataclass
class State:
    """Where photons are: ``ray``, ``flux`` and number of specular surfaces so far; and where they have ended."""

    ray: mi.Ray3f
    #: Where anything absorbs: what they go through.
    medium: mi.MediumPtr | None
    flux: mi.Spectrum
    level: mi.UInt32
    active: mi.Bool
    landed: Landed
    #: Width of the glossy lobe that it comes from, over the distance; 0 of an ideal one.
    lobe: mi.Float
    #: Where something is taken whole: whether a lobe of several directions of that has sent it on.
    sent: mi.Bool | None
    #: Where light is shared with the eye's rays: how close together photons are, 0 beyond a glossy surface unless that
    #: is nearly smooth, and where they have met that ...
    density: mi.Float | None
    glossy: Landed | None
    #: ... and, where any is nearly smooth, for how many photons each of them counts there.
    times: mi.Float | None = None


class Walk:
    """Light in ``scene``, through up to ``deepest`` specular surfaces, as seen with pixels of that ``footprint``.

    ``wholes``: whether what is taken whole sends photons on by all that it does not scatter; else they lie there,
    unless it lets them through or mirrors them in a single direction.
    """

    def __init__(self, scene: mi.Scene, deepest: int, wholes: bool, footprint: Footprint) -> None:
        self.scene, self.deepest = scene, dr.opaque(mi.UInt32, deepest)
        self.specular = lobes.specular()
        self.everything = lobes.everything()
        self.specular.mode = self.everything.mode = mi.TransportMode.Importance
        self.absorbs, self.disperses = any(map(only_absorbs, media_of(scene))), scattering.disperses(scene)
        self.careful = any_careful(scene)
        self.wholes, self.indivisible = wholes, any_indivisible(scene)
        self.narrow = Narrow.of(scene)
        self.footprint = footprint
        self.merges = possible(scene, self.narrow)
        self.passing = None if self.narrow.table is None else Passing(scene, footprint, wholes)

    def __call__(self, start: Start, key: mi.UInt32) -> tuple[Landed, Landed | None]:
        """Where the photons ``start`` come to lie, on diffuse surfaces and, where it matters, glossy ones. ``key``:
        one for each, which its numbers are drawn from.
        """

        def step(state: State) -> State:
            return self._step(state, key, start)

        medium, sent = mi.MediumPtr(None) if self.absorbs else None, mi.Bool(False) if self.indivisible else None
        density, glossy = None, None
        if self.merges:
            density, glossy = start.density, replace(Landed.nowhere(), density=mi.Float(0), level=mi.UInt32(0))
        active, nowhere = dr.max(start.flux) > 0, Landed.nowhere()
        state = State(start.ray, medium, start.flux, mi.UInt32(0), active, nowhere, mi.Float(0), sent, density, glossy)
        if self.passing is not None:
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
        whole = surface & is_whole(bsdf, surface) if self.indivisible else mi.Bool(False)
        flags = bsdf.flags()
        lands = surface & (state.level > 0) & lobes.has_any(flags, *lobes.DIFFUSE)
        if self.indivisible:
            # Rays from one whole surface to another find the light of sources there, however it goes on.
            lands = dr.select(whole, but_not(state.level > 0, state.sent), lands)
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
                later = but_not(surface & self.narrow(bsdf, surface), state.level == 0)
                times = dr.select(later, times / LIES, times)
                meets = but_not(meets, later & (number(key, LOT + state.level) >= LIES))
                share = as_shaded * times
            here = Landed(si.p, state.ray.d, arrived * share, mi.Bool(True), mi.Bool(False), density, state.level)
            glossy = dr.select(meets, here, glossy)
        ray, weight, bs, passed, goes, sent = self._scatter(si, bsdf, key, first, arrived, goes, whole)
        if density is not None:
            if self.passing is not None:
                drawn = goes & lobes.has_any(bs.sampled_type, *lobes.GLOSSY)
                drawn = but_not(drawn & self.narrow(bsdf, drawn), meets)
                beyond_it = self.passing(density, start, state.level, si, bsdf, bs.wo, drawn)
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
        wide = PART * state.lobe * si.t > WIDE * self.footprint.at(self.footprint.distance(si.p))
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
            state.sent | sent if self.indivisible else None,
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
        """The ray of a photon after a surface's specular lobes, what is left of its flux, the sample of those, what is
        left of the density of photons after an ideal one, and whether there is a ray; and whether it was sent in one of
        several directions by what is taken ``whole``.

        It is importance that spreads from the sources: it is not divided by the square of an index as radiance is, and
        where a surface is shaded by other normals than its own, cosines of both are exchanged (Veach 1997, 5.3).
        """
        choice, sample = number(key, first + CHOICE), point(key, first + DIRECTION)
        if self.disperses or self.careful:
            carried = flux if self.disperses else None
            bs, weight = scattering.sample(self.specular, si, bsdf, choice, sample, carried, active)
        else:
            bs, weight = bsdf.sample(self.specular, si, choice, sample, active)
        belongs, sent = (bs.sampled_type & self.specular.type_mask) != 0, mi.Bool(False)
        if self.indivisible:
            of_all, weight_of_all = workarounds.sample_all(
                self.everything, si, bsdf, choice, sample, active & whole, self.careful
            )
            bs, weight = dr.select(whole, of_all, bs), dr.select(whole, weight_of_all, weight)
            sent = but_not(whole, lobes.has_any(of_all.sampled_type, *lobes.IDEAL))
            belongs = dr.select(whole, belongs_to(self.specular, si.wi, of_all), belongs)
            if not self.wholes:
                belongs = but_not(belongs, sent)
        active = active & (bs.pdf > 0) & belongs
        d = si.to_world(bs.wo)
        cos_i, cos_o = dr.abs(mi.Frame3f.cos_theta(si.wi)), dr.abs(mi.Frame3f.cos_theta(bs.wo))
        true_i, true_o = dr.abs(dr.dot(si.n, si.to_world(si.wi))), dr.abs(dr.dot(si.n, d))
        active = active & (true_i > 0) & (cos_o > 0)
        weight = mi.unpolarized_spectrum(weight)
        passed = dr.select(whole, 0, onward(bs, weight, bsdf.flags()) * dr.square(bs.eta))
        return si.spawn_ray(d), weight * bounded(cos_i * true_o, cos_o * true_i), bs, passed, active, sent


def bounded(a: mi.Float, b: mi.Float) -> mi.Float:
    """a / b, but no more than :data:`MOST`."""
    return dr.select(a < MOST * b, a / dr.maximum(b, 1e-30), MOST)


def number(key: mi.UInt32, k: mi.UInt32) -> mi.Float:
    """The ``k``-th number in [0, 1) under a photon's ``key``."""
    return to_unit(combine(key, k))


def point(key: mi.UInt32, k: mi.UInt32) -> mi.Point2f:
    """Two of them: the ``k``-th and the next."""
    return mi.Point2f(number(key, k), number(key, k + 1))
