"""Near-specular surfaces: glossy ones whose lobes are much narrower than the roughest. They cast caustics on rougher
surfaces.
"""

from __future__ import annotations

from dataclasses import dataclass

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


@dataclass(frozen=True)
class NearSpecular:
    """The near-specular ones among the BSDFs of a scene. None of them disperses or has inseparable lobes."""

    #: 1 or 0 for Dr.Jit's identity of each BSDF: whether it is near-specular; None if none is.
    table: mi.UInt32 | None

    @property
    def any(self) -> bool:
        """Whether any BSDF is near-specular."""
        return self.table is not None

    @classmethod
    def of(cls, scene: mi.Scene) -> NearSpecular:
        """The near-specular BSDFs of ``scene``, instances included."""
        glossy = [b for b in all_bsdfs(scene) if lobes.has_any(int(b.flags()), *lobes.GLOSSY) and not is_inseparable(b)]
        if len(glossy) < 2:
            return cls(None)
        identities = [int(dr.reinterpret_array(mi.UInt32, mi.BSDFPtr(bsdf))[0]) for bsdf in glossy]
        densities = density_of_rays(Scattering.of(scene, separate=False), identities)
        limit = max(MIN_DENSITY_RATIO * densities.min(), MIN_DENSITY)
        found = [
            i for i, b, v in zip(identities, glossy, densities) if v > limit and not getattr(b, "disperses", False)
        ]
        if not found:
            return cls(None)
        table = mi.UInt32([int(i in found) for i in range(max(identities) + 1)])
        dr.make_opaque(table)
        return cls(table)

    def __call__(self, bsdf: mi.BSDFPtr, active: mi.Bool) -> mi.Bool:
        """Whether ``bsdf`` is near-specular."""
        if self.table is None:
            return mi.Bool(False)
        identity = dr.reinterpret_array(mi.UInt32, bsdf)
        known = active & (identity < dr.opaque(mi.UInt32, dr.width(self.table)))
        return dr.gather(mi.UInt32, self.table, identity, known) != 0


def density_of_rays(scattering: Scattering, identities: list[int]) -> np.ndarray:
    """Density per solid angle that nine in ten sampled rays of each BSDF's glossy lobes exceed; 0 without such rays.

    The surfaces are evaluated at 45°, anywhere on their textures.
    """
    count = len(identities)
    i = dr.arange(mi.UInt32, RAYS * count)
    bsdf = dr.gather(mi.BSDFPtr, dr.reinterpret_array(mi.BSDFPtr, mi.UInt32(identities)), i // RAYS)
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
