"""Which glossy surfaces are nearly smooth: so narrow that rougher ones see highlights there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

from ..optics.nested import all_shapes
from ..sampling.hash import combine, hash32
from ..sampling.nrook import to_unit
from . import lobes, scattering
from .workarounds import is_indivisible

if TYPE_CHECKING:
    import numpy as np

#: A lobe is narrow if the density per solid angle that nine in ten of its rays exceed is more than so many times that
#: of the roughest one, and more than so much: a metal's of m = 0.11, or that of glass of 0.25, which narrows it.
NARROWER, LEAST = 3.0, 1.0

#: How many of the photons that meet one come to lie there, for rougher ones to see through them too.
LIES = 0.5

#: Rays that are drawn from each to find that out.
RAYS = 256


@dataclass(frozen=True)
class Narrow:
    """The nearly smooth ones among the glossy BSDFs of a scene. Those that disperse are none, nor are those that are
    taken whole.
    """

    #: For Dr.Jit's identity of each BSDF, whether it is one, 1 or 0; None where there is none.
    table: mi.UInt32 | None

    @classmethod
    def of(cls, scene: mi.Scene) -> Narrow:
        """Those of ``scene``, instances included."""
        import numpy as np  # slow to import, and not needed before the first image

        bsdfs = dict.fromkeys(shape.bsdf() for shape in all_shapes(scene) if shape.bsdf() is not None)
        glossy = [b for b in bsdfs if lobes.has_any(int(b.flags()), *lobes.GLOSSY) and not is_indivisible(b)]
        if len(glossy) < 2:
            return cls(None)
        identities = [int(dr.reinterpret_array(mi.UInt32, mi.BSDFPtr(bsdf))[0]) for bsdf in glossy]
        narrowness = density_of_rays(identities)
        limit = max(NARROWER * narrowness.min(), LEAST)
        found = [
            i for i, b, v in zip(identities, glossy, narrowness) if v > limit and not getattr(b, "disperses", False)
        ]
        if not found:
            return cls(None)
        values = np.zeros(max(identities) + 1, dtype=int)
        values[found] = 1
        table = mi.UInt32(values.tolist())
        dr.make_opaque(table)
        return cls(table)

    def __call__(self, bsdf: mi.BSDFPtr, active: mi.Bool) -> mi.Bool:
        """Whether ``bsdf`` is one of them."""
        if self.table is None:
            return mi.Bool(False)
        identity = dr.reinterpret_array(mi.UInt32, bsdf)
        known = active & (identity < dr.opaque(mi.UInt32, dr.width(self.table)))
        return dr.gather(mi.UInt32, self.table, identity, known) != 0


def density_of_rays(identities: list[int]) -> np.ndarray:
    """How narrow BSDFs are: the density per solid angle that nine in ten of the rays exceed that each draws from its
    glossy lobes, lit at 45°, anywhere on its texture; 0 where it draws none.
    """
    import numpy as np

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
    bs, _ = scattering.sample(lobes.specular(), si, bsdf, numbers[0], mi.Point2f(*numbers[1:3]), None, mi.Bool(True))
    drawn = (bs.pdf > 0) & lobes.has_any(bs.sampled_type, *lobes.GLOSSY)
    pdf = np.array(dr.select(drawn, bs.pdf, 0)).reshape(count, RAYS)
    return np.array([np.percentile(row[row > 0], 10) if row.any() else 0.0 for row in pdf])
