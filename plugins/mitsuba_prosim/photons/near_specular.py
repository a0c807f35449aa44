"""Near-specular surfaces: glossy ones whose lobes are much narrower than the roughest. They cast caustics on rougher
surfaces.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ..optics.nested import all_bsdfs
from ..sampling.hash import combine, hash32
from ..sampling.nrook import to_unit
from ..transport import lobes
from ..transport.ray import Surface
from ..transport.scattering import Scattering
from ..transport.workarounds import is_inseparable

#: A surface is near-specular if nine in ten rays of its lobe have a density per solid angle above both limits: this
#: multiple of the roughest surface's, and this density, which a metal of m = 0.11 has, or glass of 0.25.
MIN_DENSITY_RATIO, MIN_DENSITY = 3.0, 1.0

#: Fraction of the photons that land on a near-specular surface; the others go on, for rougher surfaces beyond it.
LANDING = 0.5

#: Rays that are sampled from each lobe to measure its density.
RAYS = 256


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
