"""Multiple importance sampling of photons and rays (Georgiev et al. 2012; Hachisuka et al. 2012).

A glossy surface G sees a lamp in a mirror. Rays from the lobe of G find that highlight when they hit the lamp by
chance: the smaller the lamp, the fewer and brighter they are. Photons that land on G find the same light. Each path
that both could have found counts by the power heuristic (Veach 1997). It needs R, the number of photons that land
within a pixel of G for each ray that is sampled.

R is the density of photons times an étendue. The density is their number per area at right angles to the ray and per
solid angle. It is known at the source. Along a chain of specular surfaces it falls only by the choice of a lobe and its
reflectance, and scales with the square of the index of refraction as radiance does: neither mirrors nor lenses change
the product of area and solid angle of a beam. The étendue belongs to the camera ray (:class:`RayWithEtendue`): the area
on which photons count at G, perpendicular to the ray, over the density with which the lobe samples the ray.

A near-specular surface may be part of such a chain: a glossy one whose lobe is much narrower than the roughest. There
each end multiplies by the value of the lobe over the density of the camera ray's sample. Light sampling there, and
photons at several glossy surfaces, are further strategies, whose weights add up to 1. That only a part of the photons
lands there does not enter the weights.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

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

#: A surface is near-specular if nine in ten rays of its lobe have a density per solid angle above both limits: this
#: multiple of the roughest surface's, and this density, which a metal of m = 0.11 has, or glass of 0.25.
MIN_DENSITY_RATIO, MIN_DENSITY = 3.0, 1.0

#: Rays that are sampled from each lobe to measure its density.
RAYS = 256


@dataclass
class RayWithEtendue(Ray):
    """A camera ray with its étendue: the expected number of photons per sampled ray for a photon density of 1."""

    #: At the glossy surface that the ray leaves; 0 if it leaves none.
    last_etendue: mi.Float = field(default_factory=lambda: mi.Float(0))
    #: At the glossy surfaces before, if the ray has met only specular and near-specular ones since; else 0.
    earlier_etendue: mi.Float = field(default_factory=lambda: mi.Float(0))


@dataclass
class Hit(Surface):
    """Where photons meet a surface."""

    #: Direction of flight, and the number of surfaces before.
    d: mi.Vector3f
    level: mi.UInt32
    #: The flux that arrives.
    flux: mi.Spectrum
    #: Cosine between the direction and the geometric normal.
    cos: mi.Float
    #: The cosine with the shading normal over ``cos``, bounded.
    shading_ratio: mi.Float
    near_specular: mi.Bool

    def landed(self, share: mi.Float, density: mi.Float) -> Landed:
        """The photons where they land. ``share``: one over the probability to land; ``density``: see
        :class:`.Landed`.
        """
        return Landed(self.si.p, self.d, self.flux * (self.shading_ratio * share), mi.Bool(True), density, self.level)


class PhotonMIS:
    """Photons on glossy surfaces of ``scene`` that came through specular or near-specular surfaces, and the MIS weights
    of these photons and of the rays that find the same light.

    ``deepest``: greatest number of specular surfaces, those of the camera ray included. ``tree``: whether camera rays
    follow both specular lobes of a surface, or one of the two. The weights assume that photons count within a pixel's
    width (``footprint``), although sparse ones count within more.
    """

    def __init__(self, scene: mi.Scene, sources: Sources, footprint: Footprint, deepest: mi.UInt32, tree: bool) -> None:
        self.scene, self.footprint, self.sources, self.deepest = scene, footprint, sources, deepest
        self.near_specular_bsdfs, self.scattering = near_specular_bsdfs(scene), Scattering.of(scene)
        flags = all_flags(scene)
        #: The glossy lobes, each with its own camera ray.
        self.lobes = lobes.glossy(flags, tree)
        #: Whether photons may land on a glossy surface: next to ideally specular ones, or to near-specular ones.
        self.needed = bool(self.near_specular_bsdfs or (self.lobes and lobes.has_any(flags, *lobes.IDEAL)))
        self.lights = Lights(scene, choose=not tree) if self.near_specular_bsdfs else None
        #: Number of photons of each pair of a source and a target in a map; None before :meth:`.Caustics.draw`.
        self.per_pair: mi.Float | None = None

    def density(self, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Bool) -> mi.Float:
        """Density of the photons that come from the source to ``it`` along ``ds``."""
        assert self.per_pair is not None, "no photons have been emitted"
        return self.sources.density(it, ds, self.per_pair, active)

    def near_specular(self, bsdf: mi.BSDFPtr, active: mi.Bool) -> mi.Bool:
        """Whether ``bsdf`` is near-specular."""
        if not self.near_specular_bsdfs:
            return mi.Bool(False)
        return dispatch(bsdf, lambda one, active: mi.Bool(one in self.near_specular_bsdfs), active)

    # ------------------------------------------------------------ camera rays

    def first(self, ray: Ray) -> RayWithEtendue:
        """The camera ray ``ray``, which has no étendue yet."""
        return RayWithEtendue(**vars(ray))

    def next(
        self, vertex: Vertex, following: RayWithEtendue, bs: mi.BSDFSample3f, weight: mi.Spectrum
    ) -> RayWithEtendue:
        """``following`` with its étendue. ``bs``, ``weight``: the BSDF sample at ``vertex`` that made this ray."""
        si, bsdf = vertex.si, vertex.bsdf
        smooth = but_not(following.uses_mis, vertex.inseparable)
        near, kept = smooth & self.near_specular(bsdf, smooth), ideal_throughput(bs, weight, bsdf.flags())
        kept = dr.select(near, dr.max(mi.unpolarized_spectrum(weight)), kept)
        earlier = dr.select(vertex.inseparable, 0, etendue_of(vertex.ray) * kept)
        here = quotient(self.footprint.area(si.p) * dr.abs(dr.dot(si.n, following.d)), bs.pdf)
        return replace(following, last_etendue=dr.select(smooth, here, 0), earlier_etendue=earlier)

    def emission_weight(
        self,
        ray: RayWithEtendue,
        origin: mi.Interaction3f,
        ds: mi.DirectionSample3f,
        pdf: mi.Float,
        uses_mis: mi.Bool,
        active: mi.Bool,
    ) -> mi.Float:
        """Factor of the MIS weight of the emission that ``ray`` meets: 1 where no photon could have found it.

        ``ds``: the direction sample of the source from ``origin``, which light sampling takes with the density ``pdf``
        in the lanes ``uses_mis``.
        """
        # Only rays find light directly from a sky.
        found = active & (ray.earlier_etendue > 0) & (uses_mis | but_not(mi.Bool(True), ray.uses_mis))
        others = dr.select(uses_mis & found, pdf / ray.pdf, 0)
        return ray_weight(shared(ray.earlier_etendue * self.density(origin, ds, found), others))

    def light_weight(
        self, vertex: Vertex, ds: mi.DirectionSample3f, f: mi.Spectrum, pdf: mi.Float, active: mi.Bool
    ) -> mi.Float:
        """Factor of the MIS weight of light sampling at ``vertex``: 1 where no photon could have found that light.
        ``f``, ``pdf``: value and density of the lobe for the direction sample ``ds``.
        """
        active = active & (pdf > 0) & self.near_specular(vertex.bsdf, active)
        expected = etendue_of(vertex.ray) * kept_by(f, pdf) * self.density(vertex.si, ds, active)
        return ray_weight(shared(expected, quotient(ds.pdf, dr.select(active, pdf, 0))))

    def radiance(self, photons: Photons, number: mi.UInt32, vertex: Vertex) -> mi.Spectrum:
        """Radiance of the photons of the map ``number`` by the glossy lobes at ``vertex``, with MIS weights."""
        ray, si, bsdf = vertex.ray, vertex.si, vertex.bsdf
        active = vertex.before_gathering(vertex.active) & lobes.has_any(bsdf.flags(), *lobes.GLOSSY)
        active = but_not(active & (ray.level < self.deepest), vertex.inseparable)
        area, etendue = self.footprint.area(si.p), dr.select(self.near_specular(bsdf, active), etendue_of(ray), 0)

        def value(i: mi.UInt32, d: mi.Vector3f, in_reach: mi.Bool) -> mi.Spectrum:
            in_reach = in_reach & (ray.level + dr.gather(mi.UInt32, photons.landed.level, i, in_reach) < self.deepest)
            wo = si.to_local(d)
            density, f = dr.gather(mi.Float, photons.landed.density, i, in_reach), mi.Spectrum(0)
            for lobe in self.lobes:
                f_lobe, pdf = self.scattering.eval_pdf(lobe, vertex, wo, in_reach)
                here = quotient(area * dr.abs(dr.dot(si.n, d)), pdf) * density
                f += f_lobe * (1 - ray_weight(shared(here, etendue * kept_by(f_lobe, pdf) * density)))
            return dr.select(in_reach, f / dr.maximum(dr.abs(wo.z), MIN_COSINE), 0)

        return gather(photons, number, si, value, active)

    # ------------------------------------------------------------ photons

    def scatter(
        self,
        density: mi.Float,
        landed: Landed,
        hit: Hit,
        bs: mi.BSDFSample3f,
        weight: mi.Spectrum,
        share: mi.Float,
        active: mi.Bool,
    ) -> tuple[mi.Float, Landed]:
        """``(density, landed)`` of the photons after ``hit``, given those before it.

        ``bs``, ``weight``: sample of the lobe that scatters those in the lanes ``active``. ``share``: one over the
        probability of the others to stay, which those on a near-specular surface do to land.
        """
        flags = hit.bsdf.flags()
        lands = but_not(hit.active & (hit.level > 0) & (density > 0) & (hit.cos > 0), hit.inseparable)
        lands &= but_not(lobes.has_any(flags, *lobes.GLOSSY), hit.near_specular & active)
        here = hit.landed(dr.select(hit.near_specular, share, 1), density)
        beyond = density * dr.select(hit.inseparable, 0, ideal_throughput(bs, weight, flags) * dr.square(bs.eta))
        if self.near_specular_bsdfs:
            glossy = active & hit.near_specular & lobes.has_any(bs.sampled_type, *lobes.GLOSSY)
            beyond = dr.select(glossy, self.density_after(density, hit, bs.wo, glossy), beyond)
        return beyond, dr.select(lands, here, landed)

    def density_after(self, density: mi.Float, hit: Hit, wo: mi.Vector3f, active: mi.Bool) -> mi.Float:
        """Density of photons along ``wo`` after a near-specular surface, which they reach with ``density``."""
        assert self.lights is not None
        camera_si = mi.SurfaceInteraction3f(hit.si)
        camera_si.wi = wo
        seen, f, pdf = Surface(camera_si, hit.bsdf, active, hit.inseparable), mi.Spectrum(0), mi.Float(0)
        for lobe in self.lobes:
            f_lobe, pdf_lobe = self.scattering.eval_pdf(lobe, seen, hit.si.wi, active)
            f, pdf = f + f_lobe, pdf + pdf_lobe
        # Other strategies end here: light sampling at the first surface, photons that land at later ones.
        first = hit.level == 0
        back = self.scene.ray_intersect(hit.si.spawn_ray(-hit.d), active & first)
        ds = mi.DirectionSample3f(self.scene, back, hit.si)
        receiver = Receiver(camera_si, viewer_side(camera_si), lobes.has_any(hit.bsdf.flags(), *lobes.BOTH_SIDES))
        lit = quotient(self.lights.pdf(receiver, ds, active & first), pdf)
        landed = quotient(self.footprint.area(hit.si.p) * hit.cos, pdf) * density
        beyond = shared(density, dr.select(first, lit, landed)) * kept_by(f, pdf)
        # Only light sampling finds light directly from a source without size; only rays find that of a sky.
        single_strategy = density > MAX_DENSITY
        if self.lights.sky is not None:
            single_strategy |= ds.emitter.is_environment()
        return dr.select(first & single_strategy, 0, beyond)


def etendue_of(ray: Ray) -> mi.Float:
    """Étendue of ``ray``: the root of the sum of both squares, as the power heuristic adds strategies."""
    assert isinstance(ray, RayWithEtendue)
    # The square root of a square is not always the same to the bit.
    both = dr.sqrt(dr.square(ray.last_etendue) + dr.square(ray.earlier_etendue))
    return dr.select(ray.earlier_etendue > 0, both, ray.last_etendue)


def shared(photons: mi.Float, others: mi.Float) -> mi.Float:
    """The number (or density) of ``photons`` that competes as well with a ray as this number does with the ray and this
    number of ``others`` for each ray.
    """
    return photons * dr.rsqrt(1 + dr.square(others))


def ray_weight(photons: mi.Float) -> mi.Float:
    """MIS weight of a ray where this number of ``photons`` is expected; the photons have the rest."""
    return dr.rcp(1 + dr.square(photons))


def ideal_throughput(bs: mi.BSDFSample3f, weight: mi.Spectrum, flags: mi.UInt32) -> mi.Float:
    """Fraction of a beam that the sampled ideal lobe keeps, its reflectance or transmittance: the weight of the sample
    ``(bs, weight)`` times its probability; 0 where the surface has a glossy lobe (``flags``).

    It is the same from either end of the beam, except for the squares of the indices that radiance is scaled by.
    """
    ideal = but_not(lobes.has_any(bs.sampled_type, *lobes.IDEAL), lobes.has_any(flags, *lobes.GLOSSY))
    return dr.select(ideal, dr.max(mi.unpolarized_spectrum(weight)) * bs.pdf, 0)


def kept_by(f: mi.Spectrum, pdf: mi.Float) -> mi.Float:
    """Fraction of a beam that a near-specular lobe of the value ``f`` and the density ``pdf`` keeps."""
    return quotient(dr.max(mi.unpolarized_spectrum(f)), pdf)


def quotient(value: mi.Float, pdf: mi.Float) -> mi.Float:
    """``value`` over ``pdf``, 0 where that is 0."""
    return dr.select(pdf > 0, value / dr.select(pdf > 0, pdf, 1), 0)


def near_specular_bsdfs(scene: mi.Scene) -> frozenset[mi.BSDF]:
    """The near-specular BSDFs of ``scene``, instances included. None of them disperses or has inseparable lobes."""
    glossy = [b for b in all_bsdfs(scene) if lobes.has_any(int(b.flags()), *lobes.GLOSSY) and not is_inseparable(b)]
    if len(glossy) < 2:
        return frozenset()
    densities = density_of_rays(Scattering.of(scene, separate=False), glossy)
    limit = max(MIN_DENSITY_RATIO * densities.min(), MIN_DENSITY)
    return frozenset(b for b, v in zip(glossy, densities) if v > limit and not getattr(b, "disperses", False))


def density_of_rays(scattering: Scattering, bsdfs: list[mi.BSDF]) -> np.ndarray:
    """Density per solid angle that nine in ten sampled rays of each BSDF's glossy lobes exceed; 0 without such rays.

    The surfaces are evaluated at 45°, anywhere on their textures.
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
    bs, _, _ = scattering.sample(lobes.specular(), surface, u, mi.Bool(True))
    drawn = (bs.pdf > 0) & lobes.has_any(bs.sampled_type, *lobes.GLOSSY)
    pdf = np.array(dr.select(drawn, bs.pdf, 0)).reshape(count, RAYS)
    return np.array([np.percentile(row[row > 0], 10) if row.any() else 0.0 for row in pdf])
